"""The literal scene: what a logged sample means, accuracy of its step, resuming, magnitudes."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from cellsys.effects.adhesion import FocalAdhesion
from cellsys.errors import IntegrationError
from cellsys.geometry.membrane import enclosed_volume
from cellsys.integrate import ExplicitEuler, LinearlyImplicit, simulate, stability_limit
from cellsys.integrate.record import record_shapes
from cellsys.scene import Scene, build, load_scene
from cellsys.store import RunWriter
from tests.mechanics.scenes import small, table

SCENE = Path(__file__).resolve().parents[2] / "examples" / "spreading_literal.toml"
STEP = 0.5


@pytest.fixture(scope="module")
def system():
    return build(load_scene(SCENE))


@pytest.fixture(scope="module")
def runs(system):
    """100 s at three steps."""
    t = np.arange(0.0, 101.0, 5.0)
    return {h: simulate(system, LinearlyImplicit(step=h), t) for h in (0.5, 0.25, 0.125)}


def test_w_eta_is_constant_and_sparse(system):
    """One entry per moving row of every port, 1/C; nothing depends on the state."""
    W = system.W_eta.copy()
    rows = np.diff(W.indptr)
    assert W.nnz < 8 * W.shape[0]
    assert W.data.min() > 0
    cell = system.states.slice("cell1.position")
    assert np.unique(W[cell].data).tolist() == [1.0 / 2000.0]
    matrix = system.states.slice("matrix.displacement")
    assert np.unique(W[matrix].data).tolist() == [1.0 / 1000.0]
    held = np.repeat(system.matrix.clamped, 3)
    assert not rows[matrix][held].any()
    simulate(system, LinearlyImplicit(step=STEP), np.array([0.0, 5.0]))
    assert (abs(W - system.W_eta)).nnz == 0
    assert system.W_x.nnz == 0  # linear laws stay in eta: the log holds averages


@pytest.mark.parametrize("step", [0.5, 0.25, 0.125])
def test_every_sample_obeys_the_equation(runs, step):
    run = runs[step]
    rate = np.diff(run.x, axis=0) / np.diff(run.t)[:, None]
    right = run.eta @ run.W_eta.T + run.u
    # Cancellation of forces of 1e3 pN times 1/C of 1e-3 um/(pN s): rounding of order 1e-15.
    assert np.abs(rate - right).max() < 1e-13


def test_residual_is_below_five_percent_and_first_order(runs):
    share = {h: r.residual_share() for h, r in runs.items()}
    for block in ("cell1.position", "matrix.displacement"):
        assert share[STEP][block] < 0.05
        # At least first order. (At 1 s the stepper makes two corrections, and the share is
        # lower than the order promises: 0.013 and 0.048, measured.)
        assert share[0.25][block] < 0.55 * share[0.5][block]
        assert share[0.125][block] < 0.5 * share[0.25][block]


def test_naive_log_of_the_laws_at_the_sample_is_far_off(runs, system):
    """eta at t_k instead of the interval's average misses far more than the step residual."""
    run = runs[STEP]
    piece = system.states.slice("matrix.displacement")
    missed = []
    for k in range(5, 15):
        rate = (run.x[k + 1] - run.x[k]) / 5.0
        missed.append((rate - system.rhs(float(run.t[k]), run.x[k].copy()))[piece])
    rate = np.diff(run.x, axis=0)[5:15, piece] / 5.0
    naive = np.linalg.norm(missed) / np.linalg.norm(rate)
    assert naive > 2.0 * run.residual_share()["matrix.displacement"]


def test_initial_laws_are_the_instantaneous_ones(runs, system):
    n = system.auxiliaries.size
    assert np.array_equal(runs[STEP].eta_start[:n], system.eta(0.0, system.x0.copy()))


def rms(a, b, block, at=-1):
    """Rms over nodes of the distance at a sample, by default the last, nm."""
    gap = a.block(block)[at] - b.block(block)[at]
    return 1e3 * float(np.sqrt((gap**2).sum(axis=1).mean()))


def test_first_order_on_the_full_model(runs):
    # A half, and some slack for the share of the second order; on the matrix (0.05 nm in all)
    # that share has the opposite sign at 0.5 s, which brings the ratio nearer to one.
    for block, most in (("cell1.position", 0.6), ("matrix.displacement", 0.75)):
        coarse = rms(runs[0.5], runs[0.25], block)
        fine = rms(runs[0.25], runs[0.125], block)
        assert fine < most * coarse


@pytest.mark.slow
def test_shipped_step_against_explicit_euler(system):
    """After 100 s: 1 nm rms on the matrix, 5 nm on the membrane (targets of the issue)."""
    t = np.arange(0.0, 101.0, 5.0)
    limit = stability_limit(system)
    reference = simulate(system, ExplicitEuler(step=limit), t, auxiliaries=False)
    run = simulate(system, LinearlyImplicit(step=STEP), t)
    assert rms(run, reference, "matrix.displacement") < 1.0
    assert rms(run, reference, "cell1.position") < 5.0
    # The reference itself, over the fastest part: its first-order error is its distance to half
    # the step.
    fine = simulate(system, ExplicitEuler(step=0.5 * limit), t[:5], auxiliaries=False)
    assert rms(reference, fine, "matrix.displacement", 4) < 0.1
    assert rms(reference, fine, "cell1.position", 4) < 0.5


