"""Margins of samples: of another tool, measured, noisy."""

import control
import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DataError, DimensionError, ParameterError

LOOPS = [
    control.tf([1], [1, 1, 0]),
    control.tf([10], [1, 3, 3, 1]),
    control.tf([4], [1, 2, 1, 0]),
    control.tf([5, 5], [1, 2, 4, 0]),
]
OMEGA = np.geomspace(0.01, 100.0, 200)


@pytest.mark.parametrize("L", LOOPS)
def test_samples_have_the_margins_of_their_system_within_the_error_they_state(L):
    true, found = cs.margins(L), cs.margins(OMEGA, L(1j * OMEGA))
    for name in ("gain_margin", "phase_margin", "delay_margin"):
        a, b, error = (getattr(o, n) for o, n in (
            (true, name), (found, name), (found, f"{name}_error")))  # fmt: skip
        assert (np.isinf(a) and np.isinf(b)) or abs(a - b) <= error < 0.01 * abs(a)
    assert found.encirclements == true.encirclements
    assert "as given" in str(found)


def test_frequency_data_of_three_kinds_are_one():
    L = LOOPS[2]
    found = [
        cs.margins(OMEGA, L(1j * OMEGA)),
        cs.margins(list(OMEGA[::-1]), L(1j * OMEGA)[::-1]),
        cs.margins(control.frd(L, OMEGA)),
        cs.margins(cs.frequency_response(L, OMEGA)),
    ]
    for other in found[1:]:
        assert other.phase_margin == pytest.approx(found[0].phase_margin, rel=1e-9)
        assert other.gain_margin == pytest.approx(found[0].gain_margin, rel=1e-9)
    later = cs.margins(OMEGA, L(1j * OMEGA), delay=0.1)
    assert later.phase_margin == pytest.approx(cs.margins(L, delay=0.1).phase_margin, rel=1e-3)


def test_errors_of_the_data_reach_the_margins():
    """Noise of 2 %: the true margin within twice the error in 95 % of cases, which is not idle."""
    L, rng, off = LOOPS[1], np.random.default_rng(0), []
    true, H = cs.margins(L), L(1j * OMEGA)
    for _ in range(60):
        noise = 0.02 * (rng.normal(size=200) + 1j * rng.normal(size=200))
        found = cs.margins(OMEGA, H * (1 + noise), accuracy=np.full(200, 0.02))
        off.append((found.phase_margin - true.phase_margin) / found.phase_margin_error)
    assert np.mean(np.abs(off) < 2) >= 0.95
    assert np.std(off) > 0.2


def test_coarse_samples_are_said():
    L = control.tf([1], [1, 0.01, 1])
    assert "sample more densely" in str(cs.margins(OMEGA[::20], L(1j * OMEGA[::20])))


def test_refusals():
    H = LOOPS[0](1j * OMEGA)
    with pytest.raises(DimensionError, match="one length, 4 or more"):
        cs.margins(OMEGA, H[:-1])
    with pytest.raises(DimensionError, match=r"margins\(omega, H\)"):
        cs.margins(OMEGA)
    with pytest.raises(DataError, match="each frequency given once"):
        cs.margins(np.r_[OMEGA[0], OMEGA[:-1]], H)
    with pytest.raises(DataError, match=r"H\[3\]"):
        cs.margins(OMEGA, np.where(np.arange(200) == 3, np.nan, H))
    with pytest.raises(ParameterError, match="leave it out"):
        cs.margins(LOOPS[0], accuracy=np.ones(3))
    with pytest.raises(ParameterError, match="leave omega out"):
        cs.margins(control.frd(LOOPS[0], OMEGA), OMEGA)
    two = cs.frequency_response((-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))), OMEGA)
    with pytest.raises(DimensionError, match="one channel, got 2 outputs"):
        cs.margins(two)
