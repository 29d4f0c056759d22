"""For every public callable, arguments of the right kinds: what the wrong ones are put among.

Found by the name of the parameter, or of the callable and the parameter where the name alone does
not say; small, and made once.
"""

import collections.abc
import inspect
import tomllib
import types
import typing
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import scipy.sparse as sp

import cellsys as cs
from tests.study.scenes import TINY

ROOMS = (
    "accuracy", "bondgraph", "cell", "design", "field", "integrate", "io", "loop", "model",
    "observe", "population", "reduction", "response", "samples", "scene", "store", "study", "worth",
)  # fmt: skip


@cache
def public() -> dict[str, object]:
    """Functions and classes of `cellsys` and of its rooms, errors apart."""
    found = {name: getattr(cs, name) for name in cs.__all__}
    for room in ROOMS:
        module = import_module(f"cellsys.{room}")
        for name in module.__all__:
            item = getattr(module, name)
            if found.get(name, item) is not item:
                name = f"{room}.{name}"
            found[name] = item
    return {
        name: item
        for name, item in sorted(found.items())
        if callable(item) and not (isinstance(item, type) and issubclass(item, BaseException))
    }


A = np.array([[-1.0, 0.2], [0.0, -0.5]])
T = np.array([0.0, 1.0, 2.0])


@cache
def model():
    from tests.population.systems import model

    return model(steered=True)


@cache
def loop():
    return cs.closed_loop(model())


@cache
def data():
    from tests.reduction.systems import one_step_data

    return one_step_data()


@cache
def scene():
    return cs.Scene.parse(tomllib.loads(TINY))


@cache
def spreading():
    return cs.build(scene())


@cache
def run():
    table = tomllib.loads(TINY)
    table["duration"] = "15 s"
    return cs.run_scene(cs.Scene.parse(table))


@cache
def pair():
    table = tomllib.loads(TINY)
    table["duration"], cell = "10 s", table["cells"][0]
    table["cells"] = [{**cell, "position": [f"{x} um", "0 um"]} for x in (-7, 7)]
    return cs.Scene.parse(table)


@cache
def oscillator():
    return cs.OdeSystem(states=["x", "v"], x0=[1.0, 0.0], W_x=[[0.0, 1.0], [-1.0, -0.1]])


@cache
def parametric():
    return cs.ParametricSystem(
        states=["x"], x0=[1.0], rate=lambda t, x, p: [-p["k"] * x[0]], parameters={"k": 1.0}
    )


@cache
def crawlers():
    return cs.build_crawlers([cs.Crawler()])


@cache
def equivariant():
    from tests.population.test_equivariant_cells import model

    return model()


@cache
def field():
    return cs.LinearField(np.random.default_rng(0).standard_normal((4, 3)), np.eye(12))


@cache
def decay():
    return cs.CostProblem(name="oscillator", system=oscillator(), t=T)


@cache
def setup():
    return cs.by_tolerance(cs.DOP853, [1e-3])


def layout():
    return cs.Layout(["x"])


@cache
def graph():
    parts = (cs.bondgraph.Se("pull", 1.0), cs.bondgraph.One("j"), cs.bondgraph.R("drag", 2.0))
    return cs.BondGraph(parts, ["pull -> j", "j -> drag"])


