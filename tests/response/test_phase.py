"""Phase of responses and loci: from the low-frequency asymptote on, as other tools draw it."""

from __future__ import annotations

from typing import Any

import control as ct
import matplotlib
import numpy as np
import pytest

from cellsys import figures
from cellsys.response import frequency_response, margins
from tests.response import gallery

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def degrees(loop: Any, omega: Any) -> np.ndarray:
    return np.rad2deg(frequency_response(ct.ss(loop), omega).phase[0, 0])


def test_phase_counts_the_poles_at_the_origin() -> None:
    s = ct.tf("s")
    w = np.array([1e-2, 1.0, 1e2])
    for m in range(1, 7):
        np.testing.assert_allclose(degrees(1 / s**m, w), -90 * m, atol=1e-9)
        np.testing.assert_allclose(degrees(-1 / s**m, w), -90 * m - 180, atol=1e-9)
        # However high the first frequency: the turns on the way there count.
        late = degrees(1 / (s**m * (s + 1) ** 3), [1e6])
        np.testing.assert_allclose(late, -90 * m - 270, atol=1e-3)
        if m <= 3:  # z - 1 turns by 90 deg and half a sample
            z = ct.tf([1], [1, -1], 0.01) ** m
            want = -90 * m - m * np.rad2deg(10 * 0.01 / 2)
            assert degrees(z, [10.0])[0] == pytest.approx(want, abs=1e-6)
    np.testing.assert_allclose(degrees(s / (s + 1e6), w), 90, atol=0.1)
    np.testing.assert_allclose(degrees(s**2 / (s + 1e6) ** 2, w), 180, atol=0.1)
    np.testing.assert_allclose(degrees(ct.tf([-2], [1]), w), -180, atol=1e-9)
    # Undamped roots are passed on their right: a pole turns by -180 deg, a zero by +180 deg.
    np.testing.assert_allclose(degrees(1 / (s**2 + 4), [1, 3, 5]), [0, -180, -180], atol=1e-9)
    loop = (s**2 + 4) / (s + 1e3) ** 2
    np.testing.assert_allclose(degrees(loop, [1, 3, 5]), [0, 180, 180], atol=1)
    # An unstable pair turns by +180 deg; a delay without end.
    assert degrees(1 / (s**2 - 0.2 * s + 1), [100.0])[0] == pytest.approx(180, abs=0.2)
    ring = (np.eye(40, k=-1), np.eye(40, 1), np.eye(1, 40, 39), 0, 1.0)
    np.testing.assert_allclose(
        np.rad2deg(frequency_response(ring, [0.1, 3.0]).phase[0, 0]), np.rad2deg([-4.0, -120.0])
    )


def test_phase_of_many_channels_and_of_negative_frequencies() -> None:
    A, B, C, D = gallery.random_stable(4, 2, 3, 0)
    found = frequency_response((A, B, C, D), [-1.0, 0.0, 1.0])
    np.testing.assert_allclose(np.exp(1j * found.phase) * found.magnitude, found.response)
    np.testing.assert_allclose(found.phase[..., 0], -found.phase[..., 2])
    assert np.all(np.abs(found.phase[..., 1]) <= np.pi)


def test_phase_of_loci_is_drawn_from_the_asymptote() -> None:
    s = ct.tf("s")
    for loop, start in ((1 / s**3, -270), (1 / s**4, -360), (1 / s, -90), (2 / (s + 1), -3)):
        drawn = margins(loop)
        assert np.rad2deg(drawn.loci.phase[0, 0]) == pytest.approx(start, abs=5)
        _, lower = figures.bode(drawn)
        assert lower.lines[0].get_ydata()[0] == pytest.approx(start, abs=5)
        _, lower = figures.bode(frequency_response(ct.ss(loop)))
        assert lower.lines[0].get_ydata()[0] == pytest.approx(start, abs=10)
        plt.close("all")
    A, B, C, _ = ct.ssdata(ct.ss(1 / s**3))
    twice = margins((np.kron(np.eye(2), A), np.kron(np.eye(2), B), np.kron(np.diag([1, 3]), C), 0))
    np.testing.assert_allclose(np.rad2deg(twice.loci.phase[:, 0]), -270, atol=1e-6)
