"""The sensor on the shared field: the law of the full-order model, cells that meet, refusals."""

import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import ParameterError
from cellsys.model.network_sensor import LocalSensor, StiffnessMap
from cellsys.population import FieldSensor, LoadPorts, couple
from cellsys.ports.field_sensor import standing_on
from tests.cell.runs import model as trained
from tests.cell.runs import scene
from tests.population.test_equivariant_cells import PAIR, model
from tests.study.scenes import TINY


@pytest.fixture(scope="module")
def system():
    return cs.build(cs.Scene.parse(tomllib.loads(TINY)))


@pytest.fixture(scope="module")
def field(system):
    return cs.GalerkinField(system=system, order=60, places=20)


@pytest.mark.parametrize("measure", ["stiffness", "stress"])
def test_it_senses_what_the_full_order_model_senses(measure):
    """On a run's own displacement, carried by a field with all coordinates."""
    table = tomllib.loads(TINY)
    table["effects"]["stiffness_sensing"] = {"measure": measure}
    scene = cs.Scene.parse(table)
    system = cs.build(scene)
    run = cs.simulate(system, cs.LinearlyImplicit(step=0.5), np.array([0.0, 10.0, 20.0]))
    whole = cs.full_field(system)
    u = run.block("matrix.displacement")
    sensor = FieldSensor.of(scene.effects["stiffness_sensing"])
    for k in (1, 2):
        q = whole.project(u[k])  # orthonormal coordinates
        assert np.abs(whole.displacement(q) - u[k]).max() < 1e-12
        place = run.block("cell1.position")[k].mean(axis=0)[:2]
        d = sensor.directions(whole, q, place[None], run.p[k])
        np.testing.assert_allclose(d, run.d[k], atol=1e-9)


def test_a_load_beside_a_cell_turns_it_and_its_own_state_does_not(field):
    """The same cells, the field strained by something else: only the field's sensor can know."""
    m = model(0.0, field=field)
    law = cs.PolarityLaw(kappa=1 / 60)
    ports = LoadPorts(field=field, positions=PAIR[:1])
    f = np.zeros((len(field.nodes), 3))
    near = np.linalg.norm(field.nodes[:, :2] - (2.0, 6.0), axis=1) < 4.0
    f[near, 1] = 400.0  # pN: pulled away, the fibres between stretch, those behind buckle
    q = np.zeros(field.order)
    for _ in range(5):
        q, _ = field.step(q, field.project(f), 10.0)
    place, p = PAIR[:1], np.array([[1.0, 0.0, 0.0]])
    rest = FieldSensor().directions(field, np.zeros(field.order), place, p)
    strained = FieldSensor().directions(field, q, place, p)
    turned = np.degrees(np.arccos(np.clip(np.sum(rest * strained), -1, 1)))
    assert turned > 5.0
    cells = couple(m, coupling=ports, controller=law, sensor=FieldSensor())
    run = cells.simulate(10.0 * np.arange(4))
    assert np.abs(np.linalg.norm(run.p, axis=2) - 1.0).max() < 1e-12
    assert np.abs(np.linalg.norm(run.d, axis=2) - 1.0).max() < 1e-12


def test_cells_far_apart_sense_alone_and_near_ones_do_not(field):
    """Through the field's fibres a neighbour changes what is sensed; own-state sensors cannot."""
    m = model(0.0, field=field)
    law, t = cs.PolarityLaw(kappa=1 / 60), 10.0 * np.arange(6)

    def sensed(places, sensor):
        ports = LoadPorts(field=field, positions=places)
        return couple(m, coupling=ports, controller=law, sensor=sensor).simulate(t).d[-1, 0]

    near = np.array([[-5.0, 0.0], [5.0, 0.0]])
    for sensor, least, most in ((FieldSensor(), 1e-3, 4.0), (m.sensor, 0.0, 1e-12)):
        gap = np.abs(sensed(near, sensor) - sensed(near[:1], sensor)).max()
        assert least <= gap <= most


def test_cells_outside_the_trained_range_are_named():
    m = trained()
    field = cs.GalerkinField(system=cs.build(scene()), order=40, places=20)
    cells = couple(
        m,
        coupling=LoadPorts(field=field, positions=[[-4.0, 0.0], [5.0, 1.0]]),
        sensor=FieldSensor(),
    )
    usual, much = float(np.mean(m.monitor.amplitude)), 3 * m.monitor.amplitude[1]
    run = cells.simulate(10.0 * np.arange(4), amplitude=np.array([usual, much]))
    wrong = [e.detail for e in run.events if "amplitude" in e.detail]
    assert wrong
    assert all(text.startswith("cell2") for text in wrong)
    assert run.model_error


def test_refusals(field):
    with pytest.raises(ParameterError, match="measure"):
        FieldSensor("colour")
    with pytest.raises(ParameterError, match="reach"):
        FieldSensor(reach=0.5)
    with pytest.raises(ParameterError, match="threshold"):
        FieldSensor(threshold=float("nan"))
    nodes = np.array([[float(i), 0.0, 0.0] for i in range(4)])
    linear = cs.LinearField(nodes, np.eye(12), 1.0)
    with pytest.raises(ParameterError, match="fibres"):
        FieldSensor().directions(linear, np.zeros(12), np.zeros((1, 2)), np.eye(3)[:1])


def test_cells_on_another_matrix_read_its_network(system, field):
    """A sensor that kept the network it was fitted on would look at fibres that are not there."""
    m, rest = model(0.0, field=field), system.geometry()
    K_s, elsewhere = np.vstack([np.eye(2), np.zeros(2)]), np.array([[5.0, 0.0], [9.0, 4.0]])
    own = LocalSensor(
        K_d=np.zeros((3, 1 + m.order)), K_s=K_s, map=StiffnessMap(elsewhere, np.ones(2), 9.0)
    )
    cells = couple(m, coupling=LoadPorts(field=field, positions=PAIR), sensor=own)
    assert np.array_equal(cells.sensor.map.nodes, rest["matrix.rest"][:, :2])
    np.testing.assert_allclose(cells.sensor.map.stiffness, rest["matrix.stiffness"], rtol=1e-14)
    assert cells.sensor.map.reach == 9.0
    assert not np.allclose(cells.sensor.map.at(PAIR), own.map.at(PAIR))
    blind = LocalSensor(K_d=np.zeros((3, 1 + m.order)), map=own.map)
    assert couple(m, coupling=LoadPorts(field=field, positions=PAIR), sensor=blind).sensor is blind
    bare = SimpleNamespace(nodes=field.nodes)
    with pytest.raises(ParameterError, match="network of 2 nodes"):
        standing_on(bare, own)
    here = own.on(rest["matrix.rest"], rest["matrix.stiffness"])
    assert standing_on(bare, here) is here