GOOD = {
    "sys": lambda: (A, np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1))),
    "full": lambda: (A, np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1))),
    "reduced": lambda: (A, np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1))),
    "A": lambda: A, "dA": lambda: A[None], "x0": lambda: np.array([1.0, 0.0]),
    "omega": lambda: np.array([0.1, 1.0]), "t": lambda: T, "u": lambda: None,
    "model": model, "loop": loop, "data": data, "train": data, "test": data, "known": data,
    "scene": scene, "scenes": lambda: [scene()], "run": run, "truth": run,
    "system": oscillator, "integrator": lambda: cs.DOP853(rtol=1e-6, atol=1e-8),
    "order": lambda: 2, "orders": lambda: [1, 2], "method": lambda: cs.LeastSquares(),
    "methods": lambda: [cs.LeastSquares()], "counts": lambda: [1, 2], "n_cells": lambda: 2,
    "field": field, "path": lambda: Path("nothing here"), "out": lambda: Path("out"),
    "folder": lambda: Path("out"), "alone": lambda: [run()],
    "rest": lambda: run().geometry["matrix.rest"], "n": lambda: 2, "seed": lambda: 0,
    "alone_scenes.scene": pair, "fit_polarity.data": run,
    "budget.target": loop, "budget.error": lambda: 0.01,
    "local_volumes.u": lambda: run().geometry["matrix.rest"],
    "by_step.method": lambda: cs.RungeKutta4, "by_step.steps": lambda: [0.1],
    "by_tolerance.method": lambda: cs.DOP853, "by_tolerance.tolerances": lambda: [1e-3],
    "cells_cost.models": lambda: [equivariant()], "check_budget.found": lambda: blank(cs.Budget),
    "crawl.system": crawlers, "end_gradient.system": parametric,
    "parameter_sensitivities.system": parametric,
    "end_gradient.weights": lambda: np.ones(1), "parameter_sensitivities.x0": lambda: None,
    "full_field.system": spreading, "step_cost.system": spreading, "fit_P_map.model": model,
    "fit_sensor.latent": lambda: [np.ones((3, 2))],
    "fit_sensor.directions": lambda: [np.ones((3, 3))],
    "full_order_references.problem": decay, "full_order_setups.problem": decay,
    "work_precision.problem": decay, "check_budget.problem": decay,
    "work_precision.setups": lambda: [setup()], "check_budget.setups": lambda: [setup()],
    "work_precision.reference": lambda: (setup(), setup()), "check_budget.reference": setup,
    "coupling_cost.form": lambda: cs.Superposition(), "grid.settings": lambda: {},
    "fit.data": lambda: cs.Recording(t=T, headings=T), "Recording.t": lambda: T,
    "printed_interface.V_x": lambda: np.eye(2, 2), "printed_interface.chi": lambda: [0],
    "printed_interface.V_eta": lambda: np.zeros((2, 2)), "printed_interface.phi": lambda: [1],
    "printed_interface.W_eta": lambda: np.eye(2),
    "printed_interface.M_chi_phi": lambda: np.ones((1, 1)),
    "literal_loop.input_map": lambda: cs.MPol(np.ones((3, 360))),
    "literal_loop.force": lambda: 600.0, "literal_loop.drag": lambda: 10.0,
    "steer.loop": lambda: cs.closed_loop(equivariant()), "steer.horizon": lambda: 150.0,
    "steer.target": lambda: cs.Target(place=[1.0, 0.0]), "Obstacle.center": lambda: (0.0, 0.0),
    "Steered.target": lambda: cs.Target(gap=1.0),
    "closed_loop.model": model, "with_matrix.model": equivariant,
    "with_matrix.field": lambda: cs.full_field(spreading()),
    "realisation_floor.model": equivariant, "realisation_floor.pairs": lambda: [],
    "measure.name": lambda: "mse", "measure.x": lambda: T, "measure.reference": lambda: T,
    "pole_certainty.method": lambda: cs.PCR(), "solve_ivp_peer.method": lambda: "RK45",
    "stability_limit.system": spreading, "scene_problems.t": lambda: T,
    "quantity.value": lambda: "1 um",
    "quantity.unit": lambda: "um", "build_crawlers.cells": lambda: [cs.Crawler()],
    "speed_against_spacing.readouts": lambda: [], "pair_of.i": lambda: 0, "pair_of.j": lambda: 1,
    "node_speed.block": lambda: "cell1.position", "contact_radius.position": lambda: np.eye(3),
    "loop_copies.z0": lambda: np.zeros((2, 6)), "loop_copies.p0": lambda: np.ones((2, 3)),
    "fit_P_map.latent": lambda: np.ones((3, 6)), "c2d.dt": lambda: 0.1,
    "pseudospectral_abscissa.epsilon": lambda: 0.01, "load_archive.kind": lambda: "model",
    "couple.model": model, "coupling_cost.counts": lambda: [2],
    "run_ensemble.scenes": lambda: [],
    "balanced_truncation.order": lambda: 1,
    "CellPort.A": lambda: -np.eye(2), "CellPort.F": lambda: np.eye(2),
    "LatentModel.A": lambda: A, "Realization.A": lambda: A,
    "LinearField.nodes": lambda: np.eye(3),
    "LinearField.stiffness": lambda: np.eye(9), "OdeSystem.states": layout,
    "OdeSystem.x0": lambda: [1.0], "OverdampedSystem.states": layout,
    "OverdampedSystem.x0": lambda: [1.0], "ParametricSystem.states": layout,
    "ParametricSystem.x0": lambda: [1.0], "Trajectory.t": lambda: T, "Trajectory.states": layout,
    "Trajectory.x": lambda: np.ones((3, 1)), "MPol.table": lambda: np.ones((3, 360)),
    "StiffnessSensor.K_d": lambda: np.ones((3, 3)), "Snapshots.runs": lambda: data().runs,
    "Snapshots.states": lambda: data().states,
    "Snapshots.auxiliaries": lambda: data().auxiliaries,
    "Snapshots.W_x": lambda: data().W_x, "Snapshots.W_eta": lambda: data().W_eta,
    "Jacobian.system": oscillator, "TPWL.system": oscillator, "GalerkinField.system": spreading,
    "FullField.system": spreading, "Scene.effects": lambda: scene().effects,
    "EquivariantModel.dynamics": lambda: equivariant().dynamics,
    "EquivariantModel.representation": lambda: equivariant().representation,
    "EquivariantModel.modes": lambda: equivariant().modes,
    "EquivariantModel.sites": lambda: equivariant().sites, "EquivariantModel.states": layout,
    "EquivariantModel.auxiliaries": layout, "CellsOnField.model": equivariant,
    "LoadPorts.field": field, "LoadPorts.positions": lambda: np.zeros((2, 2)),
    "PiecewiseModel.frozen": lambda: cs.LatentModel(A=A),
    "PiecewiseModel.points": lambda: np.ones((1, 2)),
    "PiecewiseModel.A": lambda: A[None], "PiecewiseModel.offset": lambda: np.ones((1, 2)),
    "BondGraph.elements": lambda: graph().elements,
    "BondGraph.bonds": lambda: ["pull -> j", "j -> drag"],
    "CostProblem.system": oscillator, "Setup.settings": lambda: [0.1],
    "History.times": lambda: [0.0],
    "History.values": lambda: [0.0],
    "InteractionGraph.weights": lambda: np.ones((2, 2)) - np.eye(2),
    "RootSet.values": lambda: np.array([-1.0]), "CrawlerSystem.cells": lambda: (cs.Crawler(),),
    "CrawlerSystem.chain": lambda: crawlers().chain,
    "PortedCells.coupling": lambda: cs.LoadPorts(field=field(), positions=np.zeros((2, 2))),
    "PortedCells.model": lambda: cs.CellPort(A=-np.eye(2), F=np.eye(2)),
}  # fmt: skip


