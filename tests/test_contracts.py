"""Objects of one's own join by satisfying a contract; others are refused by what they lack."""

import dataclasses
import re
import textwrap
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import cellsys as cs
from cellsys.contracts import (
    ChoosesOrder,
    LinearModel,
    Loop,
    ReducedModel,
    Reductor,
    Regression,
    needs,
)
from cellsys.errors import ParameterError
from tests.cell.runs import model as equivariant
from tests.population.systems import model as latent
from tests.reduction.systems import one_step_data, spreading_data


class Mean:
    """A reductor of one's own, without any base class: nothing but `fit`."""

    def fit(self, snapshots, order, *, test=None, basis=None):
        basis = cs.fit_basis(snapshots, order) if basis is None else basis
        return cs.LatentModel(
            A=-1e-3 * np.eye(order),
            V=basis.V[:, :order],
            mean=basis.mean,
            scale=basis.scale,
            n_states=snapshots.states.size,
        )


class Measured(Mean):
    """One whose models bring their card."""

    def fit(self, snapshots, order, *, test=None, basis=None):
        model = super().fit(snapshots, order, basis=basis)
        card = cs.assess(model, snapshots, test)
        return dataclasses.replace(model, card=dataclasses.replace(card, verdict="my own"))


class Wrong(Mean):
    """One that returns what is no reduced model."""

    def fit(self, snapshots, order, *, test=None, basis=None):
        return np.eye(order)


class Bare:
    """A model that satisfies the contract and is no dataclass: no card can be put on it."""

    def __init__(self, inner):
        self.__dict__.update({k: getattr(inner, k) for k in (
            "order", "dt", "input_names", "z_start", "sensor", "card", "notes", "encode",
            "reconstruct", "predict", "step_matrices", "at", "growth", "pole_set", "plant",
            "validity",
        )})  # fmt: skip


class MakesBare(Mean):
    def fit(self, snapshots, order, *, test=None, basis=None):
        return Bare(super().fit(snapshots, order, basis=basis))


METHODS = [
    cs.PCR(), cs.PCR(literal=True), cs.LeastSquares(), cs.Ridge(), cs.Contractive(),
    cs.Equivariant(), Mean(), Measured(),
]  # fmt: skip


@pytest.mark.parametrize("method", METHODS, ids=lambda m: type(m).__name__)
def test_reductors_satisfy_the_contract(method):
    needs(method, Reductor, "method")
    regression = isinstance(method, (cs.PCR, cs.LeastSquares, cs.Ridge))
    assert isinstance(method, Regression) == regression
    assert isinstance(method, ChoosesOrder) == isinstance(method, cs.Equivariant)


def test_models_are_siblings():
    one, other = latent(), equivariant()
    for model in (one, other):
        needs(model, ReducedModel, "model")
        needs(model, LinearModel, "model")
        again = dataclasses.replace(model, notes={**model.notes, "mine": 1})
        assert type(again) is type(model)
        assert again.notes["mine"] == 1
        np.testing.assert_array_equal(again.A, model.A)
        step = 0.5 if model.dt is None else None
        end = model.at(model.notes.get("horizon_s", 0.0))
        np.testing.assert_array_equal(end.step_matrices(step)[0], model.step_matrices(step)[0])
    assert not isinstance(other, type(one))
    assert not isinstance(one, type(other))


@pytest.mark.parametrize("bare", [None, "PCR", 3, SimpleNamespace(order=3), cs.PCR])
def test_what_is_missing_is_named(bare):
    with pytest.raises(ParameterError, match="model must be a reduced model"):
        needs(bare, ReducedModel, "model")
    if isinstance(bare, SimpleNamespace):
        with pytest.raises(ParameterError, match=r"has no .*encode, reconstruct, predict"):
            needs(bare, ReducedModel, "model")


