"""Frequency response: routes agree, accuracy is stated and kept, bad input is refused."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
import scipy.sparse as sp

from cellsys.errors import DataError, DimensionError, MemoryBudgetError, ParameterError
from cellsys.response import Realization, frequency_response
from cellsys.spectra import poles
from tests.response import gallery


def direct(system: tuple, omega: np.ndarray) -> np.ndarray:
    """One LU per frequency: slow, plain, backward stable."""
    A, B, C, D = (np.asarray(M, dtype=float) for M in system[:4])
    dt = system[4] if len(system) > 4 else 0
    s = np.exp(1j * omega * dt) if dt else 1j * omega
    return np.stack([C @ np.linalg.solve(x * np.eye(len(A)) - A, B) + D for x in s], axis=-1)


OMEGA = np.geomspace(1e-3, 1e3, 31)


@pytest.mark.parametrize(
    ("m", "p"), [(1, 1), (1, 3), (3, 1), (2, 2), (3, 2), (6, 5)], ids=lambda v: str(v)
)
@pytest.mark.parametrize("n", [1, 2, 3, 10, 49, 50, 97, 130])
def test_every_route_agrees_with_direct_solves(n: int, m: int, p: int) -> None:
    system = gallery.random_stable(n, m, p, seed=n + m)
    found = frequency_response(system, OMEGA)
    truth = direct(system, OMEGA)
    assert found.response.shape == (p, m, len(OMEGA))
    # Both are backward stable, so twice the stated accuracy bounds their difference.
    assert np.all(np.abs(found.response - truth) <= 2 * found.accuracy * np.abs(truth))
    assert np.median(found.accuracy) < 1e-10  # the largest belong to entries near a zero


def test_accuracy_argument_does_not_change_the_response() -> None:
    system = gallery.random_stable(30, 2, 1, seed=0)
    with_it = frequency_response(system, OMEGA)
    without = frequency_response(system, OMEGA, accuracy=False)
    assert without.accuracy is None
    np.testing.assert_array_equal(with_it.response, without.response)


def test_uncontrollable_and_disconnected_states() -> None:
    # Zeros below the subdiagonal of the Hessenberg form: the rest is left out exactly.
    A = np.diag([-1.0, -2.0, -3.0, -4.0])
    system = (A, np.array([[1.0], [0], [1], [0]]), np.ones((1, 4)), np.zeros((1, 1)))
    np.testing.assert_allclose(
        frequency_response(system, OMEGA).response, direct(system, OMEGA), rtol=1e-14
    )
    zero = (A, np.zeros((4, 1)), np.ones((1, 4)), np.array([[2.0]]))
    np.testing.assert_array_equal(frequency_response(zero, OMEGA).response, 2.0)


def test_long_chain_neither_overflows_nor_underflows() -> None:
    # |1/(1 + j w)|^300 spans 1e-900 .. 1: what fits in a float is right, the rest is 0.
    A, B, C, D = gallery.lag_chain(300, 1.0)
    omega = np.array([0.01, 0.5, 3.0, 1e3])
    found = frequency_response((A, B, C, D), omega).response[0, 0]
    truth = 1 / (1 + 1j * omega[:3]) ** 300
    np.testing.assert_allclose(found[:3], truth, rtol=1e-12)
    assert abs(found[3]) < 1e-300


@pytest.mark.parametrize("spread", [1e9, 1e80])
def test_units_do_not_matter(spread: float) -> None:
    # The scaling is by powers of two: balancing undoes it and not one digit may be lost.
    plain = gallery.mass_spring(4, damping=0.3)
    scaled = gallery.poorbal(spread)
    assert np.abs(np.asarray(scaled[0])[np.asarray(scaled[0]) != 0]).max() > spread
    one, two = frequency_response(plain, OMEGA), frequency_response(scaled, OMEGA)
    tolerance = np.maximum(one.accuracy, two.accuracy)
    assert np.all(np.abs(one.response - two.response) <= 2 * tolerance * np.abs(one.response))
    # gebal stops near the best scaling, not at one and the same: two digits of the bound at most.
    assert np.all(two.accuracy <= 100 * one.accuracy)
    np.testing.assert_allclose(
        np.sort_complex(poles(scaled)),
        np.sort_complex(poles(plain)),
        atol=2 * poles(plain).error_bound.max(),
        rtol=0,
    )


def test_metres_to_nanometres() -> None:
    A, B, C, D = gallery.random_stable(12, 1, 1, seed=3)
    unit = np.where(np.arange(12) % 3 == 0, 1e9, 1.0)
    scaled = (A * unit[:, None] / unit, B * unit[:, None] * 1e-12, C / unit * 1e12, D)
    one, two = frequency_response((A, B, C, D), OMEGA), frequency_response(scaled, OMEGA)
    tolerance = one.accuracy + two.accuracy + 1e-14
    assert np.all(np.abs(one.response - two.response) <= tolerance * np.abs(one.response))


def test_discrete_and_nyquist_limit() -> None:
    A, B, C, D = gallery.random_stable(8, 1, 1, seed=4)
    system = (np.eye(8) + 0.05 * A, B, C, D, 0.05)
    omega = np.linspace(0.1, np.pi / 0.05, 20)
    found = frequency_response(system, omega)
    np.testing.assert_allclose(found.response, direct(system, omega), rtol=1e-11)
    with pytest.raises(ParameterError, match="Nyquist frequency"):
        frequency_response(system, [100.0])
    assert frequency_response(system).omega[-1] == pytest.approx(np.pi / 0.05)


def test_sparse_equals_dense_and_is_never_densified() -> None:
    A, B, C, D = gallery.rod(60)
    omega = OMEGA[OMEGA < 10]
    dense = frequency_response((A, B, C[:1], D[:1]), omega)
    found = frequency_response(Realization(sp.csr_array(A), B, C[:1], D[:1]), omega)
    np.testing.assert_allclose(found.response, dense.response, rtol=1e-11)
    assert found.accuracy.max() < 1e-6
    n = 10_000
    line = sp.diags_array(
        [np.ones(n - 1), -2.0 * np.ones(n), np.ones(n - 1)], offsets=[-1, 0, 1], format="csr"
    )
    large = Realization(line, np.eye(n, 1), np.eye(1, n))
    omega = np.array([0.3, 2.0])
    # Half-infinite chain: g = 1/(s + 2 - g); the far end is out of sight at these frequencies.
    s = 1j * omega
    g = (s + 2 - np.sqrt(s + 4) * np.sqrt(s)) / 2
    np.testing.assert_allclose(frequency_response(large, omega).response[0, 0], g, rtol=1e-11)
    with pytest.raises(MemoryBudgetError, match="10000 x 10000"):
        poles(large)
    with pytest.raises(MemoryBudgetError, match="pass omega"):
        frequency_response(large)


def test_automatic_grid_resolves_sharp_resonances() -> None:
    zeta = 1e-6
    s = ct.tf("s")
    found = frequency_response(ct.ss(1 / (s**2 + 2 * zeta * s + 1) + 1 / (s + 100)))
    assert found.magnitude.max() == pytest.approx(1 / (2 * zeta), rel=1e-3)
    assert found.omega[0] <= 0.1
    assert found.omega[-1] >= 1000
    step = np.abs(np.diff(np.angle(found.response[0, 0])))
    assert np.minimum(step, 2 * np.pi - step).max() < 0.36


def test_undamped_pole_is_left_out_of_the_automatic_grid() -> None:
    found = frequency_response(
        (np.array([[0.0, 1.0], [-1.0, 0.0]]), [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    )
    assert np.all(np.isfinite(found.response))


def test_frd_and_names() -> None:
    plant = ct.ss([[-1.0]], [[1.0]], [[2.0]], [[0.0]], 0, inputs=["force"], outputs=["speed"])
    found = frequency_response(plant, [0.1, 1.0])
    data = found.to_frd()
    assert (found.inputs, found.outputs) == (("force",), ("speed",))
    assert data.input_labels == ["force"]
    np.testing.assert_allclose(data(1j * 1.0), plant(1j * 1.0))
    np.testing.assert_allclose(found.phase[0, 0], np.angle(plant(1j * found.omega)))
    assert "2 frequencies" in str(found)


@pytest.mark.parametrize(("n", "m", "p"), [(0, 1, 1), (1, 1, 1), (3, 0, 2), (3, 2, 0), (0, 0, 0)])
def test_degenerate_sizes(n: int, m: int, p: int) -> None:
    system = (-np.eye(n), np.ones((n, m)), np.ones((p, n)), np.ones((p, m)))
    found = frequency_response(system, [1.0, 2.0])
    assert found.response.shape == (p, m, 2)
    assert found.singular_values.shape == (min(p, m), 2)
    if m and p:
        truth = 1 + n / (1 + 1j * found.omega)
        np.testing.assert_allclose(found.response[0, 0], truth, rtol=1e-14)


def test_repeated_outputs() -> None:
    A, B, C, D = gallery.random_stable(5, 1, 1, seed=9)
    found = frequency_response((A, B, np.vstack([C, C]), np.vstack([D, D])), OMEGA)
    np.testing.assert_array_equal(found.response[0], found.response[1])
    assert found.singular_values[0] == pytest.approx(np.sqrt(2) * np.abs(found.response[0, 0]))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("which", range(4))
def test_not_finite_is_refused(which: int, bad: float) -> None:
    system = [np.array(M, dtype=float) for M in gallery.random_stable(3, 1, 1, seed=1)]
    system[which][0, 0] = bad
    with pytest.raises(DataError, match=r"[ABCD]\[0, 0\] is not finite"):
        frequency_response(tuple(system), OMEGA)
    with pytest.raises(DataError, match=r"omega\[1\] is not finite"):
        frequency_response(gallery.random_stable(3, 1, 1, seed=1), [1.0, bad])


def test_wrong_sizes_are_refused() -> None:
    A, B, C, D = gallery.random_stable(3, 1, 1, seed=1)
    for system, text in (
        ((A[:2], B, C, D), "A must be square"),
        ((A, B[:2], C, D), "B must have 3 rows"),
        ((A, B, C[:, :2], D), "C must have 3 columns"),
        ((A, B, C, np.zeros((2, 1))), "D has shape"),
    ):
        with pytest.raises(DimensionError, match=text):
            frequency_response(system, OMEGA)
    with pytest.raises(DataError, match="complex"):
        frequency_response((A + 1j, B, C, D), OMEGA)
    with pytest.raises(ParameterError, match="is a pole"):
        frequency_response(gallery.integrators(2), [0.0, 1.0])
