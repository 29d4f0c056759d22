"""`Exponential`: exactness, order, error estimate, every kind of sampling."""

import functools

import casadi as ca
import numpy as np
import pytest
import scipy.linalg as sla
from scipy.integrate import solve_ivp

from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate import CVODES, DOP853, Exponential, simulate
from cellsys.integrate.semilinear import phi
from cellsys.loop import PolarityLaw, closed_loop, loop_copies
from cellsys.model import LatentModel, StiffnessSensor
from tests.integrate.toys import scalar
from tests.loop.systems import NAMES, heading, make

TIGHT = Exponential(rtol=1e-9, atol=1e-9)


def solved(loop, t, rtol=1e-12):
    system = loop.system
    run = solve_ivp(system.rhs, (t[0], t[-1]), system.x0, "DOP853", t_eval=t, rtol=rtol, atol=1e-13)
    return run.y.T


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("name", ["fixed", "tolerance"])
def test_exact_for_constant_polarity(order, name):
    """kappa = 0: z is a linear system with a constant input, solved to rounding at dt = 1 s."""
    loop = make(1, m=8, kappa=0.0)
    A, B, b = loop.model.continuous_matrices()
    t = np.arange(0.0, 61.0)
    push = B @ np.asarray(loop.commands(loop.p0)) + b
    rest = -np.linalg.solve(A, push)
    exact = np.array([rest + sla.expm(A * s) @ (loop.z0 - rest) for s in t])
    method = Exponential(step=1.0, order=order) if name == "fixed" else TIGHT
    run = loop.simulate(t, method)
    assert np.abs(run.x[:, :8] - exact).max() < 1e-12 * np.abs(exact).max()
    np.testing.assert_allclose(run.x[:, 8:], np.tile(loop.p0, (61, 1)), atol=1e-14)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_order_in_the_polarity_part(order):
    loop = make(4, m=6, kappa=0.1)
    t = np.array([0.0, 10.0, 40.0])
    exact = solved(loop, t)
    steps = np.array([0.5, 0.25, 0.125])
    error = [np.abs(loop.simulate(t, Exponential(step=h, order=order)).x - exact).max()
             for h in steps]  # fmt: skip
    slope = np.log2(np.array(error[:-1]) / error[1:])
    # A quarter of an order: the next term of the expansion at these steps.
    assert slope[-1] == pytest.approx(order, abs=0.35)


def test_explicit_steps_lose_a_stiff_linear_part_and_exponential_ones_do_not():
    """x' = -1000 (x - cos t) - sin t: order 2 at a step of 100 time constants."""
    system = scalar(lambda t, x: [1000.0 * np.cos(t) - np.sin(t)], W_x=[[-1000.0]], x0=[1.0])
    t = np.linspace(0, 2, 11)
    error = np.abs(simulate(system, Exponential(step=0.1, order=2), t).x[:, 0] - np.cos(t))
    assert error.max() < 1e-3


@pytest.mark.parametrize(
    "t",
    [
        np.arange(0.0, 301.0),
        np.arange(0.0, 301.0, 7.5),
        np.array([0.0, 300.0]),
        np.sort(np.random.default_rng(0).uniform(5.0, 300.0, 60)),
        np.linspace(10.0, 10.01, 5),
    ],
    ids=["1 s", "7.5 s", "end", "uneven", "short"],
)
@pytest.mark.parametrize("gain", [0.2, 1.0])
def test_every_kind_of_sampling(t, gain):
    loop = make(2, m=12, gain=gain)
    run = loop.simulate(t, TIGHT)
    exact = solved(loop, t)
    true = np.abs(run.x - exact).max()
    # Fifty times the tolerance on states of the size of ten, plus the reference's own error.
    assert true < 50 * 1e-9 * max(1.0, np.abs(exact).max())
    assert true < run.error.absolute.max() + 1e-11 * np.abs(exact).max()
    np.testing.assert_allclose(np.linalg.norm(run.p[:, 0], axis=1), 1.0, atol=1e-7)