def test_a_reductor_of_ones_own():
    train, test = one_step_data(runs=3, T=30), one_step_data(seed=9, runs=2, T=30)
    model = cs.reduce(train, order=2, method=Mean(), test=test)
    assert model.card.held_out
    assert model.z_start is not None
    assert cs.reduce(train, order=2, method=Measured(), test=test).card.verdict == "my own"
    many = list(cs.reduce_orders(train, [cs.LeastSquares(), Mean(), Measured()], [2, 3], test))
    assert [m.order for m in many] == [2, 3] * 3
    assert many[2].card.held_out == model.card.held_out
    assert many[4].card.verdict == "my own"
    table = cs.compare_reductors(train, test, [2], [Mean(), cs.LeastSquares(), Measured()])
    assert [r.method for r in table.rows] == ["Mean", "LeastSquares", "Measured"]
    assert cs.pole_certainty(train, Mean(), 2).spread.max() == 0.0  # it learns nothing
    with pytest.raises(ParameterError, match=r"what Wrong\.fit returned must be a reduced model"):
        cs.reduce(train, order=2, method=Wrong())
    with pytest.raises(ParameterError, match=r"MakesBare\.fit returned a Bare without a card"):
        cs.reduce(train, order=2, method=MakesBare())


def test_a_basis_carries_samples_of_its_own_data_alone():
    """Naive: what it carries is used whatever data come: the fit to other data is the first's."""
    one, other = one_step_data(seed=1), one_step_data(seed=2)
    basis = cs.fit_basis(one, 3).with_parts(one)
    assert basis.parts_of(one) is basis.parts
    fitted = cs.LeastSquares().fit(other, 3, basis=basis)
    plain = cs.LeastSquares().fit(other, 3, basis=cs.fit_basis(one, 3))
    np.testing.assert_array_equal(fitted.A, plain.A)
    naive = cs.LeastSquares().fit(one, 3, basis=basis)
    assert np.abs(naive.A - plain.A).max() > 1e-3
    wide = spreading_data(runs=2)
    same = cs.PCR().fit(wide, 4, basis=cs.fit_basis(wide, 8).with_parts(wide))
    again = cs.PCR().fit(wide, 4, basis=cs.fit_basis(wide, 8))
    np.testing.assert_allclose(same.A, again.A, rtol=1e-9)  # products of other widths round apart


def snippet(text, word):
    """The block of Python of the README that holds a word."""
    blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    return textwrap.dedent(next(b for b in blocks if word in b))


def test_the_integrator_of_the_readme_runs():
    """It is of second order: half the step leaves a quarter of the error."""
    text = (Path(cs.__file__).parents[1] / "README.md").read_text("utf-8")
    names = {"Stepper": cs.integrate.Stepper}
    exec(snippet(text, "class Midpoint"), names)
    loop, t = cs.closed_loop(latent(steered=True)), np.arange(0.0, 21.0, 4.0)
    exact = loop.simulate(t, cs.DOP853(rtol=1e-12, atol=1e-13)).x
    errors = []
    for step in (0.5, 0.25):
        method = names["Midpoint"]()
        method.step = step
        run = loop.simulate(t, method)
        errors.append(np.abs(run.x - exact).max())
    assert errors[0] == pytest.approx(4.0 * errors[1], rel=0.2)
    with pytest.raises(ParameterError, match="integrator must be an integrator"):
        loop.simulate(t, SimpleNamespace(step=1.0))


def test_loops_and_read_outs_of_ones_own():
    loop = cs.closed_loop(latent(steered=True))
    for one in (loop, cs.closed_loop(equivariant())):
        needs(one, Loop, "loop")
    with pytest.raises(ParameterError, match="loop must be a closed loop"):
        needs(latent(), Loop, "loop")
    run = loop.simulate(np.arange(0.0, 20.0, 5.0), cs.DOP853(rtol=1e-6, atol=1e-8))

    def turned(run):
        return {"turned_rad": float(np.ptp(np.unwrap(np.arctan2(run.p[:, 0, 1], run.p[:, 0, 0]))))}

    found = cs.read_outs(run, [turned])
    assert found["turned_rad"] > 0
    assert cs.read_outs(run) == {k: v for k, v in found.items() if k != "turned_rad"}
    with pytest.raises(ParameterError, match="is there already"):
        cs.read_outs(run, [turned, turned])
    with pytest.raises(ParameterError, match="must be a finite real number"):
        cs.read_outs(run, [lambda run: {"name": "text"}])
    with pytest.raises(ParameterError, match="more"):
        cs.read_outs(run, [3])
