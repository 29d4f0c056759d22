"""The plant with its offset against `predict`, by python-control alone."""

import control as ct
import numpy as np
import pytest

from cellsys.errors import DataError, ParameterError
from cellsys.model import LatentModel
from tests.reduction.systems import stable_matrix

TOLERANCE = 1e-9  # of the largest state: two ways to the same exponential, conditioned alike


def commands(model, steps, held):
    """One command for all times (a continuous response is interpolated), or one of each step."""
    rng = np.random.default_rng(3)
    u = rng.standard_normal(len(model.input_names))
    return np.tile(u, (steps, 1)) if held else rng.standard_normal((steps, len(u)))


def distance(model, plant, z0, u, t):
    """Of `forced_response` under [u; 1] from `predict`, over the largest state."""
    last = np.vstack([u, u[-1:]]).T  # python-control wants a command at the last sample too
    found = ct.forced_response(plant, t, np.vstack([last, np.ones(len(t))]), z0)
    known = model.predict(z0, u, t)
    return np.abs(found.outputs.T - known).max() / np.abs(known).max()


def check_offset(model):
    """`forced_response` under [u; 1] is `predict`, and without the offset it is not."""
    dt = 5.0 if model.dt is None else model.dt
    t = dt * np.arange(31)
    z0 = np.random.default_rng(1).standard_normal(model.order)
    plant = model.plant()
    assert plant.input_labels == [*(n.replace(".", "_") for n in model.input_names), "one"]
    assert distance(model, plant, z0, commands(model, 30, held=True), t) < TOLERANCE
    if model.dt is not None:  # a step model takes another command in each step
        stepped = model.plant(discrete=True)
        assert distance(model, stepped, z0, commands(model, 30, held=False), t) < TOLERANCE
    u = commands(model, 30, held=True)
    bare = model.plant(offset="drop")
    assert bare.input_labels == plant.input_labels[:-1]
    naive = ct.forced_response(bare, t, np.vstack([u, u[-1:]]).T, z0).outputs.T
    known = model.predict(z0, u, t)
    assert np.abs(naive - known).max() > 1e-4 * np.abs(known).max()  # what went without a word


def small(dt=None):
    rng = np.random.default_rng(0)
    A = stable_matrix(5, rng, slowest=0.02, fastest=0.2)
    return LatentModel(
        A=A,
        B=rng.standard_normal((5, 2)),
        offset=rng.standard_normal(5),
        dt=dt,
        input_names=("cell1.cos", "cell1.sin"),
    )


@pytest.mark.parametrize("dt", [None, 1.0])
def test_forced_response_is_predict(dt):
    check_offset(small(dt))


@pytest.mark.parametrize("dt", [None, 1.0])
@pytest.mark.parametrize("discrete", [False, True])
def test_shifted_is_about_the_equilibrium(dt, discrete):
    model = small(dt)
    if discrete and dt is None:
        pytest.skip("a continuous model has no step")
    C = np.random.default_rng(2).standard_normal((2, 5))
    plant, rest = model.plant(offset="shifted", discrete=discrete, output=C)
    t = np.arange(31.0)
    np.testing.assert_allclose(model.predict(rest, None, t), np.tile(rest, (31, 1)), rtol=1e-10)
    z0 = np.random.default_rng(1).standard_normal(5)
    u = commands(model, 30, held=True)
    found = ct.forced_response(plant, t, np.vstack([u, u[-1:]]).T, z0 - rest)
    known = model.predict(z0, u, t) @ C.T
    assert np.abs(found.outputs.T + C @ rest - known).max() < TOLERANCE * np.abs(known).max()


def test_no_equilibrium_where_the_offset_pushes_an_integrator():
    drifting = LatentModel(A=np.diag([-1.0, 0.0]), offset=np.array([1.0, 0.5]), B=np.eye(2))
    with pytest.raises(DataError, match=r"no equilibrium.*integrator"):
        drifting.plant(offset="shifted")
    held = drifting.equilibrium(np.array([0.0, -0.5]))  # a command stops it
    np.testing.assert_allclose(held, [1.0, 0.0])
    still = LatentModel(A=np.diag([-1.0, 0.0]), offset=np.array([1.0, 0.0]))
    np.testing.assert_allclose(still.plant(offset="shifted")[1], [1.0, 0.0])


def test_an_input_called_one_is_refused():
    model = LatentModel(A=-np.eye(1), B=np.ones((1, 1)), input_names=("one",))
    with pytest.raises(ParameterError, match=r"'one'.*offset='drop'"):
        model.plant()
    assert model.plant(offset="drop").input_labels == ["one"]
    with pytest.raises(ParameterError, match="offset"):
        model.plant(offset="none")
