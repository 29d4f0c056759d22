"""Loops whose margins were wrong without a word: each with the value that is right."""

from __future__ import annotations

from collections.abc import Callable

import control as ct
import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.response import c2d, margins
from cellsys.response.brackets import find_roots
from tests import naive

S = ct.tf("s")
ROTATION = np.array([[0.0, 1.0], [-1.0, 0.0]])


def matrices(loop: ct.TransferFunction) -> tuple:
    return tuple(np.asarray(M) for M in ct.ssdata(ct.ss(loop)))


def after_delay(loop: tuple, samples: int) -> tuple:
    """z^-samples L: a chain of that many states, all poles at z = 0."""
    A, B, C, D, dt = loop
    n, d = len(A), samples
    shift, last = np.eye(d, k=-1), np.eye(1, d, d - 1)
    return (
        np.block([[shift, np.zeros((d, n))], [B @ last, A]]),
        np.vstack([np.eye(d, 1), np.zeros((n, 1))]),
        np.hstack([D @ last, C]),
        [[0.0]],
        dt,
    )


def held(loop: ct.TransferFunction, dt: float) -> tuple:
    sampled = c2d(ct.ss(loop), dt)
    return sampled.A, sampled.B, sampled.C, sampled.D, dt


LOOPS: dict[str, Callable[[], tuple]] = {
    "1.002/(s - 1)": lambda: matrices(1.002 / (S - 1)),
    "1.001/(s + 1)": lambda: matrices(1.001 / (S + 1)),
    "two loci, one near 1": lambda: (
        10 * ROTATION - 0.001 * np.eye(2),
        np.eye(2),
        [[1.0, 10], [-10, 1]],
        0,
    ),
    "lag and two samples": lambda: after_delay(held(5 / (100 * S + 1), 1.0), 2),
    "lag and 100 samples": lambda: after_delay(held(3.5 / (10 * S + 1), 0.01), 100),
    "(s + 1)/(s^2 + 2)": lambda: matrices((S + 1) / (S**2 + 2)),
    "undamped 2 x 2": lambda: (10 * ROTATION, np.eye(2), [[1.0, 10], [-10, 1]], 0),
}
# name -> gain margin and rad/s, |phase margin| in deg and rad/s, delay margin in s, disk margin;
# None: not in the list. By hand where a formula stands beside it, else from the report, which had
# them from another program.
KNOWN = {
    "1.002/(s - 1)": (
        1 / 1.002,
        0.0,
        np.degrees(np.arctan(np.sqrt(1.002**2 - 1))),
        np.sqrt(1.002**2 - 1),
        0.99867,
        None,
    ),
    "1.001/(s + 1)": (
        np.inf,
        np.nan,
        180 - np.degrees(np.arctan(np.sqrt(1.001**2 - 1))),
        np.sqrt(1.001**2 - 1),
        None,
        2.0,
    ),
    "two loci, one near 1": (np.inf, np.nan, 5.7163, 0.04988, 0.15172, None),
    "lag and two samples": (12.478043, 0.63441, None, None, None, 1.6093),
    "lag and 100 samples": (4.6492, 1.624, None, None, None, None),
    "(s + 1)/(s^2 + 2)": (np.inf, np.nan, None, None, None, None),
    # loci (1 +- 10j)/(s -+ 10j): |lambda| = 1 at sqrt(101) -+ 10.
    "undamped 2 x 2": (
        np.inf,
        np.nan,
        np.degrees(np.arctan(0.1)),
        np.sqrt(101) - 10,
        (np.pi - np.arctan(0.1)) / (np.sqrt(101) + 10),
        None,
    ),
}


@pytest.mark.parametrize("name", LOOPS)
def test_known_margins(name: str) -> None:
    found = margins(LOOPS[name]())
    gm, gm_w, pm, pm_w, dm, disk = KNOWN[name]
    assert found.closed_loop_stable
    assert found.gain_margin == pytest.approx(gm, rel=1e-5)
    assert found.gain_margin_frequency == pytest.approx(gm_w, rel=1e-3, nan_ok=True)
    for got, true in (
        (found.phase_margin, pm),
        (found.phase_margin_frequency, pm_w),
        (found.delay_margin, dm),
        (found.disk_margin, disk),
    ):
        if true is not None:
            assert got == pytest.approx(true, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("1.002/(s - 1)", lambda gain, phase, delay: phase == delay == np.inf),
        ("1.001/(s + 1)", lambda gain, phase, delay: phase == delay == np.inf),
        ("two loci, one near 1", lambda gain, phase, delay: phase > 170),
        ("lag and two samples", lambda gain, phase, delay: abs(gain / 12.478 - 1) > 1),
        ("lag and 100 samples", lambda gain, phase, delay: abs(gain / 4.649 - 1) > 1),
        ("(s + 1)/(s^2 + 2)", lambda gain, phase, delay: gain < 1e-9),
        ("undamped 2 x 2", lambda gain, phase, delay: gain < 1e-9),
    ],
)
def test_naive_margins_of_a_grid(name: str, wrong: Callable) -> None:
    """Sign changes on a grid from a decade below the slowest root to one above the fastest."""
    assert wrong(*naive.grid_margins(*LOOPS[name]()))


def test_stable_for_every_gain() -> None:
    """No factor at all where the oracle sees none: the closed loops themselves."""
    for name in ("(s + 1)/(s^2 + 2)", "undamped 2 x 2"):
        A, B, C, _ = (np.asarray(M) for M in LOOPS[name]())
        for k in np.geomspace(1e-6, 1e6, 49):
            assert sla.eigvals(A - k * B @ C).real.max() < 0


