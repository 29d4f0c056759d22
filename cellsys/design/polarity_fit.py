"""`fit_polarity`: turning rate, noise and cue gain of the polarity law from measured headings.

In the plane the law [thesis eq. 72] with a unit cue of direction phi and noise reads

    d theta = kappa sin(phi - theta) dt + sigma dW,

and a track shows theta_k + e_k, e_k white with standard deviation s. Regressing the turn on the
cue is biased by e_k, which stands on both sides; the sine of the step before is free of it and
serves as instrument (as the estimators of Brueckner et al., Phys. Rev. Lett. 125, 058103, 2020, for
underdamped motion from noisy places). The expected turn is the law's exact step, so that the
interval between frames need not be short beside 1/kappa:

    sum z_k (theta_k+1 - theta_k - h_k) = 0,   tan((psi_k - h_k)/2) = tan(psi_k/2) e^(-kappa dt)

with psi = phi - theta. The turns' variance and lag-one covariance part sigma and s, where noise
that entered early in an interval has fallen with the rate kappa cos psi. Of headings that are
movements, means over a step, the same sum gives sigma, and s counts only what exceeds it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from cellsys.arguments import checked
from cellsys.design.track_headings import bearings_of, headings_of
from cellsys.errors import DataError, ParameterError
from cellsys.loop.polarity import PolarityLaw
from cellsys.shown import Shown
from cellsys.tracks import Tracks
from cellsys.trajectory import Trajectory
from cellsys.units import real_number


class CellRate(NamedTuple):
    """One cell: kappa, 1/s, its interval, and the turns that it rests on."""

    kappa: float
    low: float
    high: float
    turns: int


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class PolarityFit(Shown):
    """Estimates of the polarity law with their intervals.

    Parameters
    ----------
    kappa : float
        Turning rate towards the cue, 1/s, pooled over the cells.
    kappa_interval, noise_interval, cue_gain_interval : (float, float)
        At `level`.
    noise : float
        sigma, rad/s^(1/2).
    measurement : float
        s, rad: what single headings are off.
    cue_gain : float
        2 kappa/sigma^2: how sharply headings gather about a steady cue, the concentration of
        their von Mises distribution; 0 for none.
    cells : mapping of str to CellRate
    level : float
    turns : int
    """

    kappa: float
    kappa_interval: tuple[float, float]
    noise: float
    noise_interval: tuple[float, float]
    measurement: float
    cue_gain: float
    cue_gain_interval: tuple[float, float]
    cells: Mapping[str, CellRate]
    level: float
    turns: int

    def controller(self) -> PolarityLaw:
        """The law with this kappa, for `cs.closed_loop`.

        Raises
        ------
        DataError
            Where the interval does not lie above zero: nothing says that cells follow the cue.
        """
        if not self.kappa_interval[0] > 0:
            raise DataError(
                f"kappa is {self.kappa:.3g} 1/s with the interval {self.kappa_interval[0]:.3g} to "
                f"{self.kappa_interval[1]:.3g}: these headings do not show that cells turn towards "
                "the cue; use more or longer tracks"
            )
        return PolarityLaw(kappa=self.kappa)

    def __str__(self) -> str:
        low, high = self.kappa_interval
        return (
            f"PolarityFit: kappa {self.kappa:.3g} 1/s ({100 * self.level:g} %: {low:.3g} to "
            f"{high:.3g}), {self.turns} turns of {len(self.cells)} cells\n"
            f"noise {self.noise:.3g} rad/s^0.5 ({self.noise_interval[0]:.3g} to "
            f"{self.noise_interval[1]:.3g}), headings off by {self.measurement:.3g} rad, cue gain "
            f"{self.cue_gain:.3g} ({self.cue_gain_interval[0]:.3g} to "
            f"{self.cue_gain_interval[1]:.3g})"
        )


class _Series(NamedTuple):
    """Of one cell: turns y, cues psi as seen from the heading, instruments z, intervals; and
    which turns follow each other, by the number of their block."""

    y: np.ndarray
    psi: np.ndarray
    pull: np.ndarray  # interval times strength of the cue
    z: np.ndarray
    dt: np.ndarray
    block: np.ndarray


@checked
def fit_polarity(
    data: Tracks | Trajectory | Sequence[Tracks | Trajectory],
    *,
    cue: float | None = None,
    unit_cue: bool = False,
    level: float = 0.95,
) -> PolarityFit:
    """Fit kappa, noise and cue gain of the polarity law to headings.

    Parameters
    ----------
    data : Tracks or Trajectory, or a list of them
        Tracks: the heading is the movement from spot to spot, and the cue the direction of the
        nearest other cell. Runs: polarity and sensed direction as they were recorded.
    cue : float, optional
        A fixed direction instead, rad: of a gradient, say.
    unit_cue : bool
        Of a run: whether its law turns to the unit vector along the sensed direction
        (``closed_loop(..., normalise=True)``); default: the length of d is the cue's strength, as
        in [thesis 72] and in full-order scenes.
    level : float
        Of the intervals, which hold for many turns: errors are robust against unequal noise and
        against what following turns share (Newey & West, 1987, two lags within a cell).

    Returns
    -------
    PolarityFit

    Raises
    ------
    DataError
        Tracks in px or frames, fewer than 20 turns, or a cue that headings never leave.
    ParameterError
        `level` out of (0, 1), or a list that is empty.
    """
    if not 0.0 < real_number(level, "level") < 1.0:
        raise ParameterError(f"level must be in (0, 1), got {level!r}")
    if cue is not None:
        real_number(cue, "cue")
    sets = [data] if isinstance(data, (Tracks, Trajectory)) else list(data)
    if not sets:
        raise ParameterError("data is an empty list; give at least one run or set of tracks")
    found: dict[str, _Series] = {}
    for number, item in enumerate(sets):
        head = f"{number}." if len(sets) > 1 else ""
        cells = _of_tracks(item, cue) if isinstance(item, Tracks) else _of_run(item, cue, unit_cue)
        found |= {f"{head}{name}": series for name, series in cells.items() if len(series.y)}
    turns = sum(len(s.y) for s in found.values())
    if turns < 20:
        raise DataError(f"{turns} turns of cells with a cue; at least 20 are needed for an error")
    width = float(norm.ppf(0.5 + 0.5 * level))
    kappa, error = _instrumental(list(found.values()))
    sigma2, sigma2_error, measured = _noise(list(found.values()), kappa)
    noise = float(np.sqrt(sigma2))
    share = float(np.hypot(error / kappa, sigma2_error / sigma2)) if kappa and sigma2 > 0 else 0.0
    gain = 2.0 * kappa / sigma2 if sigma2 > 0 else float("inf")
    per = {}
    for name, series in found.items():
        if len(series.y) < 5:
            continue
        own, off = _instrumental([series])
        per[name] = CellRate(own, own - width * off, own + width * off, len(series.y))
    low, high = max(0.0, sigma2 - width * sigma2_error), sigma2 + width * sigma2_error
    off = width * share * abs(gain) if np.isfinite(gain) else float("inf")
    return PolarityFit(
        kappa=kappa,
        kappa_interval=(kappa - width * error, kappa + width * error),
        noise=noise,
        noise_interval=(float(np.sqrt(low)), float(np.sqrt(high))),
        measurement=measured,
        cue_gain=gain,
        cue_gain_interval=(gain - off, gain + off),
        cells=per,
        level=level,
        turns=turns,
    )


def _series(
    t: np.ndarray, theta: np.ndarray, phi: np.ndarray, strength: np.ndarray | None = None
) -> _Series:
    """Turns, cues and instruments of headings theta at times t, NaN where there is none."""
    whole = np.isfinite(theta) & np.isfinite(phi)
    dt = np.diff(t)
    turn = (np.diff(theta) + np.pi) % (2.0 * np.pi) - np.pi
    psi = (phi - theta + np.pi) % (2.0 * np.pi) - np.pi
    k = np.arange(1, len(t) - 1)
    pull = dt if strength is None else dt * strength[:-1]
    usual = float(np.median(dt)) if len(dt) else 0.0
    even = np.abs(dt - usual) <= 0.1 * usual  # a turn over a gap is another turn
    good = whole[k] & whole[k - 1] & whole[k + 1] & even[k] & even[k - 1]
    k = k[good]
    block = np.cumsum(np.diff(k, prepend=k[:1] - 1) > 1) if k.size else k
    # The instrument: cue and heading of the step before.
    return _Series(turn[k], psi[k], pull[k], np.sin(psi[k - 1]) * pull[k], dt[k], block)


def _of_run(run: Trajectory, cue: float | None, unit_cue: bool) -> dict[str, _Series]:
    p = run.polarities
    if cue is None and run.d is None:
        raise DataError("the run has no sensed direction; give cue=, a fixed direction")
    found = {}
    for cell in range(p.shape[1]):
        theta = np.arctan2(p[:, cell, 1], p[:, cell, 0])
        if cue is not None or run.d is None:
            phi = np.full(len(theta), 0.0 if cue is None else cue)
            size = None
        else:
            d = np.asarray(run.d)[:, cell]
            size = np.hypot(d[:, 0], d[:, 1])
            phi = np.where(size > 0, np.arctan2(d[:, 1], d[:, 0]), np.nan)
            size = None if unit_cue else size
        found[f"cell{cell + 1}"] = _series(np.asarray(run.t), theta, phi, size)
    return found


def _of_tracks(tracks: Tracks, cue: float | None) -> dict[str, _Series]:
    if tracks.time_unit != "s":
        raise DataError("rates need times in s: tracks.scaled(frame_interval=...)")
    found = {}
    bearing = bearings_of(tracks) if cue is None else np.full(len(tracks), cue)
    for name, theta in headings_of(tracks).items():
        phi = bearing[tracks.cells[name]]
        found[name] = _series(tracks.times(name), theta, phi)
    return found


def _left(psi: np.ndarray, dt: np.ndarray, kappa: float) -> np.ndarray:
    """The cue as seen from the heading after dt: tan(psi/2) falls by exp(-kappa dt)."""
    fall = np.exp(np.clip(-kappa * dt, -700.0, 700.0))
    return np.asarray(2.0 * np.arctan2(np.sin(0.5 * psi) * fall, np.cos(0.5 * psi)))


def _instrumental(cells: list[_Series]) -> tuple[float, float]:
    """kappa and its standard error; see the module."""
    y, psi, z, dt = (
        np.concatenate([getattr(c, n) for c in cells]) for n in ("y", "psi", "z", "pull")
    )
    pull = float(z @ (dt * np.sin(psi)))
    if not abs(pull) > 1e-9 * float(dt @ dt):
        raise DataError("headings do not leave their cue: no turn says how fast they follow it")
    kappa = float(z @ y) / pull
    most = 5.0 / float(np.median(dt))  # faster than that a heading is at its cue in one interval
    for _ in range(50):  # Newton from the explicit step
        after = _left(psi, dt, kappa)
        slope = float(z @ (dt * np.sin(after)))
        if not abs(slope) > 1e-9 * abs(pull):
            raise DataError(
                "cells reach the cue within one interval: how fast they turn is not seen; take "
                "frames more often"
            )
        change = float(z @ (y - (psi - after))) / slope
        kappa += float(np.clip(change, -0.2 * most, 0.2 * most))
        if abs(change) <= 1e-12 * most:
            break
    if not abs(kappa) < most:
        raise DataError(
            f"kappa comes out as {kappa:.3g} 1/s, beyond {most:.3g}: not seen at this interval of "
            "frames; take them more often"
        )
    pull = float(z @ (dt * np.sin(_left(psi, dt, kappa))))
    total = 0.0
    for c in cells:
        score = c.z * (c.y - (c.psi - _left(c.psi, c.pull, kappa)))
        total += float(score @ score)
        for lag, weight in ((1, 2.0 / 3.0), (2, 1.0 / 3.0)):
            if len(score) > lag:
                same = c.block[lag:] == c.block[:-lag]
                total += 2.0 * weight * float((score[lag:] * score[:-lag])[same].sum())
    spare = len(y) / max(len(y) - 1, 1)
    return kappa, float(np.sqrt(max(total, 0.0) * spare)) / abs(pull)


def _noise(cells: list[_Series], kappa: float) -> tuple[float, float, float]:
    """sigma^2 with its standard error, and the error of a heading, from what turns leave over."""
    squares, products, times, kept = [], [], [], []
    for c in cells:
        left = c.y - (c.psi - _left(c.psi, c.pull, kappa))
        same = c.block[1:] == c.block[:-1]
        squares.append(left**2)
        products.append((left[1:] * left[:-1])[same])
        times.append(c.dt)
        fall = 2.0 * kappa * np.cos(c.psi) * c.pull
        kept.append(
            np.where(np.abs(fall) > 1e-9, -np.expm1(-fall) / np.where(fall, fall, 1.0), 1.0)
        )
    second, cross = np.concatenate(squares), np.concatenate(products)
    dt = float(np.mean(np.concatenate(times) * np.concatenate(kept)))
    together = float(cross.mean()) if cross.size else 0.0
    sigma2 = max((float(second.mean()) + 2.0 * together) / dt, 0.0)
    n = max(len(second), 1)
    # Var of a square 2 v^2, of a product of neighbours about v^2; the two nearly uncorrelated.
    error = float(np.sqrt(second.var() / n + 4.0 * cross.var() / max(cross.size, 1))) / dt
    return sigma2, error, float(np.sqrt(max(-together, 0.0)))
