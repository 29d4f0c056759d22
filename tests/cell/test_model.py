"""The model: symmetry, roll-outs, plant, poles, files, refusals."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

import cellsys as cs
from cellsys.cell.records import read_records
from cellsys.cell.reductor import sites_of
from cellsys.model import basis_of
from cellsys.samples.commands import harmonic_value

from .runs import data, model, runs


def commands(m, K=30, seed=0):
    rng = np.random.default_rng(seed)
    amplitude = rng.uniform(0.4, 1.6, K)
    heading = np.cumsum(rng.uniform(-0.2, 0.2, K))
    table = np.column_stack([harmonic_value(n, amplitude, heading) for n in m.input_names])
    return amplitude, heading, table


@pytest.mark.slow
def test_roll_out_turns_with_its_commands():
    """Exact: the matrices are real and the heading enters as e^{iq theta}."""
    m = model()
    amplitude, heading, _ = commands(m)
    alpha = 1.234
    c, s = np.cos(alpha), np.sin(alpha)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    z0 = np.zeros(m.order)
    a = m.dynamics.split(m.simulate_commands(z0, amplitude, heading))
    b = m.dynamics.split(m.simulate_commands(z0, amplitude, heading + alpha))
    for q, (x, y) in enumerate(zip(a.x, b.x, strict=True)):
        np.testing.assert_allclose(y, x * np.exp(1j * q * alpha), atol=1e-11)
    np.testing.assert_allclose(b.place, a.place @ R[:2, :2].T, atol=1e-11)


def test_predict_and_charges_agree():
    m = model()
    amplitude, heading, table = commands(m)
    z = m.predict(m.z_start, table, m.dt * np.arange(31))
    other = m.simulate_commands(m.z_start, amplitude, heading)
    np.testing.assert_allclose(z, other, atol=1e-11)


SLOW = [pytest.param(m, marks=pytest.mark.slow) for m in (40, 90)]


@pytest.mark.parametrize("order", [5, 9, 16, *SLOW])
def test_every_order_contracts(order):
    train, _ = data()
    m = cs.Equivariant(iterations=3, folds=0).fit(train, order)
    assert m.dynamics.norm() <= 1.0 + 1e-12
    assert order - 1 <= m.order <= order  # a complex mode takes two states
    long = m.simulate_commands(m.z_start, np.full(100_000, 1.3), np.full(100_000, 0.4))
    sizes = [np.abs(x).max() for x in m.dynamics.split(long).x if x.size]
    assert max(sizes) < 1e4  # |x_0| + sup |input| / margin


def test_frozen_plant_has_the_poles_of_the_charges():
    """As a real state space every pole of charge q > 0 is double; the centroid adds 0 twice."""
    m = model()
    plant = m.at(100.0).plant()
    found = np.linalg.eigvals(plant.A)
    labelled = [p.value for p in m.labelled_poles(100.0) for _ in range(p.multiplicity)]
    wanted = np.array([*labelled, 0.0, 0.0])
    gap = np.abs(found[:, None] - wanted)
    assert gap[linear_sum_assignment(gap)].max() < 1e-5  # pairs split like sqrt(eps)/dt
    assert plant.dt == 0
    assert {p.charge for p in m.labelled_poles()} <= set(range(6))


def test_start_and_encoding_round_trip():
    m, (train, _) = model(), runs()
    run = train[0]
    x0 = np.array(run.x[0])[: m.states.size]
    place = m.states.view(x0, "cell1.position")
    nodes = place.copy()
    z = m.encode(x0)
    np.testing.assert_allclose(z[:-2], m.z_start[:-2], atol=1e-9)  # all runs start alike
    # Shapes are measured from a sphere, the free cell at rest is a few hundredths of a um off it.
    assert np.abs(m.nodes(z) - nodes).max() < 0.05
    place[:] = nodes.mean(axis=0) + m.representation.shape.sphere
    z = m.encode(x0)
    assert np.abs(z[:-2]).max() < 1e-9
    np.testing.assert_allclose(m.nodes(z), place, atol=1e-9)
    assert m.reconstruct(z).shape == (nodes.size,)


def test_forces_on_the_matrix_come_back_from_the_coordinates():
    """Totals agree to what the modes and the port leave out, 20 % of a half-spread cell's pull."""
    m, (train, _) = model(40), runs()
    run = train[0]
    snaps = data()[0]
    k = len(run.t) - 3
    eta = np.asarray(snaps.runs[0].eta[k : k + 1])
    true = m.load_of(eta)[0]
    z = m.encode(np.asarray(snaps.runs[0].x[k]), eta[0])
    found = m.matrix_forces(z)
    assert found.shape == true.shape
    assert np.linalg.norm(found.sum(axis=0) - true.sum(axis=0)) < 0.2 * np.abs(true).sum()
    assert np.sum(found * true) > 0.5 * np.linalg.norm(found) * np.linalg.norm(true)


def test_held_out_prediction_beats_every_baseline_and_says_so():
    card = model(30).card
    row = card.held_out["cells"]
    baselines = [
        v for k, v in row.items() if k in ("nothing moves", "mean velocity", "mean motion")
    ]
    assert row["floor"] < row["model"] < min(baselines)
    assert "better than" in card.verdict
    assert card.facts["order per charge"][0] >= 1
    assert "0.999" in card.facts["contraction norm"]


def test_a_set_of_constant_headings_is_warned_about():
    train, _ = data()
    still = [
        dataclasses.replace(r, commands=np.tile(r.commands[:1], (len(r.commands), 1)))
        for r in train.runs
    ]
    same = dataclasses.replace(train, runs=tuple(still))
    m = cs.reduce(same, order=8, method=cs.Equivariant(iterations=1, folds=0))
    assert any("one trajectory" in text for text in m.card.warnings)
    assert not any("one trajectory" in text for text in model().card.warnings) or all(
        np.ptp(r.commands[:, 0]) == 0 for r in train.runs
    )