@pytest.mark.slow
def test_a_run_of_1500_s_has_the_magnitudes_of_the_issue(system):
    t = np.arange(0.0, 1501.0, 5.0)
    run = simulate(system, LinearlyImplicit(step=STEP), t)
    x, u = run.block("cell1.position"), run.block("matrix.displacement")
    mesh = system.cells[0].body.membrane
    volume = np.array([enclosed_volume(q, mesh.triangles) for q in x[::10]]) / mesh.volume
    assert np.abs(volume - 1.0).max() < 0.15
    assert np.abs(np.linalg.norm(run.p[:, 0], axis=1) - 1.0).max() < 1e-12
    speed = 1e3 * np.linalg.norm(np.diff(x, axis=0), axis=2) / 5.0
    assert 4.0 < speed.mean() < 9.0
    assert np.linalg.norm(u, axis=2).max() < 1.5
    assert not u[:, system.matrix.clamped].any()
    assert run.residual_share()["matrix.displacement"] < 0.05
    assert run.residual_share()["cell1.position"] < 0.05


def shifted_run(kinetics, by, seed, length):
    """Cell positions of a crawl at constant heading on an even disc, started `by` um aside."""
    spec = load_scene(SCENE)
    effects = {k: v for k, v in spec.effects.items() if k != "polarity"}
    effects["focal_adhesion"] = FocalAdhesion(kinetics=kinetics)
    x, y = spec.cells[0].position
    scene = dataclasses.replace(
        spec,
        cells=(dataclasses.replace(spec.cells[0], position=(x + by, y), polarity=0.5),),
        matrix=dataclasses.replace(spec.matrix, inclusion=None),
        effects=effects,
    )
    t = np.arange(0.0, length + 1.0, 5.0)
    run = simulate(build(scene), LinearlyImplicit(step=STEP), t, seed=seed, auxiliaries=False)
    return run.block("cell1.position"), run.events


def relative(a, b):
    return float(np.sqrt(((a - b) ** 2).sum() / ((a - a[0]) ** 2).sum()))


@pytest.mark.slow
def test_a_shift_of_5_nm_changes_little_with_the_clutch():
    """Relative change over 1500 s <= 0.001, the bound of the issue."""
    a, b = (shifted_run("clutch", by, 0, 1500.0)[0] for by in (0.0, 0.005))
    assert relative(a, b) <= 0.001


@pytest.mark.slow
def test_a_shift_of_5_nm_changes_much_with_switching():
    """One bond more or less: single runs change by 0.002 to 0.2, 0.08 in the mean of six."""
    changes, seed = [], 2
    a, events = shifted_run("switching", 0.0, seed, 1500.0)
    names = [e.name for e in events]
    assert names.count("bind") >= 25
    assert names.count("rupture") >= 5
    crawled = np.hypot(*(a[-1] - a[0]).mean(axis=0)[:2])
    assert crawled > 2.0
    low = a[-1][a[-1][:, 2] < 1.0]
    assert np.hypot(*(low - a[-1].mean(axis=0))[:, :2].T).max() > 6.0  # it has spread
    for by in (0.005, -0.005):
        changes.append(relative(a, shifted_run("switching", by, seed, 1500.0)[0]))
    assert 0.01 < np.mean(changes) < 0.5


def test_volume_is_kept_within_15_percent(runs, system):
    mesh = system.cells[0].body.membrane
    for x in runs[STEP].block("cell1.position"):
        assert enclosed_volume(x, mesh.triangles) == pytest.approx(mesh.volume, rel=0.15)


def test_polarity_keeps_its_length(runs):
    assert np.abs(np.linalg.norm(runs[STEP].p[:, 0], axis=1) - 1.0).max() < 1e-12
    assert np.abs(np.linalg.norm(runs[STEP].d[:, 0], axis=1) - 1.0).max() < 1e-12


def test_switching_keeps_its_residual_below_five_percent_at_half_the_step():
    """Jumps want a step of 0.25 s, as the effect's text says (0.12 of the matrix at 0.5 s)."""
    spec = load_scene(SCENE)
    effects = {**spec.effects, "focal_adhesion": FocalAdhesion(kinetics="switching")}
    system = build(dataclasses.replace(spec, effects=effects))
    run = simulate(system, LinearlyImplicit(step=0.25), np.arange(0.0, 101.0, 5.0))
    for share in run.residual_share().values():
        assert share < 0.05
    rate = np.diff(run.x, axis=0) / np.diff(run.t)[:, None]
    assert np.abs(rate - run.eta @ run.W_eta.T - run.u).max() < 1e-11  # bond numbers reach 50


# Smaller systems: seeds, resuming, stop points


class Interrupted(RuntimeError):
    pass