def test_inputs_are_averaged_exactly():
    """x_k+1 - x_k = A int z dt + u dt holds for the logged u, by Simpson's rule on fine samples."""
    loop = make(2, m=6)
    t = np.linspace(0, 20, 401)
    run = loop.simulate(t, TIGHT, auxiliaries=True)
    A = loop.model.continuous_matrices()[0]
    z, u = run.x[::2, :6], 0.5 * (run.u[::2, :6] + run.u[1::2, :6])
    area = (t[2] - t[0]) / 6 * (run.x[:-1:2, :6] + 4 * run.x[1::2, :6] + run.x[2::2, :6])
    left = np.diff(z, axis=0) - area @ A.T
    # Simpson's rule at 0.1 s on rates below 0.3 1/s: (0.03)^4/180.
    np.testing.assert_allclose(left, u * (t[2] - t[0]), atol=1e-7)


def test_defective_matrix_is_not_diagonalised():
    A = -0.1 * np.eye(4) + np.diag([0.05] * 3, 1)
    model = LatentModel(A=A, B=0.1 * np.ones((4, 4)), input_names=NAMES)
    sensor = StiffnessSensor(K_d=np.vstack([np.eye(3, 5), np.zeros((0, 5))]) + 0.1)
    loop = closed_loop(model, sensor=sensor, z0=np.ones(4))
    t = np.arange(0.0, 201.0, 5.0)
    run = loop.simulate(t, TIGHT)
    assert run.statistics["coordinates"] == "dense"
    np.testing.assert_allclose(run.x, solved(loop, t), atol=1e-7)


def test_start_across_from_the_target():
    """p = -d leaves slowly and turns fast: a window that is too long is taken back."""
    loop = make(5, m=5, kappa=0.2)
    d = np.asarray(loop.sensed(loop.z0))
    start = -d + 1e-4 * np.array([d[1], -d[0], 0.0])
    t = np.arange(0.0, 101.0)
    run = loop.simulate(t, TIGHT, p0=start)
    reference = loop.simulate(t, DOP853(rtol=1e-12, atol=1e-13), p0=start)
    true = np.abs(run.x - reference.x).max()
    assert true < 1e-4
    assert true < run.error.absolute.max() + 1e-10


def test_unstable_plant_ends_in_an_error():
    model = LatentModel(A=np.diag([0.5, -0.1]), B=0.1 * np.ones((2, 4)), input_names=NAMES)
    loop = closed_loop(model, sensor=StiffnessSensor(K_d=np.eye(3)), z0=np.ones(2))
    with pytest.raises(IntegrationError, match="not finite"):
        loop.simulate(np.array([0.0, 1e4]), TIGHT)


def test_refusals():
    with pytest.raises(ParameterError, match="rtol"):
        Exponential()
    with pytest.raises(ParameterError, match="not both"):
        Exponential(step=1.0, rtol=1e-3, atol=1e-3)
    with pytest.raises(ParameterError, match="order"):
        Exponential(step=1.0, order=5)
    with pytest.raises(ParameterError, match="names its linear part"):
        simulate(scalar(lambda t, x: [-x[0]]), TIGHT, np.array([0.0, 1.0]))


def test_phi_functions():
    """phi_k of real and complex arguments against a sum in high precision."""
    import mpmath

    z = np.array([0.0, 1e-9, -0.5 + 0.2j, -3.0, 4j, -40.0, 2.0 + 2j])
    found = phi(z, 6)
    with mpmath.workdps(60):
        for k in range(7):
            for value, got in zip(z, found[k], strict=True):
                terms = [mpmath.mpc(value) ** j / mpmath.factorial(j + k) for j in range(250)]
                assert complex(mpmath.fsum(terms)) == pytest.approx(complex(got), rel=1e-12)


def random_loop(seed):
    rng = np.random.default_rng(seed)
    return make(
        seed,
        m=int(rng.integers(3, 30)),
        kappa=float(10 ** rng.uniform(-2.3, -0.7)),
        gain=float(10 ** rng.uniform(-1.5, 0.3)),
        normalise=bool(rng.random() < 0.7),
        planar=bool(rng.random() < 0.7),
    )


GRID = np.arange(0.0, 201.0, 4.0)


@functools.cache
def referred(seed):
    """A randomised loop, its solution, and what two references of different methods differ by."""
    loop = random_loop(seed)
    reference = loop.simulate(GRID, Exponential(rtol=1e-11, atol=1e-11)).x
    other = solved(loop, GRID, 3e-12)
    return loop, other, np.abs(reference - other).max()


def covered(seeds, method):
    """Ratios estimate / true error of randomised loops."""
    ratios = []
    for seed in seeds:
        loop, other, doubt = referred(seed)  # doubt is not counted as error
        run = loop.simulate(GRID, method)
        true = np.abs(run.x - other).max()
        if true < 10 * doubt:
            continue
        ratios.append(run.error.absolute.max() / true)
    return np.array(ratios)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "loops"), [(Exponential, 80), (CVODES, 200)])
