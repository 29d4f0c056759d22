"""Layouts name entries; an OdeSystem refuses what does not fit; a Trajectory checks its arrays."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellsys.errors import (
    DataError,
    DimensionError,
    IntegrationError,
    NotSymbolicError,
    ParameterError,
)
from cellsys.system import Block, Layout, OdeSystem
from cellsys.trajectory import Trajectory

shapes = st.lists(
    st.tuples(st.integers(1, 4)) | st.tuples(st.integers(1, 4), st.just(3)) | st.just(()),
    max_size=6,
)


@given(shapes)
def test_blocks_tile_the_vector_in_order(found):
    layout = Layout([Block(f"b{i}", s) for i, s in enumerate(found)])
    x = np.arange(layout.size, dtype=float)
    pieces = [layout.view(x, f"b{i}") for i in range(len(found))]
    assert [p.shape for p in pieces] == list(found)
    assert np.array_equal(np.concatenate([p.ravel() for p in pieces] or [x]), x)
    assert len(layout.names) == len(set(layout.names)) == layout.size


@given(shapes)
def test_a_view_writes_through_and_keeps_leading_axes(found):
    layout = Layout([Block(f"b{i}", s) for i, s in enumerate(found)])
    x = np.zeros((5, layout.size))
    for i in range(len(found)):
        layout.view(x, f"b{i}")[:] = i + 1
    for i in range(len(found)):
        assert np.all(x[:, layout.slice(f"b{i}")] == i + 1)


def test_where_selects_by_role_and_kind():
    layout = Layout(
        [
            Block("a", (2,), role="component"),
            Block("m", (3,), role="field"),
            Block("p", kind="internal"),
        ]
    )
    assert layout.where(role="field").tolist() == [2, 3, 4]
    assert layout.where(kind="internal").tolist() == [5]
    assert layout.where().size == layout.size
    assert layout[0].name == "a"
    assert layout["m"].size == 3
    assert "m" in layout
    assert "q" not in layout
    assert layout + Layout(["z"]) == Layout([*layout, "z"])


def test_layout_refusals():
    with pytest.raises(ParameterError, match="unique"):
        Layout(["a", "a"])
    with pytest.raises(KeyError, match="known blocks: a, b"):
        Layout(["a", "b"]).slice("c")
    with pytest.raises(ParameterError, match="role"):
        Block("a", role="thing")


def oscillator(**changes):
    given = {
        "states": ["x", "v"],
        "auxiliaries": ["force"],
        "x0": [1.0, 0.0],
        "W_x": [[0.0, 1.0], [0.0, 0.0]],
        "W_eta": [[0.0], [1.0]],
        "law": lambda t, x: [-(x[0] ** 3)],
    }
    return OdeSystem(**{**given, **changes})


def test_rhs_is_linear_in_the_auxiliaries():
    system = oscillator(forcing=lambda t, x: np.array([0.0, np.sin(t)]))
    x, t = np.array([0.7, -0.2]), 0.3
    expected = system.W_x @ x + system.W_eta @ system.eta(t, x) + system.u(t, x)
    assert np.array_equal(system.rhs(t, x), expected)
    assert system.rhs(t, x) == pytest.approx([-0.2, -(0.7**3) + np.sin(0.3)], rel=1e-15)


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({"x0": [1.0]}, DimensionError, r"x0 must have shape \(2,\)"),
        ({"x0": [1.0, np.nan]}, DataError, "'v' is .*nan"),
        ({"x0": [np.inf, 0.0]}, DataError, "'x' is .*inf"),
        ({"W_x": np.zeros((3, 3))}, DimensionError, "W_x must have shape"),
        ({"W_eta": [[np.nan], [1.0]]}, DataError, "W_eta holds NaN"),
        ({"law": None}, ParameterError, "needs law"),
    ],
)
def test_systems_that_do_not_fit_are_refused(changes, kind, words):
    with pytest.raises(kind, match=words):
        oscillator(**changes)


def test_initial_state_is_a_read_only_copy():
    start = np.array([1.0, 0.0])
    system = oscillator(x0=start)
    start[0] = 5.0
    assert system.x0[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        system.x0[0] = 2.0


def test_symbolic_form_agrees_with_the_numbers():
    import casadi as ca

    system = oscillator()
    form = system.casadi()
    f = ca.Function("f", [form.t, form.x], [form.xdot, form.eta])
    xdot, eta = f(0.0, [0.3, -0.8])
    assert np.asarray(xdot).ravel() == pytest.approx(
        system.rhs(0.0, np.array([0.3, -0.8])), rel=1e-15
    )
    assert np.asarray(eta).ravel() == pytest.approx([-(0.3**3)], rel=1e-15)


def test_numeric_only_laws_say_so():
    system = oscillator(law=lambda t, x: [float(x[0])])
    with pytest.raises(NotSymbolicError, match="numeric integrator"):
        system.casadi()


def test_trajectory_checks_shapes_and_times():
    states = Layout(["x"])
    with pytest.raises(DimensionError, match="x must have shape"):
        Trajectory(t=np.arange(3.0), x=np.zeros((2, 1)), states=states)
    with pytest.raises(DataError, match="increase"):
        Trajectory(t=np.array([0.0, 0.0]), x=np.zeros((2, 1)), states=states)
    with pytest.raises(DimensionError, match="eta must have shape"):
        Trajectory(
            t=np.arange(3.0),
            x=np.zeros((3, 1)),
            states=states,
            eta=np.zeros((3, 1)),
            auxiliaries=Layout(["e"]),
        )
    run = Trajectory(t=np.arange(3.0), x=np.zeros((3, 1)), states=states)
    assert len(run) == 3
    with pytest.raises(DataError, match="without its auxiliaries"):
        run.auxiliary("e")
    with pytest.raises(DataError, match="without its auxiliaries"):
        run.residual_share()


def test_integration_error_survives_a_process_boundary():
    error = IntegrationError("diverged", time=3.5, state_norm=1e9, step=0.1)
    back = pickle.loads(pickle.dumps(error))
    assert str(back) == str(error)
    assert (back.time, back.state_norm, back.step) == (3.5, 1e9, 0.1)
    assert "t = 3.5 s" in str(error)
    assert isinstance(error, RuntimeError)


def test_a_system_of_compiled_loops_has_no_symbolic_form():
    """Its laws are not seen by CasADi: a form without them would be wrong without a word."""

    class Compiled(OdeSystem):
        def eta(self, t, x):
            return -x

    system = Compiled(states=["a"], auxiliaries=["f"], x0=[1.0], W_eta=[[1.0]])
    with pytest.raises(NotSymbolicError, match="compiled loops"):
        system.casadi()
