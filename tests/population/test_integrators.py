"""`simulate(t, integrator)` of every kind of cells and loop: obeyed, or refused with reasons."""

import functools
import tomllib

import casadi
import numpy as np
import pytest

import cellsys as cs
from cellsys.population import LoadPorts, PatchPort, couple
from tests.population.systems import model
from tests.population.test_contracts import PLACES, Springs, grid
from tests.population.test_equivariant_cells import model as equivariant
from tests.population.test_load_ports import cell
from tests.study.scenes import TINY

T = 10.0 * np.arange(4)
DIRECTED = np.array([[0.0, 0.2, 0.1], [0.3, 0.0, 0.1], [0.0, 0.2, 0.0]])
SYMBOLIC = {
    "CVODES": cs.CVODES(rtol=1e-8, atol=1e-8),
    "IDAS": cs.IDAS(rtol=1e-8, atol=1e-8),
    "Collocation": cs.Collocation(step=0.5),
    "RungeKutta4": cs.RungeKutta4(step=0.25),
}
NUMERIC = {
    "DOP853": cs.DOP853(rtol=1e-8, atol=1e-8),
    "LSODA": cs.LSODA(rtol=1e-8, atol=1e-8),
    "Radau": cs.Radau(rtol=1e-7, atol=1e-7),
    "ExplicitEuler": cs.ExplicitEuler(step=0.1),
    "RKC": cs.RKC(rtol=1e-6, atol=1e-6),
}
EXACT = {
    "Exponential": cs.Exponential(rtol=1e-8, atol=1e-8),
    "Exponential steps": cs.Exponential(step=0.25),
}
METHODS = {
    **SYMBOLIC, **NUMERIC, **EXACT, "LinearlyImplicit": cs.LinearlyImplicit(step=0.5),
}  # fmt: skip
OWN_STEP = "steps by itself every 10 s and takes no integrator"


def ports(dt):
    place = LoadPorts(
        field=Springs(grid()), positions=PLACES, headings=[0.0, 2.0], port=PatchPort(radius=9.0)
    )
    return couple(cell(m=3, dt=dt, steered=True), coupling=place, controller=cs.PolarityLaw())


@functools.cache
def kinds():
    """Cells and loops, and what each refuses: (integrator, the reason it gives)."""
    one, angles = model(m=3, steered=True, seed=1), [0.0, 1.0, 2.0]
    no_drag = {"LinearlyImplicit": "drag and a majorant"}
    no_flows = dict.fromkeys(EXACT, r"dense.*use DOP853, Radau, LSODA or CVODES")
    own = dict.fromkeys(METHODS, OWN_STEP)
    return {
        "all alike": (couple(one, headings=angles), no_drag),
        "symmetric graph": (
            couple(one, graph=DIRECTED + DIRECTED.T, headings=angles), no_drag,
        ),
        "directed graph": (couple(one, graph=DIRECTED, headings=angles), no_drag | no_flows),
        "on a field": (ports(None), no_drag),
        "on a field, by steps": (ports(10.0), own),
        "equivariant": (
            couple(equivariant(), coupling=LoadPorts(field=disc(), positions=PLACES)),
            own,
        ),
        "one loop": (cs.closed_loop(one), no_drag),
        "one scheduled loop": (cs.closed_loop(equivariant()), own),
    }  # fmt: skip


@functools.cache
def disc():
    system = cs.build(cs.Scene.parse(tomllib.loads(TINY)))
    return cs.GalerkinField(system=system, order=8, linear=True, places=8)


@functools.cache
def truth(kind):
    return kinds()[kind][0].simulate(T, cs.DOP853(rtol=1e-12, atol=1e-12)).x


NAMES = (
    "all alike", "symmetric graph", "directed graph", "on a field", "on a field, by steps",
    "equivariant", "one loop", "one scheduled loop",
)  # fmt: skip


@pytest.mark.parametrize("kind", NAMES)
@pytest.mark.parametrize("method", METHODS)
def test_obeyed_or_refused(kind, method, monkeypatch):
    """CasADi is called by its own methods and by no other; what is obeyed is as accurate as it is.

    Per method the loosest of its kinds, doubled: first order over 300 steps, second at 1e-6.
    """
    calls, build = [], casadi.integrator
    monkeypatch.setattr(casadi, "integrator", lambda *a: calls.append(1) or build(*a))
    one, refused = kinds()[kind]
    if method in refused:
        with pytest.raises(cs.ParameterError, match=f"(?s){refused[method]}"):
            one.simulate(T, METHODS[method])
        assert not calls
        return
    run = one.simulate(T, METHODS[method])
    assert bool(calls) == (method in SYMBOLIC)
    assert type(METHODS[method]).__name__ in run.statistics["integrator"] or method in EXACT
    miss = np.abs(run.x - truth(kind)).max() / np.abs(truth(kind)).max()
    assert miss < {"ExplicitEuler": 0.1, "RKC": 1e-3}.get(method, 1e-5)


@pytest.mark.parametrize("kind", ["on a field, by steps", "equivariant", "one scheduled loop"])
def test_own_steps_need_no_integrator(kind):
    run = kinds()[kind][0].simulate(T)
    assert run.statistics["steps"] == 3
    assert 0 < run.error.relative < 1
    with pytest.raises(cs.ParameterError, match=r"grid of .* whole steps of 10 s"):
        kinds()[kind][0].simulate(np.array([0.0, 25.0]))


def test_a_tolerance_is_obeyed():
    """Naive: the tolerances alone are read, and the method behind them is another one."""
    cells = kinds()["all alike"][0]
    misses = [
        [np.abs(cells.simulate(T, m(rtol=r, atol=r)).x - truth("all alike")).max()
         for r in (1e-4, 1e-7)]
        for m in (cs.CVODES, cs.DOP853, cs.Exponential)
    ]  # fmt: skip
    for loose, tight in misses:
        assert tight < 0.1 * loose
    assert len({miss for pair in misses for miss in pair}) == 6  # no two methods alike


def test_orders_of_fixed_exact_flows():
    cells = kinds()["all alike"][0]
    for order in (2, 4):
        miss = [
            np.abs(cells.simulate(T, cs.Exponential(step=h, order=order)).x
                   - truth("all alike")).max()
            for h in (2.5, 1.25)
        ]  # fmt: skip
        assert 0.7 * 2**order < miss[0] / miss[1] < 1.5 * 2**order
    with pytest.raises(cs.ParameterError, match="2, 4 or 6"):
        cells.simulate(T, cs.Exponential(step=1.0, order=3))


def test_too_many_cells_for_symbols_are_told_what_serves():
    cells = couple(model(m=3, steered=True, seed=1), 400)
    with pytest.raises(cs.NotSymbolicError, match=r"K m = 1200; use Exponential, DOP853 or LSODA"):
        cells.simulate([0.0, 1.0], cs.CVODES(rtol=1e-6, atol=1e-6))
