"""Time responses, sampling, root locus, sensitivity, participation."""

from __future__ import annotations

from typing import Any

import control as ct
import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.response import (
    Tustin,
    c2d,
    d2c,
    forced_response,
    frequency_response,
    impulse_response,
    margins,
    root_locus,
    sensitivity,
    step_response,
)
from cellsys.spectra import participation, poles
from tests.response import gallery

S = ct.tf("s")


def test_step_and_impulse_of_a_lag_are_exact() -> None:
    lag = ct.ss(3 / (S + 2))
    t = np.array([0.0, 0.1, 0.35, 2.0, 5.0])
    np.testing.assert_allclose(
        step_response(lag, t).y[:, 0, 0], 1.5 * (1 - np.exp(-2 * t)), atol=1e-15
    )
    np.testing.assert_allclose(impulse_response(lag, t).y[:, 0, 0], 3 * np.exp(-2 * t), rtol=1e-14)
    late = step_response(lag, t[2:])
    np.testing.assert_allclose(late.y[:, 0, 0], 1.5 * (1 - np.exp(-2 * t[2:])), rtol=1e-14)


def test_stiff_step_has_no_step_size_error() -> None:
    # Time constants 1e-6 and 1e3 s in one system: residues of the partial fractions.
    system = (np.diag([-1e6, -1e-3]), np.array([[1e6], [1e-3]]), np.ones((1, 2)), [[0.0]])
    t = np.array([1e-6, 1e-3, 1.0, 1e3, 1e4])
    truth = 2 - np.exp(-1e6 * t) - np.exp(-1e-3 * t)
    np.testing.assert_allclose(step_response(system, t).y[:, 0, 0], truth, rtol=1e-12)


def test_badly_scaled_step() -> None:
    t = np.linspace(0, 20, 11)
    plain, scaled = gallery.mass_spring(4, damping=0.3), gallery.poorbal(1e80)
    np.testing.assert_allclose(step_response(scaled, t).y, step_response(plain, t).y, atol=1e-11)


def test_double_integrator_and_ramp_input() -> None:
    system = gallery.integrators(2)
    t = np.linspace(0, 4, 9)
    np.testing.assert_allclose(step_response(system, t).y[:, 0, 0], t**2 / 2, atol=1e-13)
    np.testing.assert_allclose(forced_response(system, t, t).y[:, 0], t**3 / 6, atol=1e-12)
    held = forced_response(system, t, np.ones(9), linear=False)
    np.testing.assert_allclose(held.y[:, 0], t**2 / 2, atol=1e-13)
    free = forced_response(system, t, x0=[1.0, 2.0])
    np.testing.assert_allclose(free.y[:, 0], 1 + 2 * t, atol=1e-13)


def test_discrete_responses() -> None:
    system = ([[0.5]], [[1.0]], [[2.0]], [[3.0]], 0.1)
    t = np.arange(5) * 0.1
    np.testing.assert_allclose(impulse_response(system, t).y[:, 0, 0], [3, 2, 1, 0.5, 0.25])
    np.testing.assert_allclose(step_response(system, t).y[:, 0, 0], [3, 5, 6, 6.5, 6.75])
    np.testing.assert_allclose(
        forced_response(system, t, [1, 0, 0, 0, 0]).y[:, 0], [3, 2, 1, 0.5, 0.25]
    )
    np.testing.assert_allclose(step_response(system, t[[1, 3]]).y[:, 0, 0], [5, 6.5])
    with pytest.raises(ParameterError, match="multiples"):
        step_response(system, [0.0, 0.15])
    with pytest.raises(ParameterError, match="one sample per step"):
        forced_response(system, t[[0, 2]], [1, 1])


def test_default_times_and_shapes() -> None:
    system = gallery.random_stable(5, 2, 3, 0)
    found = step_response(system)
    assert found.y.shape == (len(found.t), 3, 2)
    assert found.x.shape == (len(found.t), 5, 2)
    A, B, C, _ = system
    np.testing.assert_allclose(found.y[-1], -C @ np.linalg.solve(A, B), atol=0.02)
    assert step_response(gallery.integrators(2)).t[-1] > 0
    for n, m in ((0, 1), (2, 0)):
        small = (-np.eye(n), np.ones((n, m)), np.ones((1, n)), np.ones((1, m)))
        assert step_response(small, [0.0, 1.0]).y.shape == (2, 1, m)
        assert impulse_response(small, [0.0, 1.0]).y.shape == (2, 1, m)
        assert forced_response(small, [0.0, 1.0]).y.shape == (2, 1)


