"""Margins of a return ratio that is known at some frequencies only: measured, or of another tool.

Between the frequencies the locus is interpolated by its logarithm, log |L| and the unwrapped
phase against log omega, monotone cubics through the samples [Fritsch and Carlson, SIAM J. Numer.
Anal. 17 (1980) 238]. What straight lines in their place would say is the error of interpolation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from cellsys.arguments import checked
from cellsys.drawable import Drawable
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.linear_systems import FrequencyDataLike
from cellsys.response.frequency import FrequencyResponse
from cellsys.units import complex_array, real_array


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredMargins(Drawable):
    """Margins read off samples of L; inf where no crossing lies within them, frequencies then nan.

    Attributes
    ----------
    gain_margin, gain_margin_frequency, gain_margin_error : float
        Factor on L nearest to 1 in ratio; rad/s; half-width of its interval.
    phase_margin, phase_margin_frequency, phase_margin_error : float
        deg, with its sign.
    delay_margin, delay_margin_frequency, delay_margin_error : float
        s.
    phase_crossings, gain_crossings : array (a, 2), (b, 2)
        As in `Margins`.
    encirclements : int
        Clockwise turns of the interpolated locus and its mirror image around -1; where |L| > 1
        rises like 1/s^m towards the lowest frequency, m integrators are passed on their right.
    turn : float
        Largest change of phase between neighbours, deg: from 90 on, crossings may be missed.
    omega : array (k,)
    values : complex array (k,)
        rad/s and L, in rising order.
    """

    _figure: ClassVar[str] = "bode"
    gain_margin: float
    gain_margin_frequency: float
    gain_margin_error: float
    phase_margin: float
    phase_margin_frequency: float
    phase_margin_error: float
    delay_margin: float
    delay_margin_frequency: float
    delay_margin_error: float
    phase_crossings: np.ndarray
    gain_crossings: np.ndarray
    encirclements: int
    turn: float
    omega: np.ndarray
    values: np.ndarray

    def __str__(self) -> str:
        band = f"{self.omega[0]:.4g} .. {self.omega[-1]:.4g} rad/s"
        return (
            f"margins of {len(self.omega)} samples, {band}, as given\n"
            f"gain margin  {self.gain_margin:.6g} +- {self.gain_margin_error:.2g} at "
            f"{self.gain_margin_frequency:.4g} rad/s\n"
            f"phase margin {self.phase_margin:.6g} +- {self.phase_margin_error:.2g} deg at "
            f"{self.phase_margin_frequency:.4g} rad/s\n"
            f"delay margin {self.delay_margin:.6g} +- {self.delay_margin_error:.2g} s at "
            f"{self.delay_margin_frequency:.4g} rad/s\n"
            f"turns around -1 within the band: {self.encirclements}; whether the closed loop is "
            "stable depends on the poles of L, which samples do not tell"
            + (
                f"\nneighbours differ by up to {self.turn:.0f} deg: sample more densely"
                if self.turn >= 90
                else ""
            )
        )


def measured_margins(
    omega: object, values: object, accuracy: object = None, delay: float = 0.0
) -> MeasuredMargins:
    """Gain, phase and delay margins of samples of a scalar L, with their error.

    Parameters
    ----------
    omega : array (k,)
        rad/s, > 0, each once; any order.
    values : complex array (k,)
        L there.
    accuracy : array (k,), optional
        Relative error of each sample (one standard deviation, or a bound): carried to the margins
        to first order, beside the error of interpolation.
    delay : float
        Further pure delay, s.

    Raises
    ------
    DimensionError
        Lengths that do not fit, fewer than 4 samples.
    DataError
        NaN, inf or 0 among the samples; frequencies that are not > 0 or come twice.
    """
    w, L = np.atleast_1d(real_array(omega, "omega")), np.atleast_1d(complex_array(values, "H"))
    if w.ndim != 1 or L.shape != w.shape or len(w) < 4:
        raise DimensionError(
            f"margins of samples take omega and H of one length, 4 or more, got shapes {w.shape} "
            f"and {L.shape}; of several channels give one loop at a time"
        )
    if not np.isfinite(w).all() or np.any(w <= 0) or len(np.unique(w)) != len(w):
        raise DataError("omega must be finite, > 0 rad/s and each frequency given once")
    if not np.isfinite(L).all() or np.any(L == 0):
        bad = int(np.flatnonzero(~np.isfinite(L) | (L == 0))[0])
        raise DataError(f"H[{bad}] = {L[bad]!r} has no logarithm; leave this sample out")
    share = (
        np.zeros(len(w)) if accuracy is None else np.atleast_1d(real_array(accuracy, "accuracy"))
    )
    if share.shape != w.shape or not np.all(share >= 0):
        raise DataError("accuracy must hold one number >= 0 for each frequency")
    rank = np.argsort(w)
    w, L, share = w[rank], L[rank], share[rank]
    L = L * np.exp(-1j * w * delay)
    angle = np.unwrap(np.angle(L))
    smooth = _Curves.of(w, np.log(np.abs(L)), angle, share, PchipInterpolator)
    straight = _Curves.of(w, np.log(np.abs(L)), angle, share, _straight)
    phase, gain = smooth.phase_crossings(), smooth.gain_crossings()
    rough = straight.phase_crossings(), straight.gain_crossings()
    gm, gm_w, gm_e, pm, pm_w, pm_e, dm, dm_w, dm_e = (np.inf, np.nan, np.nan) * 3
    if len(phase):
        i = int(np.argmin(np.abs(np.log(phase[:, 1]))))
        gm_w, gm = map(float, phase[i])
        # d log|L| at a phase crossing: its own error, and that of where the phase crosses.
        along = smooth.slopes(gm_w)
        moved = smooth.error(gm_w) * (1 + abs(along[0] / along[1]) if along[1] else np.inf)
        gm_e = gm * float(np.hypot(moved, _distance(rough[0], gm_w, np.log(gm), np.log)))
    if len(gain):
        i = int(np.argmin(np.abs(gain[:, 1])))
        pm_w, pm = map(float, gain[i])
        pm_e = _of_phase(smooth, rough[1], pm_w, pm)
        lag = np.radians(gain[:, 1] % 360.0) / gain[:, 0]
        j = int(np.argmin(lag))
        dm_w, dm = float(gain[j, 0]), float(lag[j])
        dm_e = np.radians(_of_phase(smooth, rough[1], dm_w, float(gain[j, 1]))) / dm_w
    around = np.unwrap(np.angle(1 + np.exp(smooth.at(np.geomspace(w[0], w[-1], 20 * len(w))))))
    # An end that still rises like 1/s^m is closed by m half turns at infinity.
    rises = max(float(np.rint(-smooth.slopes(w[0])[0])), 0.0) if abs(L[0]) > 1 else 0.0
    return MeasuredMargins(
        gain_margin=gm, gain_margin_frequency=gm_w, gain_margin_error=gm_e,
        phase_margin=pm, phase_margin_frequency=pm_w, phase_margin_error=pm_e,
        delay_margin=dm, delay_margin_frequency=dm_w, delay_margin_error=float(dm_e),
        phase_crossings=phase, gain_crossings=gain,
        encirclements=int(np.rint(0.5 * rises - (around[-1] - around[0]) / np.pi)),
        turn=float(np.degrees(np.abs(np.diff(angle)).max())), omega=w, values=L,
    )  # fmt: skip


def _of_phase(smooth: _Curves, rough: np.ndarray, omega: float, margin: float) -> float:
    along = smooth.slopes(omega)
    moved = smooth.error(omega) * (1 + abs(along[1] / along[0]) if along[0] else np.inf)
    return float(np.hypot(np.degrees(moved), _distance(rough, omega, margin, lambda v: v)))


def _distance(
    rough: np.ndarray, omega: float, value: float, of: Callable[[np.ndarray], np.ndarray]
) -> float:
    """From the nearest crossing of straight lines; inf where these have none."""
    if not len(rough):
        return float("inf")
    near = rough[np.argmin(np.abs(np.log(rough[:, 0] / omega)))]
    return float(abs(of(near[1:])[0] - value))


Curve = Callable[[np.ndarray], np.ndarray]


def _straight(x: np.ndarray, y: np.ndarray) -> Curve:
    return lambda at: np.interp(at, x, y)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Curves:
    """log |L| and phase against log omega."""

    x: np.ndarray
    size: Curve
    phase: Curve
    ends: tuple[np.ndarray, np.ndarray]
    share: np.ndarray

    @staticmethod
    def of(
        w: np.ndarray,
        size: np.ndarray,
        phase: np.ndarray,
        share: np.ndarray,
        kind: Callable[[np.ndarray, np.ndarray], Curve],
    ) -> _Curves:
        x = np.log(w)
        return _Curves(
            x=x, size=kind(x, size), phase=kind(x, phase), ends=(size, phase), share=share
        )

    def at(self, omega: np.ndarray) -> np.ndarray:
        x = np.log(omega)
        return self.size(x) + 1j * self.phase(x)

    def error(self, omega: float) -> float:
        """Relative error of the samples around."""
        return float(np.interp(np.log(omega), self.x, self.share))

    def slopes(self, omega: float) -> tuple[float, float]:
        """d log |L| and d phase over d log omega."""
        h = 1e-4
        a, b = (np.clip(np.log(omega) + s * h, self.x[0], self.x[-1]) for s in (-1, 1))
        ends = np.array([a, b])
        size, phase = (float(np.diff(f(ends))[0] / (b - a)) for f in (self.size, self.phase))
        return size, phase

    def _roots(self, f: Curve, values: np.ndarray) -> list[float]:
        out = [float(x) for x, v in zip(self.x, values, strict=True) if v == 0]
        for k in np.flatnonzero(values[:-1] * values[1:] < 0):
            a, b = self.x[k], self.x[k + 1]
            out.append(float(brentq(lambda s: float(f(np.array([s]))[0]), a, b, xtol=1e-14)))
        return sorted(out)

    def _phase_beyond(self, level: float) -> Curve:
        return lambda x: self.phase(x) - level

    def gain_crossings(self) -> np.ndarray:
        """Rows (frequency, phase above -180 deg)."""
        roots = np.array(self._roots(self.size, self.ends[0]))
        above = 180.0 - (-np.degrees(self.phase(roots)) if len(roots) else roots) % 360.0
        return np.column_stack([np.exp(roots), np.where(above == -180.0, 180.0, above)])

    def phase_crossings(self) -> np.ndarray:
        """Rows (frequency, 1/|L|)."""
        lo, hi = self.ends[1].min(), self.ends[1].max()
        turns = np.arange(
            np.ceil((lo - np.pi) / (2 * np.pi)), np.floor((hi - np.pi) / (2 * np.pi)) + 1
        )
        roots: list[float] = []
        for k in turns:
            level = np.pi * (1 + 2 * k)
            roots += self._roots(self._phase_beyond(level), self.ends[1] - level)
        at = np.array(sorted(roots))
        return np.column_stack([np.exp(at), np.exp(-self.size(at)) if len(at) else at])


def check_delay(delay: float) -> float:
    """A delay >= 0 s."""
    if not (np.isfinite(delay) and delay >= 0):
        raise ParameterError(f"delay must be >= 0 s, got {delay!r}")
    return float(delay)


def samples_of(
    sys: object, values: np.ndarray | None, accuracy: np.ndarray | None
) -> tuple[object, object, object] | None:
    """Frequencies, values and relative errors of what is given as samples; None for a system."""
    if isinstance(sys, FrequencyResponse):
        own = None if sys.accuracy is None else sys.accuracy.ravel()
        omega, H, error = sys.omega, sys.response, own if accuracy is None else accuracy
    elif isinstance(sys, FrequencyDataLike):
        omega, H, error = np.asarray(sys.omega), np.asarray(sys.eval(sys.omega)), accuracy
    elif isinstance(sys, (list, np.ndarray)) and np.ndim(np.asarray(sys, dtype=object)) == 1:
        if values is None:
            raise DimensionError(
                "a row of numbers is no system; samples are margins(omega, H), with the values H"
            )
        return sys, values, accuracy
    else:
        return None
    if values is not None:
        raise ParameterError("these samples have their own frequencies: leave omega out")
    if H.size != len(omega):
        raise DimensionError(
            f"margins of samples are of one channel, got {H.shape[0]} outputs and {H.shape[1]} "
            "inputs; select one loop"
        )
    return omega, H.ravel(), error