def hints(item: object) -> dict[str, object]:
    """Resolved annotations of the parameters."""
    if not isinstance(item, type):
        item = inspect.unwrap(item)

        def taking():
            """What it returns may be named for type checkers alone."""

        taking.__annotations__ = {k: v for k, v in item.__annotations__.items() if k != "return"}
        return typing.get_type_hints(taking, item.__globals__)
    maker = next(b for b in item.__mro__ if {"__init__", "__new__"} & set(vars(b)))
    if "__dataclass_fields__" in vars(maker) or issubclass(item, tuple):
        return typing.get_type_hints(maker)
    return typing.get_type_hints(vars(maker).get("__init__") or maker.__new__)


def parts(protocol: type) -> set[str]:
    """Names that a Protocol asks for."""
    bases = [b for b in protocol.__mro__ if b not in (object, typing.Protocol, typing.Generic)]
    named = {n for b in bases for n in (*vars(b), *vars(b).get("__annotations__", ()))}
    return {n for n in named if not n.startswith("_")}


def blank(annotation: object) -> object:
    """Some value of an annotation; of a class an instance that was never made."""
    origin, inside = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        return blank(inside[0])
    if origin is typing.Literal:
        return inside[0]
    plain = {
        float: 1.0, int: 1, str: "text", bool: True, np.ndarray: np.ones(3), complex: 1j,
        Path: Path("out"), sp.csr_array: sp.csr_array((2, 2)), typing.Any: None,
        type(None): None, dict: {}, object: 1,
    }  # fmt: skip
    if annotation in plain:
        return plain[annotation]
    if annotation is np.random.Generator:
        return np.random.default_rng(0)
    if origin is tuple:
        return tuple(blank(a) for a in inside if a is not Ellipsis)
    found = origin or annotation
    if not isinstance(found, type):
        return None
    if found is collections.abc.Callable:
        return lambda *a: 0.0
    if issubclass(found, collections.abc.Mapping):
        return {}
    if issubclass(found, (collections.abc.Sequence, collections.abc.Iterable)) and origin:
        return [blank(a) for a in inside]
    if getattr(found, "_is_protocol", False):
        return types.SimpleNamespace(**dict.fromkeys(parts(found)))
    if issubclass(found, np.ndarray):
        return np.ones(3).view(found)
    return object.__new__(found)


def good(name: str, item: object) -> dict[str, object]:
    """Arguments by name for the parameters that a callable needs."""
    known = hints(item)
    out = {}
    for p in inspect.signature(item).parameters.values():
        if p.default is not p.empty or p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD):
            continue
        own = GOOD.get(f"{name}.{p.name}", None if isinstance(item, type) else GOOD.get(p.name))
        out[p.name] = own() if own else blank(known.get(p.name, typing.Any))
    return out