class Stopping(RunWriter):
    """A run folder whose process dies right after its first checkpoint."""

    def checkpoint(self, arrays, metadata):
        super().checkpoint(arrays, metadata)
        raise Interrupted


KINETICS = {
    "clutch": {},
    "switching": {
        "focal_adhesion": {
            "kinetics": "switching",
            "bind_rate": "1 1/s",
            "bond_force": "2 pN",
            "bind_distance": "2 um",
        }
    },
}


@pytest.mark.parametrize("kinetics", KINETICS)
def test_same_seed_same_run_and_an_interrupted_run_continues_bit_for_bit(tmp_path, kinetics):
    t = np.arange(0.0, 36.0)
    method = LinearlyImplicit(step=STEP)
    whole = simulate(small(**KINETICS[kinetics]), method, t, seed=5)
    shapes = record_shapes(small(**KINETICS[kinetics]), t, True)
    with pytest.raises(Interrupted):
        simulate(
            small(**KINETICS[kinetics]),
            method,
            t,
            seed=5,
            sink=Stopping(tmp_path / "r", shapes, {}),
        )
    sink = RunWriter(tmp_path / "r", shapes, {})
    assert sink.resumed
    sink.arrays["x"][21:] = np.nan
    resumed = simulate(small(**KINETICS[kinetics]), method, t, seed=5, sink=sink)
    for name in ("x", "eta", "u", "p", "d", "eta_start"):
        assert np.array_equal(getattr(resumed, name), getattr(whole, name)), name
    assert resumed.events == whole.events
    if kinetics == "switching":
        assert {e.name for e in whole.events} >= {"bind"}
        other = simulate(small(**KINETICS[kinetics]), method, t[:11], seed=6)
        assert not np.array_equal(other.x, whole.x[:11])


def test_a_second_run_does_not_see_the_first():
    """Kept tangents and factors are forgotten: the same system gives the same run twice."""
    system, t = small(), np.arange(0.0, 21.0, 5.0)
    first = simulate(system, LinearlyImplicit(step=STEP), t)
    x0 = system.x0.copy()
    system.states.view(x0, "cell1.position")[:, 2] -= 0.5
    simulate(system, LinearlyImplicit(step=STEP), t, x0=x0)
    assert np.array_equal(simulate(system, LinearlyImplicit(step=STEP), t).x, first.x)


def pulsed(times):
    """A passive disc with a triangular pulse of load, 1000 pN high."""
    spec = table()
    spec.pop("cells")
    keep = ("drag", "matrix_elasticity", "foundation")
    spec["effects"] = {k: spec["effects"][k] for k in keep}
    history = {"times": [f"{q} s" for q in times], "values": [0, 1, 0]}
    spec["effects"]["external_load"] = {"force": "1000 pN", "history": history}
    return build(Scene.parse(spec))


@pytest.mark.parametrize("method", [LinearlyImplicit(step=STEP), ExplicitEuler(step=0.01)])
def test_a_pulse_of_a_tenth_of_a_second_is_felt_exactly(method):
    """Impulse = 1000 pN x 0.05 s, spread over the patch, from knots between two samples."""
    system = pulsed((7.2, 7.25, 7.3))
    run = simulate(system, method, np.array([0.0, 5.0, 10.0]))
    total = 5.0 * run.u[1].reshape(-1, 3).sum(axis=0) * 1000.0
    assert total == pytest.approx([50.0, 0.0, 0.0], rel=1e-12, abs=1e-12)
    assert not run.u[0].any()
    assert np.abs(run.block("matrix.displacement")[2]).max() > 1e-6


def test_naive_stepping_over_the_pulse_feels_nothing():
    system = pulsed((7.2, 7.25, 7.3))
    object.__setattr__(system, "stop_points", tuple)
    run = simulate(system, LinearlyImplicit(step=STEP), np.array([0.0, 5.0, 10.0]))
    assert not run.u.any()
    assert np.abs(run.x).max() < 1e-10  # rest lengths are exact to the softening of 1e-12 um^2


def test_a_knot_at_a_sample_is_met_once():
    system = pulsed((5.0, 5.1, 5.2))
    run = simulate(system, LinearlyImplicit(step=STEP), np.array([0.0, 5.0, 10.0]))
    total = 5.0 * run.u[1].reshape(-1, 3).sum(axis=0) * 1000.0
    assert total[0] == pytest.approx(100.0, rel=1e-12)


def test_nan_in_the_mechanics_names_time_norm_and_step(monkeypatch):
    system = small()
    whole = system.u

    def late(t, x):
        return whole(t, x) * (np.nan if t > 8.0 else 1.0)

    object.__setattr__(system, "u", late)
    with pytest.raises(IntegrationError, match=r"t = 8\.5 s") as caught:
        simulate(system, LinearlyImplicit(step=STEP), np.arange(0.0, 21.0, 5.0))
    assert caught.value.time == 8.5
    assert caught.value.step == STEP
    assert np.isfinite(caught.value.state_norm)
    assert caught.value.state_norm > 0