def test_time_refusals() -> None:
    lag = gallery.lag_chain(1, 1.0)
    for t, error in (
        ([1.0, 0.5], ParameterError),
        ([-1.0, 0], ParameterError),
        ([0.0, np.nan], DataError),
        ([], DimensionError),
    ):
        with pytest.raises(error, match="t "):
            step_response(lag, t)
    with pytest.raises(DimensionError, match="u must have shape"):
        forced_response(lag, [0.0, 1.0], np.ones((2, 3)))
    with pytest.raises(DataError, match="u holds NaN"):
        forced_response(lag, [0.0, 1.0], [1.0, np.nan])
    with pytest.raises(DimensionError, match="x0"):
        forced_response(lag, [0.0, 1.0], x0=[1.0, 2.0])
    with pytest.raises(DataError, match="overflows at t"), np.errstate(all="ignore"):
        step_response(([[1000.0]], [[1.0]], [[1.0]], [[0.0]]), [0.0, 0.5, 1.0])


def test_sampling_keeps_names_and_comes_back() -> None:
    plant = ct.ss(
        [[0.0, 1], [-2, -0.5]],
        [[0.0], [1]],
        [[1.0, 0]],
        [[0.0]],
        0,
        states=["x", "v"],
        inputs=["force"],
        outputs=["place"],
    )
    for method in (None, Tustin(), Tustin(match=2.0)):
        there = c2d(plant, 0.2) if method is None else c2d(plant, 0.2, method)
        assert there.dt == 0.2
        assert (there.state_labels, there.input_labels, there.output_labels) == (
            ["x", "v"],
            ["force"],
            ["place"],
        )
        back = d2c(there) if method is None else d2c(there, method)
        assert (back.dt, back.state_labels) == (0, ["x", "v"])
        omega = np.geomspace(0.1, 10, 9)
        np.testing.assert_allclose(
            frequency_response(back, omega).response,
            frequency_response(plant, omega).response,
            rtol=1e-10,
        )
    # Zero-order hold: poles map by the exponential, the step agrees at the samples.
    there = c2d(plant, 0.2)
    np.testing.assert_allclose(
        np.sort_complex(poles(there)),
        np.sort_complex(np.exp(0.2 * np.asarray(poles(plant)))),
        rtol=1e-13,
    )
    t = np.arange(20) * 0.2
    np.testing.assert_allclose(step_response(there, t).y, step_response(plant, t).y, atol=1e-14)
    # Tustin matched at 2 rad/s: equal there.
    warped = c2d(plant, 0.2, Tustin(match=2.0))
    np.testing.assert_allclose(
        frequency_response(warped, [2.0]).response,
        frequency_response(plant, [2.0]).response,
        rtol=1e-12,
    )