def test_estimates_cover_the_error_of_random_loops(method, loops):
    """Loops at 1e-5: covered in 95 %, within a factor 20 in all."""
    ratios = covered(range(loops), method(rtol=1e-5, atol=1e-5))
    assert len(ratios) > 0.94 * loops
    assert np.mean(ratios >= 1.0) >= 0.95
    assert np.mean(ratios < 20.0) >= 0.95


@pytest.mark.slow
def test_estimates_cover_the_error_of_a_few_loops():
    ratios = covered(range(12), Exponential(rtol=1e-5, atol=1e-5))
    assert np.mean(ratios >= 1.0) >= 0.9
    assert np.all(ratios < 20.0)


def test_a_printed_run_shows_its_error_and_its_time():
    run = make(2).simulate(np.arange(0.0, 50.0), TIGHT)
    text = str(run)
    assert "computed in" in text
    assert "integrator's error" in text
    assert "four nodes more" in text


def test_constant_direction_in_closed_form():
    """Constant d: tan(theta/2) decays as exp(-kappa t)."""
    model = LatentModel(A=np.diag([-0.1, -0.2]), B=np.zeros((2, 4)), input_names=NAMES)
    K_d = np.zeros((3, 3))
    K_d[0, 0] = 1.0
    loop = closed_loop(
        model, controller=PolarityLaw(kappa=0.05), sensor=StiffnessSensor(K_d=K_d), z0=np.ones(2),
        p0=heading(2.5),
    )  # fmt: skip
    t = np.arange(0.0, 200.0, 5.0)
    run = loop.simulate(t, TIGHT)
    angle = np.arctan2(run.p[:, 0, 1], run.p[:, 0, 0])
    np.testing.assert_allclose(
        np.tan(angle / 2), np.tan(1.25) * np.exp(-0.05 * t), rtol=1e-6, atol=1e-9
    )


def test_ten_cells_are_ten_loops():
    """Copies of a loop from different starts: each follows its own run."""
    loop = make(3, m=8, gain=0.3)
    rng = np.random.default_rng(1)
    angles = rng.uniform(-np.pi, np.pi, 10)
    z0 = rng.standard_normal((10, 8))
    p0 = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(10)])
    t = np.arange(0.0, 101.0, 2.0)
    system = loop_copies(loop, z0, p0)
    run = simulate(system, TIGHT, t)
    z, p = run.block("z"), run.block("p")
    assert run.residual_share()["z"] < 1
    for k in range(10):
        one = loop.simulate(t, TIGHT, z0=z0[k], p0=p0[k])
        np.testing.assert_allclose(z[:, k], one.x[:, :8], atol=1e-7)
        np.testing.assert_allclose(p[:, k], one.x[:, 8:], atol=1e-7)
    np.testing.assert_allclose(run.d[:, 4], one_d(loop, z[:, 4]), atol=1e-12)
    form = system.casadi()
    symbolic = ca.Function("rate", [form.t, form.x], [form.xdot])(0.0, system.x0)
    np.testing.assert_allclose(symbolic.full()[:, 0], system.rhs(0.0, system.x0), atol=1e-12)
    np.testing.assert_allclose(
        system.rhs(0.0, system.x0), system.W_x @ system.x0 + system.u(0.0, system.x0), atol=1e-12
    )


@pytest.mark.parametrize("m", [5, 150])
def test_samples_do_not_depend_on_how_they_are_asked_for(m):
    """Every second: blocks of samples. A few of them, or none on the grid: one by one."""
    loop = make(6, m=m, gain=0.2)
    t = np.arange(0.0, 301.0)
    every = loop.simulate(t, TIGHT).x
    chosen = np.array([0, 1, 2, 7, 40, 41, 150, 299, 300])
    some = loop.simulate(t[chosen], TIGHT).x
    uneven = np.sort(np.concatenate([t[chosen], [0.3, 33.33, 151.7]]))
    odd = loop.simulate(uneven, TIGHT).x[np.isin(uneven, t[chosen])]
    size = np.abs(every).max()
    np.testing.assert_allclose(some, every[chosen], atol=2e-8 * size)
    np.testing.assert_allclose(odd, every[chosen], atol=2e-8 * size)


def one_d(loop, z):
    return np.array([loop.sensed(row) for row in z])
