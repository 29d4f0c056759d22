"""The closed loop: linearisation, return ratio, gain margin as the factor on kappa, equilibria."""

import dataclasses
import itertools

import numpy as np
import pytest
import scipy.linalg as sla

import cellsys as cs
from cellsys.errors import CellsysError, DataError, DimensionError, ParameterError
from cellsys.integrate import CVODES
from cellsys.loop import PolarityLaw, closed_loop
from cellsys.loop.modal import split_slow
from cellsys.model import LatentModel, StiffnessSensor
from cellsys.response import margins
from cellsys.spectra.certainty import PoleCertainty
from tests import naive
from tests.loop.systems import NAMES, heading, make, two_state

TIGHT = CVODES(rtol=1e-9, atol=1e-9)


def finite_difference(loop, z, p):
    """d(z', theta')/d(z, theta) of the nonlinear loop, central differences."""
    system, m, size = loop.system, loop.order, np.linalg.norm(p)
    theta = np.arctan2(p[1], p[0])

    def rhs(v):
        q = size * heading(v[m])
        rate = system.rhs(0.0, np.concatenate([v[:m], q]))
        across = np.array([-np.sin(v[m]), np.cos(v[m]), 0.0])
        return np.concatenate([rate[:m], [across @ rate[m:] / size]])

    v, h = np.concatenate([z, [theta]]), 1e-6
    columns = [(rhs(v + h * e) - rhs(v - h * e)) / (2 * h) for e in np.eye(m + 1)]
    return np.array(columns).T