def test_file_round_trip_is_exact_and_certified(tmp_path):
    m = model()
    path = m.save(tmp_path / "m.npz")
    for loaded in (cs.EquivariantModel.load(path), cs.LatentModel.load(path)):
        assert isinstance(loaded, cs.EquivariantModel)
        amplitude, heading, _ = commands(m)
        a = m.forecast(amplitude, heading)
        b = loaded.forecast(amplitude, heading)
        np.testing.assert_array_equal(a.z, b.z)
        np.testing.assert_array_equal(a.half_width, b.half_width)
        assert a.flags == b.flags
        assert str(loaded) == str(m)


def test_file_that_claims_contraction_falsely_is_refused(tmp_path):
    m = model()
    path = m.save(tmp_path / "m.npz")
    with np.load(path, allow_pickle=False) as stored:
        arrays = {k: stored[k] for k in stored.files}
    arrays["A 0"] = 1.5 * arrays["A 0"]
    np.savez(path, **arrays)
    with pytest.raises(cs.FileFormatError, match="contraction"):
        cs.LatentModel.load(path)


def test_a_basis_is_refused_by_name():
    for name in ("P_phi", "the matrix rows"):
        with pytest.raises(cs.RepresentationError, match=f"{name} needs the rows of V"):
            basis_of(model(), name)
    assert not hasattr(model(), "V")  # a sibling of LatentModel, not a kind of it
    assert not isinstance(model(), cs.LatentModel)


def test_fields_are_replaced_as_in_any_dataclass():
    m = model()
    other = dataclasses.replace(m, horizon=30.0, left_out="group of runs")
    assert other.left_out == "group of runs"
    np.testing.assert_array_equal(other.A, m.at(30.0).A)
    frozen = dataclasses.replace(m.at(30.0), left_out="stretch")
    assert (frozen.left_out, frozen.order) == ("stretch", m.order)
    with pytest.raises(ValueError, match="init=False"):
        dataclasses.replace(m, A=m.A)  # it follows from the dynamics


@pytest.mark.parametrize(
    ("change", "error", "word"),
    [
        ({"step": 7.0}, cs.ParameterError, "multiple"),
        ({"step": -1.0}, cs.ParameterError, "step"),
        ({"margin": 1.5}, cs.ParameterError, "margin"),
        ({"folds": 1}, cs.ParameterError, "folds"),
        ({"load_share": 0.0}, cs.ParameterError, "load_share"),
    ],
)
def test_bad_settings_are_refused(change, error, word):
    with pytest.raises(error, match=word):
        cs.Equivariant(**change).fit(data()[0], 10)


def test_orders_beyond_the_data_and_runs_without_a_matrix_are_refused():
    train, _ = data()
    with pytest.raises(cs.RankError, match="order 2000"):
        cs.Equivariant(iterations=0).fit(train, 2000)
    with pytest.raises(cs.RankError, match="5 states"):
        cs.Equivariant(iterations=0).fit(train, 4)
    with pytest.raises(cs.DataError, match=r"matrix\.rest"):
        cs.Equivariant().fit(dataclasses.replace(train, geometry={}), 10)
    blind = dataclasses.replace(train.runs[0], commands=None)
    with pytest.raises(cs.DataError, match="commands"):
        cs.Equivariant().fit(dataclasses.replace(train, runs=(blind,)), 10)


def test_loads_are_read_where_they_are_asked_for(monkeypatch):
    """Of columns kept on disk never the whole; it was, once per sample, in the main job."""
    train, _ = data()
    eta = train.runs[0].eta
    assert not isinstance(eta, np.ndarray)  # chosen columns, read on demand

    def whole(*arguments):
        raise RuntimeError("the whole array was read")

    monkeypatch.setattr(type(eta), "__array__", whole)
    with pytest.raises(RuntimeError):  # naive
        np.asarray(eta)
    method = cs.Equivariant()
    assert read_records(train, method.step, method.port)


def test_tolerance_chooses_the_smallest_order():
    train, _ = data()
    method = cs.Equivariant(iterations=0, folds=0)
    order = method.order_for(train, 0.01)
    records = read_records(train, method.step, method.port)
    share = []
    for m in (order, order - 2):
        fitted = method.fit_records(records, train, m, sites_of(train))
        lost = total = 0.0
        for r in records:
            _, features = fitted.representation.features(r.nodes, r.loads)
            back = fitted.modes.decode(fitted.modes.encode(features))
            lost += sum(np.sum(np.abs(features[q] - back[q]) ** 2) for q in features)
            total += sum(np.sum(np.abs(f) ** 2) for f in features.values())
        share.append(lost / total)
    assert share[0] <= 0.01 < share[1]


def test_bands_need_runs_and_flags_name_what_is_outside():
    m = model()
    amplitude, heading, _ = commands(m, 15)
    calm = m.forecast(np.clip(amplitude, 0.8, 1.2), np.full(15, heading[0]))
    wild = m.forecast(3.0 * amplitude, heading)
    assert calm.half_width.shape == (16, 3)
    assert np.all(calm.half_width >= 0)
    assert any("amplitude (high)" in f.what for f in wild.flags)
    few = dataclasses.replace(data()[0], runs=data()[0].runs[:2])
    alone = cs.reduce(few, order=8, method=cs.Equivariant(iterations=1))
    assert alone.bands is None
    assert np.all(np.isnan(alone.forecast(amplitude, heading).half_width))
