"""What a coupling and coupled cells are asked for: the contract, not the class."""

from dataclasses import dataclass

import numpy as np
import pytest

import cellsys as cs
from cellsys.contracts import Cells, needs
from cellsys.population import CellPort, Feedback, LoadPorts, PatchPort, Superposition, couple
from tests.population.systems import model


@dataclass(frozen=True)
class Springs:
    """A matrix field of one's own: nodes on springs to the ground, K = k I, two numbers a node."""

    nodes: np.ndarray
    k: float = 2.0
    drag: float = 5.0

    @property
    def order(self):
        return 2 * len(self.nodes)

    @property
    def stiffness(self):
        return self.k * np.eye(self.order)

    @property
    def surface(self):
        return np.arange(len(self.nodes))

    def project(self, f):
        return np.asarray(f)[..., :2].reshape(*np.shape(f)[:-2], -1)

    def displacement(self, q):
        flat = np.asarray(q).reshape(*np.shape(q)[:-1], -1, 2)
        return np.concatenate([flat, np.zeros((*flat.shape[:-1], 1))], axis=-1)


def grid(n=4, spacing=6.0):
    axis = spacing * (np.arange(n) - 0.5 * (n - 1))
    return np.array([(x, y, 0.0) for x in axis for y in axis])


def port(dt=None):
    A = np.array([[-0.05, 0.02], [-0.02, -0.05]])
    return CellPort.collocated(
        A if dt is None else np.eye(2) + dt * A,
        np.eye(2),
        gamma=0.3,
        B=np.ones((2, 1)),
        offset=np.ones(2),
        dt=dt,
    )


PLACES = np.array([[-4.0, 0.0], [4.0, 2.0]])


def every_kind():
    """Coupled cells of every kind that `couple` makes of small cells."""
    ports = LoadPorts(field=Springs(grid()), positions=PLACES, port=PatchPort(radius=9.0))
    return {
        "superposed": couple(model(), 3),
        "fed back": couple(model(), 3, Feedback()),
        "continuous ports": couple(port(), coupling=ports),
        "ports with a step": couple(port(10.0), coupling=ports),
    }


@pytest.mark.parametrize("kind", list(every_kind()))
def test_coupled_cells_meet_the_contract(kind):
    cells = every_kind()[kind]
    needs(cells, Cells, "cells")
    t = 10.0 * np.arange(4)
    run = cells.simulate(t)
    assert isinstance(run, cs.Trajectory)
    assert len(cells.poles()) == cells.pole_set().count == len(cells.plant().A)
    assert cells.stability().verdict
    assert cells.n_cells * cells.order <= run.states.size


def test_a_field_of_ones_own_takes_cells():
    """K = k I: with no gain at the port the matrix relaxes at k / drag, whatever the cells do."""
    field = Springs(grid())
    silent = CellPort(A=port().A, F=np.eye(2), offset=np.ones(2))
    cells = couple(
        silent, coupling=LoadPorts(field=field, positions=PLACES, port=PatchPort(radius=9.0))
    )
    rates = np.sort(cells.poles().real)[: field.order]
    np.testing.assert_allclose(rates, -field.k / field.drag, rtol=1e-12)
    run = cells.simulate([0.0, 1e4])
    E = PatchPort(radius=9.0).gather(field, PLACES[0], 0.0)
    rest = np.linalg.solve(silent.A, -np.ones(2))  # of each cell: it feels nothing
    other = PatchPort(radius=9.0).gather(field, PLACES[1], 0.0)
    np.testing.assert_allclose(run.block("q")[-1], (E + other).T @ rest / field.k, rtol=1e-9)


def test_a_field_that_lacks_something_is_refused_by_what_it_lacks():
    class Bare:
        order, drag, nodes, surface = 3, 1.0, grid(), np.arange(16)

    with pytest.raises(cs.ParameterError, match="stiffness"):
        LoadPorts(field=Bare(), positions=PLACES)


def test_a_coupling_of_ones_own_joins():
    @dataclass(frozen=True)
    class Alone:
        """Cells that do not meet: a printed form on a graph without weights."""

        name = "Alone"

        def join(self, request):
            K = request.count()
            return couple(request.model, graph=np.zeros((K, K)))

    one = model()
    cells = couple(one, 3, Alone())
    values = np.linalg.eigvals(one.A)
    assert cells.n_cells == 3
    assert all(np.abs(values - pole).min() < 1e-10 for pole in cells.poles())


def test_what_is_no_coupling_or_makes_no_cells_is_refused():
    class Nothing:
        name = "Nothing"

        def join(self, request):
            return 3

    with pytest.raises(cs.ParameterError, match=r"Nothing\.join\(\.\.\.\) must be .*coupled cells"):
        couple(model(), 3, Nothing())
    with pytest.raises(cs.ParameterError, match=r"coupling.*cs\.Superposition"):
        couple(model(), 3, "superposition")
    with pytest.raises(cs.DimensionError, match="numbers of cells differ"):
        couple(model(), 3, Superposition(), headings=[0.0, 1.0])
