"""Stability report: verdicts, distances, growth, pseudospectra, certificates, integrators."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.response import pseudospectral_abscissa
from cellsys.spectra import pseudospectra, stability
from cellsys.spectra.integrators import MARGINAL
from tests import naive
from tests.response import gallery


def discrete(A: np.ndarray, dt: float = 1.0) -> tuple:
    n = len(A)
    return A, np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0)), dt


def test_bidiagonal_is_never_called_stable() -> None:
    # Poles -1, yet a perturbation of 1e-14 in one corner has a pole at about +0.15.
    A = gallery.bidiagonal(60)
    assert naive.poles_say_stable(A)
    found = stability(A)
    assert found.verdict == "not decided"
    assert "rounding" in found.reason
    assert not found.certificate.valid
    E = np.zeros_like(A)
    E[-1, 0] = 1e-14
    assert sla.eigvals(A + E).real.max() > 0.1
    # So close is only a matter of size: 20 states are decided, by the distance.
    assert stability(gallery.bidiagonal(20)).verdict == "stable"


@pytest.mark.parametrize("n", [10, 20, 40, 48, 55])
def test_not_decided_only_when_rounding_can_destabilise(n: int) -> None:
    # The corner entry that puts a pole at 0 is 2^(1-n); rounding is 5e-14 here, about 2^-44.
    found = stability(gallery.bidiagonal(n))
    assert found.distance <= 2.0 ** (1 - n) * 1.01
    assert found.verdict == ("stable" if n < 44 else "not decided")
    assert found.distance_lower <= found.distance


@pytest.mark.parametrize("seed", range(6))
def test_random_verdicts(seed: int) -> None:
    A = gallery.random_stable(25, 1, 1, seed)[0]
    found = stability(A)
    assert found.verdict == "stable"
    assert found.certificate.valid
    assert found.spectral_abscissa == pytest.approx(-0.3, abs=found.abscissa_error + 1e-9)
    up = stability(A + 0.4 * np.eye(25))
    assert up.verdict == "unstable"
    assert (up.distance, up.growth_lower) == (0.0, np.inf)
    assert not up.certificate.valid


def test_numbers_of_a_two_state_system() -> None:
    A = np.array([[-1.0, 5.0], [0.0, -2.0]])
    found = stability(A, epsilon=(0.1, 0.4))
    assert found.numerical_abscissa == pytest.approx((np.sqrt(26) - 3) / 2, rel=1e-12)
    # sigma_min(A) is a root of x^2 - |A|_F^2 x + det^2; the minimum lies at omega = 0.
    square = (30 - np.sqrt(900 - 16)) / 2
    assert found.distance == pytest.approx(np.sqrt(square), rel=1e-9)
    assert found.distance_point == 0
    assert found.distance_lower >= found.distance * 0.998
    assert found.pseudospectral_abscissa[0.4] > 0 > found.pseudospectral_abscissa[0.1]
    # The peak of the exponential on a fine grid lies between the bounds.
    peak = max(np.linalg.norm(sla.expm(A * t), 2) for t in np.linspace(0, 3, 301))
    assert found.kreiss_lower <= peak
    assert found.growth_lower <= peak * 1.0001 <= found.growth_upper


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("time", ["continuous", "discrete"])
def test_growth_and_distance_bounds_hold(seed: int, time: str) -> None:
    A = gallery.random_stable(12, 1, 1, seed, depth=0.1)[0]
    if time == "discrete":
        A = sla.expm(0.1 * A)
        found = stability(discrete(A))
        powers, M = [1.0], np.eye(12)
        for _ in range(400):
            M = A @ M
            powers.append(np.linalg.norm(M, 2))
        peak = max(powers)
        z = np.exp(1j * np.linspace(0, np.pi, 4001))
    else:
        found = stability(A)
        step, M, powers = sla.expm(0.02 * A), np.eye(12), [1.0]
        for _ in range(2000):
            M = step @ M
            powers.append(np.linalg.norm(M, 2))
        peak = max(powers)
        z = 1j * np.linspace(0, 20, 20001)
    assert found.growth_lower <= peak * 1.02  # the grid may miss the top by a little
    assert found.growth_lower >= 0.8 * peak
    assert found.growth_upper >= peak
    sigma = min(sla.svdvals(x * np.eye(12) - A)[-1] for x in z[::10])
    assert found.distance <= sigma * (1 + 1e-9)
    assert found.distance_lower <= sigma
    assert found.distance_lower >= 0.99 * found.distance


def test_distance_agrees_with_slicot() -> None:
    slycot = pytest.importorskip("slycot")
    for seed in range(3):
        A = gallery.random_stable(20, 1, 1, seed, depth=0.05)[0]
        truth = slycot.ab13fd(20, A.copy())[0]
        assert stability(A).distance == pytest.approx(truth, rel=2e-3)  # its default tolerance


def test_perturbation_of_the_distance_reaches_the_axis() -> None:
    A = gallery.random_stable(10, 1, 1, seed=7)[0]
    found = stability(A)
    z = found.distance_point
    U, s, Vh = sla.svd(z * np.eye(10) - A)
    E = s[-1] * np.outer(U[:, -1], Vh[-1])
    assert s[-1] == pytest.approx(found.distance, rel=1e-9)
    assert np.abs(sla.eigvals(A + E) - z).min() < 1e-7


@pytest.mark.parametrize("time", ["continuous", pytest.param("discrete", marks=pytest.mark.slow)])
def test_pseudospectral_abscissa_on_a_grid(time: str) -> None:
    A = gallery.grcar(8)
    system = discrete(A) if time == "discrete" else A
    for epsilon in (1e-2, 0.3):
        found = pseudospectral_abscissa(system, epsilon)
        x = np.linspace(-2, 4, 301)
        grid = pseudospectra(A, x, np.linspace(-4, 4, 401))
        inside = (grid.x[None] + 1j * grid.y[:, None])[grid.sigma <= epsilon]
        size = np.abs(inside) if time == "discrete" else inside.real
        # The grid lies inside; its spacing is 0.02.
        assert size.max() <= found + 1e-9
        assert found <= size.max() + 0.04


def test_pseudospectra_values_are_singular_values() -> None:
    A = gallery.grcar(30)
    found = pseudospectra(A, np.linspace(-1, 3, 7), np.linspace(-3, 3, 7))
    for i, y in enumerate(found.y):
        for j, x in enumerate(found.x):
            truth = sla.svdvals((x + 1j * y) * np.eye(30) - A)[-1]
            assert found.sigma[i, j] == pytest.approx(truth, rel=1e-2, abs=1e-14)
            assert found.sigma[i, j] >= truth * (1 - 1e-6) - 1e-14
    with pytest.raises(ParameterError, match="points"):
        pseudospectra(A, points=1)
    with pytest.raises(ParameterError, match="x must be"):
        pseudospectra(A, x=[np.nan])


def test_integrators_of_position_are_named_and_set_apart() -> None:
    # A crawling cell: the centre moves with the velocity, nothing depends on the centre.
    A = np.array([[0.0, 0, 1, 0], [0, 0, 0, 1], [0, 0, -1, 0.5], [0, 0, -0.5, -2]])
    import control as ct

    plant = ct.ss(
        A,
        np.zeros((4, 1)),
        np.zeros((1, 4)),
        0,
        0,
        states=["centre.x", "centre.y", "speed.x", "speed.y"],
    )
    found = stability(plant)
    assert found.verdict == MARGINAL
    assert str(found).startswith("marginal: stable apart from its integrators: every pole")
    assert found.integrators.count == 2
    assert found.integrators.states == ("centre.x", "centre.y")
    assert "set apart: 2 integrators" in found.reason
    assert found.spectral_abscissa < 0
    assert len(found.poles) == 4


def test_integrators_survive_a_change_of_coordinates() -> None:
    rng = np.random.default_rng(0)
    Q = sla.qr(rng.standard_normal((6, 6)))[0]
    A = sla.block_diag(np.zeros((2, 2)), gallery.random_stable(4, 1, 1, 0)[0])
    found = stability(Q.T @ A @ Q)
    assert (found.verdict, found.integrators.count) == (MARGINAL, 2)
    # A drift that is learned, not exact: said to be one by the caller.
    A[0, 0] = -1e-7
    assert stability(A).integrators.count == 1
    assert stability(A, integrator_tol=1e-6).integrators.count == 2


@pytest.mark.parametrize(("length", "growth"), [(2, "t"), (3, "t^2"), (7, "t^6")])
def test_integrators_in_series_are_unstable_and_counted(length: int, growth: str) -> None:
    found = stability(gallery.integrators(length))
    assert found.verdict == "unstable"
    assert f"a chain of {length} integrators in series" in found.reason
    assert f"grows like {growth}," in found.reason
    # Two chains side by side: the longer one counts; in discrete time the pole is at 1.
    A = sla.block_diag(np.eye(length, k=1), np.eye(2, k=1), [[-1.0]])
    assert f"a chain of {length} integrators" in stability(A).reason
    found = stability(discrete(np.eye(length) + np.eye(length, k=1)))
    assert f"chain of {length} integrators in series (a defective pole at 1)" in found.reason
    assert f"like {growth.replace('t', 'k')}," in found.reason


def test_an_integrator_is_marginal() -> None:
    # 1/s and 1/(s (s + 1)): a step makes them grow for ever.
    for A, reason in (
        ([[0.0]], "no poles besides integrators"),
        ([[0.0, 1.0], [0.0, -1.0]], "every pole lies inside"),
    ):
        found = stability(np.array(A))
        assert found.verdict == "marginal: stable apart from its integrators"
        assert found.reason.startswith(reason)
        assert found.reason.endswith("set apart: 1 integrator")
    assert stability(discrete(np.eye(1))).verdict == MARGINAL


def test_integrators_in_discrete_time() -> None:
    assert stability(discrete(np.array([[1.0, 1.0], [0, 1.0]]))).verdict == "unstable"
    assert stability(discrete(np.eye(1))).integrators.count == 1


def test_oscillator_on_the_axis_is_not_decided() -> None:
    found = stability(np.array([[0.0, 1.0], [-1.0, 0.0]]))
    assert found.verdict == "not decided"
    assert found.growth_lower == pytest.approx(1.0)


def test_arnold_laub_example_is_unstable() -> None:
    # BD01AD 2.2: two poles at -eps, two at +eps; known to far better than eps = 1e-6.
    assert stability(gallery.arnold_laub(1e-6)).verdict == "unstable"


def test_units_do_not_change_the_verdict() -> None:
    for spread in (1e6, 1e80):
        found = stability(gallery.poorbal(spread))
        assert found.verdict == "stable"
        assert found.coordinates == "balanced"


def test_small_and_bad_input() -> None:
    assert stability(np.zeros((0, 0))).verdict == "stable"
    assert stability(np.array([[-1.0]])).verdict == "stable"
    assert stability(np.array([[1.0]])).verdict == "unstable"
    with pytest.raises(DataError, match="not finite"):
        stability(np.array([[np.nan]]))
    with pytest.raises(DimensionError, match="square"):
        stability(np.ones((2, 3)))
    with pytest.raises(ParameterError, match="epsilon"):
        stability(-np.eye(2), epsilon=(0.0,))
    with pytest.raises(ParameterError, match="integrator_tol"):
        stability(-np.eye(2), integrator_tol=-1.0)
    with pytest.raises(ParameterError, match="epsilon"):
        pseudospectral_abscissa(-np.eye(2), np.inf)


def test_text_can_be_read() -> None:
    text = str(stability(np.array([[-1.0, 5.0], [0.0, -2.0]]), epsilon=(0.1,)))
    assert text.startswith("stable: ")
    assert "distance to instability" in text
    assert "abscissa at epsilon" in text