def test_sampling_refusals() -> None:
    lag = gallery.lag_chain(1, 1.0)
    with pytest.raises(ParameterError, match="dt must be"):
        c2d(lag, 0.0)
    with pytest.raises(ParameterError, match="discrete already"):
        c2d(c2d(lag, 0.1), 0.1)
    with pytest.raises(ParameterError, match="continuous already"):
        d2c(lag)
    for pole, message in ((-0.5, "no continuous system of the same order"), (0.0, "pure delay")):
        with pytest.raises(ParameterError, match=message):
            d2c(([[pole]], [[1.0]], [[1.0]], [[0.0]], 0.1))
    with pytest.raises(ParameterError, match="singularity"):
        d2c(([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.1), Tustin())
    with pytest.raises(ParameterError, match="match"):
        c2d(lag, 1.0, Tustin(match=4.0))


def test_badly_scaled_sampling() -> None:
    # Entries 1e-80 .. 1e80 leave plain exponentials with nothing.
    plain, scaled = gallery.mass_spring(4, damping=0.3), gallery.poorbal(1e80)
    one, two = c2d(plain, 0.5), c2d(scaled, 0.5)
    omega = np.geomspace(0.1, 5, 7)
    np.testing.assert_allclose(
        frequency_response(two, omega).response, frequency_response(one, omega).response, rtol=1e-9
    )


def test_root_locus_over_a_gain() -> None:
    # 1 + k/(s (s + 1)(s + 2)): crosses at k = 6 with s = j sqrt 2.
    L = ct.ss(1 / (S * (S + 1) * (S + 2)))
    found = root_locus(L, np.linspace(0, 20, 81))
    assert found.crossings == pytest.approx([6.0], rel=1e-10)
    assert margins(L).gain_margin == pytest.approx(6.0, rel=1e-10)
    # Every point solves s (s + 1)(s + 2) + k = 0.
    s, k = found.poles, found.parameter[:, None]
    assert np.abs(s * (s + 1) * (s + 2) + k).max() < 1e-10 * 20
    # Branches are continuous away from the break-away point.
    assert np.abs(np.diff(found.poles, axis=0)).max() < 0.6
    assert root_locus(L).poles.shape == (241, 3)


def test_root_locus_over_kappa() -> None:
    # [notes: theory, return ratio]
    # The closed-loop matrix over kappa, and L_kappa whose gain is the factor on it.
    A, b, s, d = np.array([[-1.0, 2], [-2, -1]]), np.array([[1.0], [0.5]]), 0.8, 1.0
    row = s * np.array([[0.3, -1.5]])

    def loop(kappa: float) -> np.ndarray:
        return np.block([[A, b], [kappa * row, -kappa * d * np.eye(1)]])

    kappa = 0.5
    L = (
        np.block([[A, b], [np.zeros((1, 3))]]),
        np.array([[0.0], [0], [kappa]]),
        np.hstack([-row, [[d]]]),
        np.zeros((1, 1)),
    )
    values = np.linspace(0.1, 40, 100)
    family, gain = root_locus(loop, values), root_locus(L, values / kappa)
    np.testing.assert_allclose(family.crossings / kappa, gain.crossings, rtol=1e-9)
    for here, there in zip(family.poles[::20], gain.poles[::20], strict=True):
        assert np.abs(here[:, None] - there[None]).min(axis=1).max() < 1e-9
    assert root_locus(
        lambda k: np.array([[0, 1.0], [-1, 1 - k]]), np.linspace(0, 3, 31)
    ).crossings == pytest.approx([1.0])
    with pytest.raises(ParameterError, match="needs values"):
        root_locus(loop)
    with pytest.raises(ParameterError, match="rise"):
        root_locus(loop, [1.0, 0.5])
    with pytest.raises(DimensionError, match="square"):
        root_locus(gallery.random_stable(2, 1, 2, 0))


def test_sensitivity_functions() -> None:
    L = ct.ss(4 / ((S + 1) * (S + 2) * (S + 3)))
    omega = np.geomspace(0.01, 100, 50)
    found = sensitivity(L, omega)
    loop = frequency_response(L, omega).response
    np.testing.assert_allclose(found.response_S.response, 1 / (1 + loop), rtol=1e-12)
    np.testing.assert_allclose(found.response_S.response + found.response_T.response, 1, rtol=1e-12)
    assert found.peak_S.value >= found.response_S.magnitude.max()
    # The distance of the Nyquist curve to -1 is 1/peak: it bounds the classical margins.
    m = margins(L)
    assert m.gain_margin >= found.peak_S.value / (found.peak_S.value - 1)
    assert np.radians(m.phase_margin) >= 2 * np.arcsin(1 / (2 * found.peak_S.value))
    with pytest.raises(ParameterError, match="algebraic"):
        sensitivity(([[-1.0]], [[1.0]], [[1.0]], [[-1.0]]))


def test_participation_adds_up() -> None:
    A, B, C, D = gallery.random_stable(7, 2, 3, 1)
    found = participation((A, B, C, D))
    # The complex factors of a state, and of a mode, add up to 1; sizes at least that.
    assert np.all(found.states.sum(axis=0) >= 1 - 1e-12)
    assert np.all(found.states.sum(axis=1) >= 1 - 1e-12)
    # G(0) from residues: sizes do not depend on the states' units.
    T = 2.0 ** np.arange(-30, 40, 10)
    other = participation((A * T[:, None] / T, B * T[:, None], C / T, D))
    np.testing.assert_allclose(other.residue, found.residue, rtol=1e-9)
    np.testing.assert_allclose(other.states, found.states, rtol=1e-8, atol=1e-12)
    diagonal = participation((np.diag([-1.0, -2.0]), np.eye(2), np.eye(2), np.zeros((2, 2))))
    np.testing.assert_allclose(diagonal.states, np.eye(2))
    assert "mostly x[0]" in str(diagonal)
    assert str(participation(np.zeros((0, 0)))) == "no modes"


def test_forced_response_agrees_with_python_control() -> None:
    system = gallery.mass_spring(3)
    t = np.linspace(0, 10, 101)
    u = np.sin(t)
    truth = ct.forced_response(ct.ss(*system, 0), t, u).outputs
    np.testing.assert_allclose(forced_response(system, t, u).y[:, 0], truth, atol=1e-12)
    assert sla.norm(truth) > 0.1


def default_axis(system: Any) -> tuple[np.ndarray, np.ndarray]:
    found = step_response(system)
    assert found.t[0] == 0
    assert np.all(np.diff(found.t) > 0)
    return found.t, found.y[:, 0, 0]


def test_default_times_show_a_delay() -> None:
    # z^-20, as a chain and turned, where its poles are found at eps^(1/20) = 0.16 around 0.
    chain = (np.eye(20, k=-1), np.eye(20, 1), np.eye(1, 20, 19))
    Q = sla.qr(np.random.default_rng(0).standard_normal((20, 20)))[0]
    for A, B, C in (chain, (Q @ chain[0] @ Q.T, Q @ chain[1], chain[2] @ Q.T)):
        t, y = default_axis((A, B, C, 0, 0.5))
        assert t[-1] >= 20
        np.testing.assert_allclose(y, t >= 10.0, atol=1e-12)
    # A chain of 100 lags is a delay as well: seven time constants show nothing of it.
    t, y = default_axis(gallery.lag_chain(100, 1.0))
    assert 110 < t[-1] < 300
    assert y[-1] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("pole", [0.9, 0.5, 0.1, 1e-3, -0.5, -0.99, 0.0])
def test_default_times_of_a_few_samples(pole: float) -> None:
    t, y = default_axis(([[pole]], [[1.0]], [[1.0]], 0, 0.1))
    np.testing.assert_allclose(t, 0.1 * np.arange(len(t)), atol=1e-12)
    assert len(t) >= 10
    assert y[-1] == pytest.approx(1 / (1 - pole), rel=2e-3)


def test_default_times_end_before_growth_overflows() -> None:
    t, y = default_axis((np.diag([2.0, -0.01]), np.ones((2, 1)), np.ones((1, 2)), 0))
    assert t[-1] == pytest.approx(3.5, rel=1e-6)  # exp(7)
    np.testing.assert_allclose(y, np.expm1(2 * t) / 2 - np.expm1(-0.01 * t) / 0.01, rtol=1e-9)
    for pole in (1.5, -3.0, 1e100):
        t, y = default_axis((np.diag([pole, 0.99]), np.ones((2, 1)), np.ones((1, 2)), 0, 0.1))
        assert np.isfinite(y).all()
        assert len(t) > 2
    # Growth by exp(7) in less than a sample, after three without any.
    shift = np.eye(3, k=-1)
    A = np.block([[shift, np.zeros((3, 1))], [np.eye(1, 3, 2), np.array([[1e4]])]])
    t, y = default_axis((A, np.eye(4, 1), np.eye(1, 4, 3), 0, 1.0))
    np.testing.assert_allclose(y, [0, 0, 0, 0, 1, 10001])


@pytest.mark.parametrize("damping", [0.1, 1e-2, 1e-4])
def test_default_times_resolve_every_oscillation(damping: float) -> None:
    A = np.array([[0.0, 1.0], [-1.0, -2 * damping]])
    slow = sla.block_diag(A, [[-1e-3]])
    for matrix in (A, slow, 1e6 * A, np.kron(np.eye(2), slow)):
        n = len(matrix)
        t, _ = default_axis((matrix, np.ones((n, 1)), np.ones((1, n)), 0))
        values = sla.eigvals(matrix)
        for value in values:
            life = 7 / -value.real
            assert t[-1] > 0.999 * life
            steps = np.diff(t)[t[:-1] < life]
            if value.imag != 0:  # ten to a period, as long as it lasts
                assert steps.max() <= 2 * np.pi / (10 * abs(value.imag))
    # Undamped: ten periods.
    t, _ = default_axis((np.array([[0.0, 4.0], [-4.0, 0.0]]), np.ones((2, 1)), np.ones((1, 2)), 0))
    assert t[-1] >= 9.99 * 2 * np.pi / 4
    # Rates 1e6 apart: both ends of the response, in a few hundred points.
    t, y = default_axis((np.diag([-1e3, -1e-3]), np.ones((2, 1)), np.array([[1e3, 1e-3]]), 0))
    assert len(t) < 2000
    assert np.count_nonzero(t < 1e-3) > 3
    np.testing.assert_allclose(y, 2 - np.exp(-1e3 * t) - np.exp(-1e-3 * t), atol=1e-9)


def test_default_times_of_slow_samples() -> None:
    # A pole at 1 - 1e-6 beside one at 0.5: 7e6 samples, of which a few thousand are shown.
    A, B, C = np.diag([1 - 1e-6, 0.5]), np.ones((2, 1)), np.array([[1e-6, 0.5]])
    t, y = default_axis((A, B, C, 0, 1.0))
    assert t[-1] > 6.9e6
    assert len(t) < 10_000
    assert np.array_equal(t[:100], np.arange(100.0))
    np.testing.assert_allclose(y, 2 - 0.5**t - (1 - 1e-6) ** t, atol=1e-9)


def test_sampling_methods_are_named() -> None:
    lag = gallery.lag_chain(1, 1.0)
    for method, text in (("tustin", "'tustin'"), (Tustin, "the class Tustin"), (None, "None")):
        with pytest.raises(ParameterError, match=r"ZeroOrderHold.*Tustin") as error:
            c2d(lag, 0.1, method)
        assert text in str(error.value)
        with pytest.raises(ParameterError, match=r"ZeroOrderHold.*Tustin"):
            d2c(c2d(lag, 0.1), method)
    for dt in ("0.1", None, np.nan):
        with pytest.raises(ParameterError, match="dt must be"):
            c2d(lag, dt)