@pytest.mark.parametrize("normalise", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_linearisation_is_the_derivative(normalise, seed):
    loop = make(seed, m=4 + seed % 3, normalise=normalise, kappa=0.3)
    rng = np.random.default_rng(seed)
    z, p = rng.standard_normal(loop.order), heading(rng.uniform(-3, 3))
    point = loop.linearize((z, p))
    # central differences of step 1e-6: rounding 1e-16/1e-6 and curvature 1e-12
    assert np.abs(point.A - finite_difference(loop, z, p)).max() < 1e-8
    assert np.array_equal(point.z, z)
    assert "frozen time" in str(point)


@pytest.mark.parametrize("seed", range(3))
def test_a_graded_loop_carries_the_strength_of_its_cue(seed):
    """Value, slope, return ratio, compiled and symbolic forms of d = (g/g0) x/(1 + x^2)."""
    loop = make(seed, kappa=0.3, noise=2.0)
    rng = np.random.default_rng(seed)
    z, p = rng.standard_normal(loop.order), heading(rng.uniform(-3, 3))
    g = loop.sensor.raw(z)
    x = np.linalg.norm(g) / 2.0
    assert np.allclose(loop.sensed(z), g / np.linalg.norm(g) * x**2 / (1 + x**2), rtol=1e-12)
    assert np.allclose(loop.sensor.direction(z), loop.sensed(z), rtol=1e-12)
    assert np.linalg.norm(loop.sensed(z)) < 1.0
    point = loop.linearize((z, p))
    assert np.abs(point.A - finite_difference(loop, z, p)).max() < 1e-8
    assert point.strength == pytest.approx(float(p @ loop.sensed(z)))
    L = loop.open_loop(point)
    closed = np.sort_complex(sla.eigvals(L.A - L.B @ L.C))
    assert np.abs(closed - np.sort_complex(point.poles)).max() < 1e-10
    t = np.linspace(0.0, 60.0, 13)
    by_flow = loop.simulate(t, cs.Exponential(rtol=1e-9, atol=1e-9))
    by_casadi = loop.simulate(t, CVODES(rtol=1e-10, atol=1e-10))
    assert np.abs(by_flow.x - by_casadi.x).max() < 1e-6
    assert np.all(np.linalg.norm(by_flow.d[:, 0], axis=1) < 1.0)


@pytest.mark.parametrize("normalise", [True, False])
def test_linearisation_with_another_length_of_p(normalise):
    loop = make(2, normalise=normalise, kappa=0.3)
    z, p = np.ones(5), 2.5 * heading(0.7)
    assert np.abs(loop.linearize((z, p)).A - finite_difference(loop, z, p)).max() < 1e-8


def test_a_heading_out_of_the_plane_is_not_linearised_as_if_it_were_in_it():
    loop = make(2)
    with pytest.raises(DataError, match="plane"):
        loop.linearize((np.ones(5), np.array([0.6, 0.0, 0.8])))


@pytest.mark.parametrize("normalise", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_return_ratio_closes_to_the_loop(normalise, seed):
    """det(I + L(s)) = 0 exactly at the eigenvalues of the closed matrix."""
    loop = make(seed, normalise=normalise, kappa=0.2)
    point = loop.linearize((np.random.default_rng(seed).standard_normal(5), heading(1.0)))
    L = loop.open_loop(point)
    assert L.dt == 0
    closed = np.sort_complex(sla.eigvals(L.A - L.B @ L.C))
    assert np.abs(closed - np.sort_complex(point.poles)).max() < 1e-10
    for pole in point.poles:
        # L is evaluated beside its own pole at 0: 1 + L vanishes to rounding of |L|
        assert abs(1.0 + L(pole)) < 1e-9 * max(1.0, abs(L(pole)))
    # by its formula: (kappa/s) (p.d - G(s))
    s = 0.05 + 0.3j
    G = point.S_heading @ np.linalg.solve(
        s * np.eye(5) - point.A_plant, point.B_heading.astype(complex)
    )
    assert abs(L(s) - point.kappa / s * (point.strength - G)) < 1e-12


def crossings(point):
    """Factors on kappa at which the closed matrix reaches the axis, by a sweep and bisection."""

    def top(f):
        return sla.eigvals(point.closed(f)).real.max()

    found, grid = [], np.geomspace(1e-4, 1e5, 700)
    for low, high in itertools.pairwise(grid):
        if np.sign(top(low)) == np.sign(top(high)):
            continue
        sign = np.sign(top(low))
        for _ in range(60):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if np.sign(top(middle)) == sign else (low, middle)
        found.append(np.sqrt(low * high))
    return np.array(found)


def test_gain_margin_is_the_factor_on_kappa():
    """L = (kappa/s)(1 - c w^2/(s^2 + 0.1 w s + w^2)), c = -0.5: stable for small kappa only."""
    loop = two_state(pole=0.1, coupling=-0.5, kappa=0.002)
    point = loop.linearize((np.zeros(2), heading(0.0)))
    assert "equilibrium" in str(point)
    result = margins(loop.open_loop(point))
    assert result.closed_loop_stable
    assert 1.0 < result.gain_margin < np.inf
    # bisection of the eigenvalues to rounding; their condition here is below 1e3
    assert abs(result.gain_margin / crossings(point)[0] - 1.0) < 1e-9
    at = sla.eigvals(point.closed(result.gain_margin))
    assert abs(at.real.max()) < 1e-9 * 0.1
    for factor, stable in ((0.999, True), (1.001, False)):
        poles = sla.eigvals(point.closed(factor * result.gain_margin))
        assert (poles.real.max() < 0) == stable
    # the loop really oscillates beyond it
    wrong = naive.positive_sign_margin(point)
    assert not np.isclose(wrong, result.gain_margin, rtol=1e-2)


def test_gain_margin_below_one_when_kappa_is_too_large():
    loop = two_state(pole=0.1, coupling=-0.5, kappa=0.05)
    point = loop.linearize((np.zeros(2), heading(0.0)))
    result = margins(loop.open_loop(point))
    assert not result.closed_loop_stable
    assert sla.eigvals(point.A).real.max() > 0
    factors = crossings(point)
    assert factors[0] < 1.0
    # there is another one above; the margin is one of them
    assert np.abs(result.gain_margin / factors - 1.0).min() < 1e-9


def test_no_gain_margin_where_the_sensor_cannot_disturb():
    loop = two_state(pole=0.1, coupling=0.0, kappa=0.05)
    result = margins(loop.open_loop((np.zeros(2), heading(0.0))))
    assert result.closed_loop_stable
    assert result.gain_margin == np.inf
    # L = kappa/s: 90 degrees at omega = kappa
    assert abs(result.phase_margin - 90.0) < 1e-9
    assert abs(result.phase_margin_frequency - 0.05) < 1e-9


def test_no_kappa_cures_static_feedback_beyond_one():
    """G(0) > |d|: a real pole stays right for every kappa [notes: theory, return ratio]."""
    loop = two_state(pole=0.1, coupling=1.3, kappa=0.01)
    point = loop.linearize((np.zeros(2), heading(0.0)))
    for factor in np.geomspace(1e-4, 1e4, 17):
        assert sla.eigvals(point.closed(factor)).real.max() > 0
    assert not margins(loop.open_loop(point)).closed_loop_stable


@pytest.mark.parametrize("seed", range(6))
def test_random_loops_have_the_margin_that_a_sweep_finds(seed):
    loop = make(seed, normalise=seed % 2 == 0, kappa=0.02, gain=0.3)
    rng = np.random.default_rng(seed)
    z = 0.1 * rng.standard_normal(5)
    raw = loop.sensor.raw(z)
    point = loop.linearize((z, heading(np.arctan2(raw[1], raw[0]))))
    result = margins(loop.open_loop(point))
    assert result.closed_loop_stable == (point.poles.real.max() < 0)
    if np.isfinite(result.gain_margin):
        assert abs(sla.eigvals(point.closed(result.gain_margin)).real).min() < 1e-9
    elif result.closed_loop_stable:
        assert all(sla.eigvals(point.closed(f)).real.max() < 0 for f in np.geomspace(1.0, 1e5, 40))


def test_simulation_follows_its_own_equation():
    loop = make(1, normalise=True)
    t = np.linspace(0.0, 200.0, 41)
    run = loop.simulate(t, TIGHT)
    assert np.array_equal(run.x[0], np.concatenate([loop.z0, loop.p0]))
    # |p| is a first integral: kept to the tolerance times the number of turns
    assert np.abs(np.linalg.norm(run.p[:, 0], axis=1) - 1.0).max() < 1e-6
    assert run.d.shape == (41, 1, 3)
    assert np.abs(np.linalg.norm(run.d[:, 0], axis=1) - 1.0).max() < 1e-12
    from scipy.integrate import solve_ivp

    want = solve_ivp(loop.system.rhs, (0.0, 200.0), run.x[0], rtol=1e-10, atol=1e-11, t_eval=t).y.T
    assert np.abs(run.x - want).max() < 1e-5
    other = loop.simulate(t, TIGHT, z0=np.zeros(5), p0=[0.0, 1.0, 0.0])
    assert np.array_equal(other.p[0, 0], [0.0, 1.0, 0.0])


@pytest.mark.parametrize("normalise", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_equilibrium_is_solved_or_refused(normalise, seed):
    loop = make(seed, normalise=normalise, kappa=1 / 20, gain=0.2)
    try:
        point = loop.linearize("equilibrium")
    except DataError:
        with pytest.raises(DataError, match="no equilibrium found"):
            loop.linearize("equilibrium")
        return
    rate = loop.system.rhs(0.0, np.concatenate([point.z, point.p]))
    assert np.abs(rate).max() < 1e-10
    assert "equilibrium (residual" in str(point)
    assert np.abs(point.A - finite_difference(loop, point.z, point.p)).max() < 1e-8


def test_a_crawling_loop_has_no_equilibrium():
    """An integrator driven for every heading: the centre of a crawling cell."""
    loop = make(0, kappa=1 / 20, gain=0.2)
    model = loop.model
    A = sla.block_diag(model.A, 0.0)
    B = np.vstack([model.B, np.zeros(4)])
    crawling = closed_loop(
        LatentModel(A=A, B=B, offset=np.append(model.offset, 0.3), input_names=NAMES),
        controller=loop.controller,
        sensor=StiffnessSensor(K_d=np.column_stack([loop.sensor.K_d, np.zeros(3)])),
        z0=np.append(loop.z0, 0.0),
    )
    with pytest.raises(DataError, match=r"no equilibrium found.*crawling"):
        crawling.linearize("equilibrium")
    point = crawling.linearize(300.0, slower_than=1e-3)
    assert len(point.slow) == 1
    assert "1 slow poles set apart" in str(point) or "1 slow pole set apart" in str(point)
    assert point.A.shape == (6, 6)


def test_points_to_linearise_at():
    loop = make(3)
    run = loop.simulate(np.array([0.0, 40.0]), CVODES(rtol=1e-8, atol=1e-8))
    by_run, by_time = loop.linearize(run), loop.linearize(40.0)
    assert np.array_equal(by_run.A, by_time.A)
    start = loop.linearize(0.0)
    assert np.array_equal(start.z, loop.z0)
    assert np.array_equal(loop.open_loop(run).A, loop.open_loop(by_run).A)
    for bad, error in (
        ("end", ParameterError),
        (-1.0, ParameterError),
        (float("nan"), ParameterError),
        ((np.zeros(4), heading(0.0)), DimensionError),
        ((np.zeros(5), np.zeros(2)), DimensionError),
        ((np.full(5, np.nan), heading(0.0)), DataError),
        ((np.zeros(5), np.array([0.0, 0.0, 1.0])), DataError),
        ((np.zeros(5), np.zeros(3)), DataError),
        (make(3, m=4).simulate(np.array([0.0, 1.0]), TIGHT), DimensionError),
    ):
        with pytest.raises(error):
            loop.linearize(bad)


def test_a_direction_of_zero_has_no_slope():
    K_d = np.zeros((3, 6))
    K_d[0, 1] = 1.0
    loop = dataclasses.replace(make(0), sensor=StiffnessSensor(K_d=K_d))
    with pytest.raises(DataError, match="direction is zero"):
        loop.linearize((np.zeros(5), heading(0.0)))
    # and does not turn the cell
    rate = loop.system.rhs(0.0, np.concatenate([np.zeros(5), heading(0.3)]))
    assert np.array_equal(rate[5:], np.zeros(3))


def test_closed_loop_refuses():
    loop = make(0)
    model, sensor = loop.model, loop.sensor
    with pytest.raises(ParameterError, match="no sensor"):
        closed_loop(model)
    with pytest.raises(DimensionError, match="sensor reads 3"):
        closed_loop(model, sensor=StiffnessSensor(K_d=np.ones((3, 4))))
    for names in (("a", "b", "c", "d"), ("cell1.cos", "cell2.sin", "cell1.cos2", "cell1.sin2")):
        with pytest.raises(ParameterError, match="heading features of one cell"):
            closed_loop(dataclasses.replace(model, input_names=names), sensor=sensor)
    with pytest.raises(ParameterError, match="heading features"):
        closed_loop(LatentModel(A=-np.eye(5)), sensor=sensor)
    for options in (
        {"z0": np.zeros(4)},
        {"p0": np.zeros(2)},
        {"z0": np.full(5, np.nan)},
        {"p0": np.array([np.inf, 0.0, 0.0])},
        {"p0": np.array([0.0, 0.0, 1.0])},
        {"p0": np.zeros(3)},
    ):
        with pytest.raises(CellsysError):
            closed_loop(model, sensor=sensor, **options)
    assert closed_loop(model, sensor=sensor).controller == PolarityLaw()


def test_a_step_model_without_continuous_form_is_refused_with_the_reason():
    model = LatentModel(A=[[-15.0]], B=np.ones((1, 4)), dt=0.1, input_names=NAMES)
    loop = closed_loop(model, sensor=StiffnessSensor(K_d=np.ones((3, 2))))
    with pytest.raises(ParameterError, match="no continuous model"):
        loop.linearize(0.0)


# Slow modes


@pytest.mark.parametrize("seed", range(6))
def test_split_slow_is_exact(seed):
    rng = np.random.default_rng(seed)
    m = 7
    A = sla.block_diag(
        np.diag([-0.5, -1.0, 0.3]), [[-0.4, 1.0], [-1.0, -0.4]], [[-0.01, 0.02], [-0.02, -0.01]]
    )
    T = np.eye(m) + 0.3 * rng.standard_normal((m, m))
    A = T @ A @ np.linalg.inv(T)
    B, C = rng.standard_normal((m, 2)), rng.standard_normal((3, m))
    A_f, B_f, C_f, slow = split_slow(A, B, C, 0.1)
    assert A_f.shape == (5, 5)
    assert np.abs(np.sort_complex(slow) - np.array([-0.01 - 0.02j, -0.01 + 0.02j])).max() < 1e-10
    # the slow part has just these two poles: G - G_fast is of order 2 with the same residues
    for s in (0.7j, -0.2 + 1.3j, 2.0):
        G = C @ np.linalg.solve(s * np.eye(m) - A, B.astype(complex))
        fast = C_f @ np.linalg.solve(s * np.eye(5) - A_f, B_f.astype(complex))
        lam, right = np.linalg.eig(A)
        left = np.linalg.inv(right)
        rest = sum(
            np.outer(C @ right[:, k], left[k] @ B) / (s - lam[k])
            for k in range(m)
            if abs(lam[k]) < 0.1
        )
        assert np.abs(G - fast - rest).max() < 1e-10 * max(1.0, np.abs(G).max())


def test_split_slow_keeps_or_takes_everything():
    A, B, C = np.diag([-1.0, -2.0]), np.ones((2, 1)), np.ones((1, 2))
    same = split_slow(A, B, C, 0.0)
    assert np.array_equal(same[0], A)
    assert len(same[3]) == 0
    A_f, B_f, C_f, slow = split_slow(A, B, C, 10.0)
    assert (A_f.shape, B_f.shape, C_f.shape) == ((0, 0), (0, 1), (1, 0))
    assert sorted(slow.real) == [-2.0, -1.0]
    for bad in (-1.0, float("nan"), float("inf")):
        with pytest.raises(ParameterError, match="slower_than"):
            split_slow(A, B, C, bad)


def test_all_plant_poles_set_apart_leaves_the_polarity_alone():
    loop = two_state(pole=0.001, coupling=0.5, kappa=0.05)
    point = loop.linearize((np.zeros(2), heading(0.0)), slower_than=0.01)
    assert point.A.shape == (1, 1)
    assert abs(point.A[0, 0] + 0.05) < 1e-15
    assert margins(loop.open_loop(point)).closed_loop_stable


def test_loop_results_draw_themselves():
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from cellsys.figures import headings

    loop = make(1)
    ax = loop.linearize((np.zeros(5), heading(0.0))).plot()
    assert ax.get_title() == "closed loop"
    run = loop.simulate(np.linspace(0.0, 100.0, 21), TIGHT, p0=heading(np.pi - 0.01))
    ax = headings({"reduced": run}, plt.figure().subplots())
    assert [line.get_label() for line in ax.lines] == ["reduced: polarity p", "reduced: sensed d"]
    ax.figure.canvas.draw()
    plt.close("all")


def test_a_growing_mode_is_never_set_apart():
    """Slow and growing beyond rounding: no integrator of absolute position, whatever T is."""
    A = np.diag([0.0037, 0.0013, -0.0004, 1e-18, -0.3])
    rng = np.random.default_rng(0)
    T = np.eye(5) + 0.2 * rng.standard_normal((5, 5))
    A = T @ A @ sla.inv(T)
    B, C = rng.standard_normal((5, 1)), rng.standard_normal((1, 5))
    A_f, _, _, slow = split_slow(A, B, C, 0.01)
    assert np.allclose(np.sort(slow.real), [-0.0004, 0.0], atol=1e-12)
    assert np.allclose(np.sort(sla.eigvals(A_f).real), [-0.3, 0.0013, 0.0037], atol=1e-12)
    # naive: by size alone both growing modes go, and the rest looks stable
    naive = sla.schur(A, sort=lambda re, im: float(np.hypot(re, im)) >= 0.01)
    assert naive[2] == 1
    # what the data leave open on either side of the axis is no known growth
    own = sla.eigvals(A)
    open_ = PoleCertainty(own, np.where(np.abs(own - 0.0013) < 1e-9, 0.002, 0.0))
    assert len(split_slow(A, B, C, 0.01, open_)[3]) == 3


def test_a_growing_model_does_not_become_stable_by_setting_apart():
    loop = make(3)
    A = loop.model.A - (loop.model.growth() - 0.004) * np.eye(loop.order)
    loop = dataclasses.replace(loop, model=dataclasses.replace(loop.model, A=A))
    point = loop.linearize((loop.z0, loop.p0), slower_than=0.05)
    assert point.poles.real.max() > 0.003
    assert not margins(loop.open_loop(point)).closed_loop_stable