def test_exactly_one_and_beyond() -> None:
    """|L(0)| = 1, |L(inf)| >= 1, |L| = 1 everywhere: margins at the ends."""
    touching = margins(1 / (S + 1))  # the limit of 1.001/(s + 1): a turn of 180 deg at 0
    assert (touching.phase_margin, touching.phase_margin_frequency) == (180.0, 0.0)
    assert touching.delay_margin == np.inf
    critical = margins(-1 / (S + 1))  # a pole at 0 already
    assert (critical.gain_margin, critical.phase_margin, critical.delay_margin) == (1.0, 0.0, 0.0)
    assert not critical.closed_loop_stable
    # However short a delay: exp(-s tau) D = -1 has roots with Re s = log|D|/tau > 0.
    direct = margins((2 * S + 1) / (S + 1))
    assert (direct.delay_margin, direct.delay_margin_frequency) == (0.0, np.inf)
    assert margins((0.5 * S + 1) / (S + 1)).delay_margin == np.inf
    ring = margins((np.eye(3, k=-1), np.eye(3, 1), np.eye(1, 3, 2), 0, 1.0))  # z^-3
    assert ring.gain_margin == pytest.approx(1.0)
    assert ring.phase_margin == pytest.approx(0.0, abs=1e-9)
    assert not ring.closed_loop_stable
    static = margins(([], [], [], [[2.0]]))
    assert (static.gain_margin, static.phase_margin, static.delay_margin) == (np.inf, np.inf, 0.0)


def test_matrices_of_a_lower_rank_and_nearly_defective_ones() -> None:
    """A locus that is 0 to rounding has no crossings; a Jordan block has those of its locus."""
    lag = matrices(3 / ((S + 1) ** 3))
    one = margins(lag)
    A, B, C, _ = lag
    for left, right in (([[1.0], [2.0]], [[0.6, 0.2]]), ([[1.0], [0.0]], [[1.0, 1e6]])):
        found = margins((A, B @ right, left @ C, 0))
        assert found.gain_margin == pytest.approx(one.gain_margin, rel=1e-8)
        assert len(found.loci.omega) < 600
    twice = np.array([[1.0, 1e3], [0.0, 1.0]])
    found = margins((np.kron(np.eye(2), A), np.kron(np.eye(2), B), np.kron(twice, C), 0))
    assert found.phase_crossings[:, 1] == pytest.approx([one.gain_margin] * 2, rel=1e-6)


def test_many_samples_of_delay() -> None:
    """z^-d/2 crosses the negative axis at (2 k + 1) pi/d, always with gain 1/2."""
    d = 60
    found = margins((np.eye(d, k=-1), np.eye(d, 1), 0.5 * np.eye(1, d, d - 1), 0, 0.01))
    w = (2 * np.arange(d // 2) + 1) * np.pi / d / 0.01
    np.testing.assert_allclose(found.phase_crossings[:, 0], w, rtol=1e-10)
    np.testing.assert_allclose(found.phase_crossings[:, 1], 2.0, rtol=1e-12)
    assert found.loci.omega[-1] == np.pi / 0.01


def test_large_loops_say_how_crossings_were_sought() -> None:
    small, large = margins(matrices(1 / (S + 1) ** 3)), None
    assert small.loci.complete
    assert "grid alone" not in str(small)
    n = 160  # 2 n + 1 rows
    large = margins((-np.eye(n) + np.eye(n, k=-1), np.eye(n, 1), 0.9 * np.eye(1, n, n - 1), 0))
    assert not large.loci.complete
    assert "crossings sought on the refined grid alone" in str(large)
    assert large.gain_margin == pytest.approx(1 / 0.9 / np.cos(np.pi / n) ** n, rel=1e-9)


def test_two_loci_that_pass_the_axis_the_other_way_round() -> None:
    """On a bare grid: one locus upwards through -1, the other downwards through +1."""
    loop = matrices(2 / (S**2 + 0.1 * S + 1) / (S + 1))
    A, B, C, _ = loop
    # Cross-coupled channels have the loci g and -g, a ring of four has g, j g, -g and -j g.
    for ring in (np.eye(2)[::-1], np.roll(np.eye(4), 1, axis=0)):
        q = len(ring)
        both = (np.kron(np.eye(q), A), np.kron(np.eye(q), B), np.kron(ring, C), np.zeros((q, q)))
        for omega in (None, np.geomspace(0.3, 3.0, 24)):
            found, one = margins(both, omega=omega), margins(loop, omega=omega)
            assert found.gain_crossings[:, 0] == pytest.approx(
                np.repeat(one.gain_crossings[:, 0], q)
            )
            for w, k in one.phase_crossings:
                near = np.isclose(found.phase_crossings[:, 0], w, rtol=1e-9)
                assert found.phase_crossings[near, 1] == pytest.approx(k)
            for w, k in found.phase_crossings:
                values = sla.eigvals(both[0] - k * both[1] @ both[2])
                assert np.abs(values - 1j * w).min() < 1e-9


def test_roots_of_many_brackets() -> None:
    a, b, c = np.array([0.0, 0.0, 1.0]), np.array([2.0, 3.0, 2.0]), np.array([1.0, 2.0, 1.5])

    def f(x: np.ndarray, i: np.ndarray) -> np.ndarray:
        return np.sign(x - c[i]) * np.abs(x - c[i]) ** np.array([1.0, 3.0, 0.0])[i]

    every = np.arange(3)
    for first in (c, a, np.full(3, np.nan)):
        found = find_roots(f, a, b, f(a, every), f(b, every), first, np.zeros(3))
        # A triple root is known to eps^(1/3), a jump to four ulp.
        assert np.abs(found - c).max() < 1e-5
        assert abs(found[2] - 1.5) < 1e-15
