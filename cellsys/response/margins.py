"""Gain, phase, delay and disk margins of the negative feedback loop 1 + L."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.linalg as sla
from scipy.optimize import minimize_scalar

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import DimensionError
from cellsys.response.frequency import check_omega
from cellsys.response.loci import Loci
from cellsys.response.realization import EPS, Realization, balance, balancing, realization
from cellsys.response.resolvent import s_plane


@checked
@dataclass(frozen=True, eq=False)
class Margins(Drawable):
    """Margins of det(I + L) = 0; inf where there is none, frequencies then nan.

    Attributes
    ----------
    gain_margin, gain_margin_frequency : float
        Factor on L, of all that put a pole on the axis, nearest to 1 in ratio (may be below 1:
        then the gain may not fall); rad/s.
    phase_margin, phase_margin_frequency : float
        Smallest turn, deg, with its sign: negative when the locus has already passed -180 deg.
    delay_margin, delay_margin_frequency : float
        Smallest added delay, s, that puts a pole on the axis.
    gain_margin_up, gain_margin_down : float
        Smallest factor above 1 (inf if none) and largest below 1 (0 if none).
    phase_crossings : array (a, 2)
        Every frequency (rad/s) where a locus is real and negative, and 1/|L| there.
    gain_crossings : array (b, 2)
        Every frequency (rad/s) where |L| = 1, and the phase above -180 deg there, (-180, 180].
    disk_margin, disk_margin_frequency : float
        alpha = 2 / max |(1 - L)/(1 + L)| (largest singular value for a matrix L): gain by
        (2 + alpha)/(2 - alpha) either way, or phase by 2 atan(alpha/2), at the same time.
    open_loop_unstable, closed_loop_unstable : int
        Poles P of L and Z of the closed loop in the open right half-plane (outside the circle).
    encirclements : int
        Z - P: clockwise turns of the Nyquist plot around -1 (poles on the axis passed on the
        right).
    integrators : int
        Poles at 0 (1 in discrete time) that the loop does not see or does not move, absolute
        position say: set apart.
    closed_loop_stable : bool
        Z = 0, no other closed-loop pole on the boundary, I + D regular. Where False the margins
        are distances to the boundary, no margins of stability.
    loci : Loci
        The grid and the loci, for drawing.
    """

    _figure: ClassVar[str] = "nyquist"
    gain_margin: float
    gain_margin_frequency: float
    phase_margin: float
    phase_margin_frequency: float
    delay_margin: float
    delay_margin_frequency: float
    gain_margin_up: float
    gain_margin_down: float
    phase_crossings: np.ndarray
    gain_crossings: np.ndarray
    disk_margin: float
    disk_margin_frequency: float
    open_loop_unstable: int
    closed_loop_unstable: int
    encirclements: int
    integrators: int
    closed_loop_stable: bool
    loci: Loci

    def table(self) -> dict[str, Any]:
        """The figures of merit by name, deg and s."""
        return {
            "gain_margin": self.gain_margin,
            "phase_margin_deg": self.phase_margin,
            "delay_margin_s": self.delay_margin,
            "closed_loop_stable": self.closed_loop_stable,
        }

    def __str__(self) -> str:
        loop = "stable" if self.closed_loop_stable else "NOT stable: read these as distances"
        return (
            f"gain margin  {self.gain_margin:.6g} at {self.gain_margin_frequency:.4g} rad/s\n"
            f"phase margin {self.phase_margin:.6g} deg at "
            f"{self.phase_margin_frequency:.4g} rad/s\n"
            f"delay margin {self.delay_margin:.6g} s at {self.delay_margin_frequency:.4g} rad/s\n"
            f"disk margin  {self.disk_margin:.4g} at {self.disk_margin_frequency:.4g} rad/s\n"
            f"closed loop {loop} (P = {self.open_loop_unstable}, N = {self.encirclements}, "
            f"Z = {self.closed_loop_unstable}"
            + (f", {self.integrators} integrators set apart)" if self.integrators else ")")
        )


def closed_loop_matrix(system: Realization) -> np.ndarray:
    """A - B (I + D)^-1 C, or a (0,) array when I + D is singular (an algebraic loop)."""
    F = np.eye(system.n_inputs) + system.D
    if system.n_inputs == 0:
        return system.A
    if sla.svdvals(F)[-1] < 1e-14 * max(1.0, float(sla.norm(system.D))):
        return np.zeros(0)
    return system.A - system.B @ sla.solve(F, system.C)


def _unstable(A: np.ndarray, dt: float) -> tuple[int, int]:
    """Eigenvalues outside the stability region and on its boundary (to 100 n eps |A|)."""
    if not A.size:
        return 0, 0
    A = balancing(A)[0]
    tol = 100 * len(A) * EPS * float(sla.norm(A))
    values = sla.eigvals(A)
    excess = np.abs(values) - 1 if dt > 0 else values.real
    return int(np.count_nonzero(excess > tol)), int(np.count_nonzero(np.abs(excess) <= tol))


def _fixed_integrators(system: Realization) -> int:
    """Poles at 0 (at 1 in discrete time) that the loop does not see or does not move.

    Null directions of [A; C], then, on what is left, of [A, B] from the left.
    """
    b = balance(system)
    n = len(b.A)
    if n == 0:
        return 0
    A = b.A - np.eye(n) if system.is_discrete else b.A
    norm = float(sla.norm(b.A))
    tol = 10 * n * EPS * norm
    unseen, R = _null(np.vstack([A, b.C]), tol)
    unmoved, _ = _null(np.vstack([R.T @ A.T @ R, b.B.T @ R]), tol)
    if unseen + unmoved == 0:
        return 0
    # A small singular value alone may only mean that A is far from normal.
    slow = np.abs(sla.eigvals(A)) <= max(tol, 1e-6 * norm)
    return min(unseen + unmoved, int(np.count_nonzero(slow)))


def _null(M: np.ndarray, tol: float) -> tuple[int, np.ndarray]:
    """Dimension of the null space of M, and an orthonormal basis of its complement."""
    if not M.shape[1]:
        return 0, np.zeros((0, 0))
    _, s, Vt = sla.svd(M)
    count = int(np.count_nonzero(s <= tol))
    return count, Vt[: M.shape[1] - count].T


def _log_size(value: complex) -> float:
    return float(np.log(abs(value))) if value != 0 else -np.inf


def _imaginary(value: complex) -> float:
    """Im L / |L|, with a positive real part moved away from 0: only Re L < 0 is a crossing."""
    size = abs(value)
    if size == 0:
        return 0.0
    return float(value.imag / size) if value.real < 0 else (1.0 if value.imag >= 0 else -1.0)


def _real_ends(loci: Loci) -> list[tuple[float, complex]]:
    """Frequencies 0 and pi/dt (or infinity), where L is real: a real negative locus counts."""
    system, found = loci.system, []
    points = [(0.0, 1.0 if system.is_discrete else 0.0)]
    if system.is_discrete:
        points.append((np.pi / system.dt, -1.0))
    for omega, s in points:
        L, bound = loci.evaluate.with_accuracy(np.array([s], dtype=complex))
        if not np.all(np.isfinite(L)) or not np.all(np.isfinite(bound)):
            continue
        size = float(np.sqrt((bound**2).sum()))
        for value in np.linalg.eigvals(L[:, :, 0]):
            if value.real < -size and abs(value.imag) <= max(size, 1e-12 * abs(value)):
                found.append((omega, complex(value)))
    if not system.is_discrete and system.D.size:
        for value in np.linalg.eigvals(system.D):
            if value.real < 0 and abs(value.imag) <= 1e-12 * abs(value):
                found.append((np.inf, complex(value)))
    return found


def _disk(loci: Loci) -> tuple[float, float]:
    """2 / max of |(I + L)^-1 (I - L)| over the grid, its two ends, and polished at the peak."""
    q = loci.L.shape[0]
    identity = np.eye(q)

    def size(L: np.ndarray) -> float:
        try:
            return float(sla.svdvals(np.linalg.solve(identity + L, identity - L))[0])
        except np.linalg.LinAlgError:
            return np.inf

    values = np.array([size(L) for L in np.moveaxis(loci.L, -1, 0)])
    i = int(np.argmax(values))
    lo, hi = max(i - 1, 0), min(i + 1, len(values) - 1)
    omega, peak = float(loci.omega[i]), float(values[i])

    def negative(x: float) -> float:
        return -size(loci.evaluate.at(complex(s_plane(np.exp([x]), loci.system.dt)[0])))

    if hi > lo and np.isfinite(peak):
        best = minimize_scalar(
            negative, bounds=tuple(np.log(loci.omega[[lo, hi]])), method="bounded",
            options={"xatol": 1e-9},
        )
        if -best.fun > peak:
            omega, peak = float(np.exp(best.x)), float(-best.fun)
    discrete = loci.system.is_discrete
    top = np.pi / loci.system.dt if discrete else np.inf
    ends = [(0.0, loci.evaluate.at(1.0 if discrete else 0.0))]
    ends.append((top, loci.evaluate.at(-1.0) if discrete else loci.system.D))
    for end, L in ends:
        if np.all(np.isfinite(L)) and size(L) > peak * (1 + 1e-12):
            omega, peak = end, size(L)
    return (2.0 / peak if peak > 0 else np.inf), omega


@checked
def margins(sys: LinearSystem, omega: np.ndarray | None = None) -> Margins:
    """Gain, phase, delay and disk margins of the NEGATIVE feedback loop det(I + L) = 0.

        gain margin 1/|L| where arg L = -180 deg;  phase margin 180 deg + arg L where |L| = 1;
        delay margin = (phase lag left) / omega at the same crossings

    Everything comes from the frequency response in state space: an automatic grid, refined until
    L turns by less than 20 deg between neighbours and extended until no crossing is left outside,
    sign changes, root finding. For a matrix L the margins are read from its eigenvalue loci: a
    common factor, lag or delay in all channels.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction (SISO) or tuple of arrays
        Return ratio L, as many inputs as outputs.
    omega : array, optional
        Grid in rad/s to look for crossings on, instead of the automatic one; positive.

    Returns
    -------
    Margins

    Raises
    ------
    DimensionError
        L is not square.
    DataError, ParameterError, BudgetError
        As for `frequency_response`.

    References
    ----------
    Astrom and Murray, Feedback Systems (2021), section 10.3; Seiler, Packard and Gahinet, IEEE
    Control Systems Magazine 40 (2020) 78, for the disk margin (sigma = 0).
    """
    system = realization(sys)
    if system.n_inputs != system.n_outputs:
        raise DimensionError(
            f"a return ratio needs as many outputs as inputs, got {system.n_outputs} outputs and "
            f"{system.n_inputs} inputs; close or select channels first"
        )
    system = system.dense()
    if omega is not None:
        omega = check_omega(omega, system)
        omega = omega[omega > 0]
    loci = Loci(system, omega)
    P, _ = _unstable(system.A, system.dt)
    closed = closed_loop_matrix(system)
    solvable = closed.shape == system.A.shape
    Z, edge = _unstable(closed, system.dt)
    if system.n_inputs == 0 or not loci.omega.size:
        phase, gain, disk = np.zeros((0, 2)), np.zeros((0, 2)), (np.inf, np.nan)
    else:
        real = loci.crossings(_imaginary, lambda v, e: 2 * e / np.abs(v)) + _real_ends(loci)
        real = [(w, v) for w, v in real if v.real < 0]
        unit = loci.crossings(_log_size, lambda v, e: 2 * e / np.abs(v))
        phase = np.array([(w, 1 / abs(v)) for w, v in real]).reshape(-1, 2)
        gain = np.array([(w, np.angle(-v, deg=True)) for w, v in unit]).reshape(-1, 2)
        disk = _disk(loci)
    picked = _pick(phase, gain)
    fixed = _fixed_integrators(system)
    return Margins(
        *picked, phase, gain, *disk, P, Z, Z - P, fixed, solvable and Z == 0 and edge <= fixed,
        loci,
    )


def _pick(phase: np.ndarray, gain: np.ndarray) -> tuple[float, ...]:
    """Gain, phase and delay margin with their frequencies, then the gain margins up and down."""
    gm, gm_w, up, down = np.inf, np.nan, np.inf, 0.0
    if len(phase):
        i = int(np.argmin(np.abs(np.log(phase[:, 1]))))
        gm_w, gm = float(phase[i, 0]), float(phase[i, 1])
        up = float(phase[phase[:, 1] >= 1, 1].min(initial=np.inf))
        down = float(phase[phase[:, 1] < 1, 1].max(initial=0.0))
    pm, pm_w, dm, dm_w = np.inf, np.nan, np.inf, np.nan
    if len(gain):
        i = int(np.argmin(np.abs(gain[:, 1])))
        pm_w, pm = float(gain[i, 0]), float(gain[i, 1])
        delays = np.deg2rad(gain[:, 1] % 360.0) / gain[:, 0]
        i = int(np.argmin(delays))
        dm_w, dm = float(gain[i, 0]), float(delays[i])
    return gm, gm_w, pm, pm_w, dm, dm_w, up, down
