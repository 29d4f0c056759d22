"""Gain, phase, delay and disk margins of the negative feedback loop 1 + L."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, overload

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import DimensionError, ParameterError
from cellsys.kinds import ComplexArray
from cellsys.linear_systems import FrequencyDataLike, StateSpaceLike, TransferFunctionLike
from cellsys.response.crossings import crossings
from cellsys.response.delayed import DelayedLoci, with_samples_of_delay
from cellsys.response.disk import disk_margin
from cellsys.response.eigenvalue_loci import Loci
from cellsys.response.frequency import FrequencyResponse, check_omega
from cellsys.response.measured import MeasuredMargins, check_delay, measured_margins, samples_of
from cellsys.spectra.integrators import MARGINAL, counted
from cellsys.spectra.realization import EPS, Realization, balance, balancing, realization
from cellsys.system import Matrix


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
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
    loci : Loci or DelayedLoci
        The grid and the loci, for drawing.
    """

    _figure: ClassVar[str] = "bode"
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
    loci: Loci | DelayedLoci

    def table(self) -> dict[str, float]:
        """The figures of merit by name, deg and s."""
        return {
            "gain_margin": self.gain_margin,
            "phase_margin_deg": self.phase_margin,
            "delay_margin_s": self.delay_margin,
            "closed_loop_stable": self.closed_loop_stable,
        }

    def __str__(self) -> str:
        loop = "stable" if self.closed_loop_stable else "NOT stable: read these as distances"
        if self.closed_loop_stable and self.integrators:
            loop = MARGINAL
        return (
            f"gain margin  {self.gain_margin:.6g} at {self.gain_margin_frequency:.4g} rad/s\n"
            f"phase margin {self.phase_margin:.6g} deg at "
            f"{self.phase_margin_frequency:.4g} rad/s\n"
            f"delay margin {self.delay_margin:.6g} s at {self.delay_margin_frequency:.4g} rad/s\n"
            f"disk margin  {self.disk_margin:.4g} at {self.disk_margin_frequency:.4g} rad/s\n"
            f"closed loop {loop} (P = {self.open_loop_unstable}, N = {self.encirclements}, "
            f"Z = {self.closed_loop_unstable}"
            + (f", {counted(self.integrators)} set apart)" if self.integrators else ")")
            + ("" if self.loci.complete else "\ncrossings sought on the refined grid alone")
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
    values = np.linalg.eigvals(A)
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
    # A small singular value alone may only mean that A is far from normal.
    slow = int(np.count_nonzero(np.abs(np.linalg.eigvals(A)) <= max(tol, 1e-6 * norm)))
    if not slow:
        return 0
    unseen, R = _null(np.vstack([A, b.C]), tol)
    unmoved, _ = _null(np.vstack([R.T @ A.T @ R, b.B.T @ R]), tol)
    return min(unseen + unmoved, slow)


def _null(M: np.ndarray, tol: float) -> tuple[int, np.ndarray]:
    """Dimension of the null space of M, and an orthonormal basis of its complement."""
    if not M.shape[1]:
        return 0, np.zeros((0, 0))
    _, s, Vt = sla.svd(M)
    count = int(np.count_nonzero(s <= tol))
    return count, Vt[: M.shape[1] - count].T


def _above(values: np.ndarray) -> np.ndarray:
    """Phase above -180 deg, (-180, 180]."""
    angle = np.angle(-values, deg=True)
    return np.where(angle == -180.0, 180.0, angle) + 0.0


def _at_the_ends(loci: Loci) -> tuple[np.ndarray, np.ndarray]:
    """Crossings at 0 and at pi/dt or infinity, where L is real: rows as in `Margins`.

    A real negative locus; a locus of modulus one, which for L(0) = 1 means a turn of 180 deg.
    """
    at = np.tile(loci.ends.omega, (len(loci.ends.values), 1)).ravel()
    values, noise = loci.ends.values.ravel(), loci.ends.noise.ravel()
    size = np.abs(values)
    real = (values.real < -noise) & (np.abs(values.imag) <= np.maximum(noise, 1e-12 * size))
    unit = np.abs(size - 1) <= np.minimum(2 * noise + 4 * EPS, 1e-6)
    phase = np.column_stack([at[real], 1 / size[real]])
    return phase, np.column_stack([at[unit], _above(values[unit])])


def _crossings(loci: Loci) -> tuple[np.ndarray, np.ndarray]:
    """`Margins.phase_crossings` and `Margins.gain_crossings`."""
    real, unit = crossings(loci)
    phase, gain = _at_the_ends(loci)
    inner = np.column_stack([real.omega, 1 / np.abs(real.values)])
    phase = np.concatenate([inner, phase])
    gain = np.concatenate([np.column_stack([unit.omega, _above(unit.values)]), gain])
    # L = -1 is both, also where the locus runs along the unit circle and never crosses it.
    share = np.append(real.noise / np.abs(real.values), np.zeros(len(phase) - len(real.omega)))
    for omega in phase[np.abs(np.log(phase[:, 1])) <= 2 * share + 8 * EPS, 0]:
        if not np.any(np.isclose(gain[:, 0], omega, rtol=1e-6, atol=0.0)):
            gain = np.concatenate([gain, [[omega, 0.0]]])
    return _sorted(phase), _sorted(gain)


def _sorted(rows: np.ndarray) -> np.ndarray:
    return rows[np.argsort(rows[:, 0], kind="stable")]


@overload
def margins(
    sys: FrequencyResponse | FrequencyDataLike,
    omega: None = None,
    *,
    delay: float = 0.0,
    accuracy: np.ndarray | None = None,
) -> MeasuredMargins:
    """Of samples."""


@overload
def margins(
    sys: StateSpaceLike | TransferFunctionLike | tuple[Any, ...],
    omega: np.ndarray | None = None,
    *,
    delay: float = 0.0,
) -> Margins:
    """Of a system."""


@overload
def margins(
    sys: Matrix,
    omega: np.ndarray | None = None,
    *,
    delay: float = 0.0,
    accuracy: np.ndarray | None = None,
) -> Margins | MeasuredMargins:
    """Of a system without inputs, or of frequencies with their values."""


@checked
def margins(
    sys: LinearSystem | FrequencyResponse | FrequencyDataLike,
    omega: ComplexArray | None = None,
    *,
    delay: float = 0.0,
    accuracy: np.ndarray | None = None,
) -> Margins | MeasuredMargins:
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
        Return ratio L, as many inputs as outputs. Or samples of a scalar L: a `FrequencyResponse`,
        ``control.FRD``, or the frequencies (k,) in rad/s with their values as second argument,
        ``margins(omega, H)``.
    omega : array, optional
        Grid in rad/s to look for crossings on, instead of the automatic one; positive.
    delay : float
        A pure delay tau of a scalar loop, s: the margins of L exp(-s tau), exactly, without a
        Pade form. Poles counted in `closed_loop_unstable` are those of the delayed loop.
    accuracy : array (k,), optional
        Relative error of samples, carried to the margins; a `FrequencyResponse` has its own.

    Returns
    -------
    Margins
        Of samples `MeasuredMargins`: as given, with the errors of interpolation and of the data.

    Raises
    ------
    DimensionError
        L is not square, or has a delay and several channels.
    ParameterError
        A delay that is no whole number of samples of a discrete loop, or one of a loop that does
        not roll off below 1.
    DataError, ParameterError, MemoryBudgetError
        As for `frequency_response`.

    References
    ----------
    Astrom and Murray, Feedback Systems (2021), section 10.3; Seiler, Packard and Gahinet, IEEE
    Control Systems Magazine 40 (2020) 78, for the disk margin (sigma = 0).
    """
    delay = check_delay(delay)
    if (samples := samples_of(sys, omega, accuracy)) is not None:
        return measured_margins(*samples, delay)
    if accuracy is not None or isinstance(sys, (FrequencyResponse, FrequencyDataLike)):
        raise ParameterError("accuracy is that of samples; a system's own is known: leave it out")
    system = realization(sys)
    if system.n_inputs != system.n_outputs:
        raise DimensionError(
            f"a return ratio needs as many outputs as inputs, got {system.n_outputs} outputs and "
            f"{system.n_inputs} inputs; close or select channels first"
        )
    system = system.dense()
    if delay:
        if system.n_inputs != 1:
            raise DimensionError(
                f"delay = {delay:g} s is for a scalar loop, got {system.n_inputs} channels; "
                "select one"
            )
        if system.is_discrete:
            system = with_samples_of_delay(system, delay)
    if omega is not None:
        omega = check_omega(omega, system)
        omega = omega[omega > 0]
    undelayed = Loci(system, omega)
    loci: Loci | DelayedLoci = undelayed
    P, _ = _unstable(system.A, system.dt)
    closed = closed_loop_matrix(system)
    solvable = closed.shape == system.A.shape
    Z, edge = _unstable(closed, system.dt)
    if not loci.omega.size:
        phase, gain, disk = np.zeros((0, 2)), np.zeros((0, 2)), (np.inf, np.nan)
    else:
        phase, gain = _crossings(undelayed)
        if delay and not system.is_discrete:
            loci = DelayedLoci(undelayed, delay, gain)
            phase, gain, disk = loci.phase_crossings, loci.gain_crossings(), loci.disk()
            Z, edge = loci.unstable(Z), edge + loci.on_the_axis()
        else:
            disk = disk_margin(undelayed)
    picked = _pick(phase, gain, undelayed)
    fixed = _fixed_integrators(system)
    gm, gm_w, pm, pm_w, delay, delay_w, up, down = picked
    return Margins(
        gain_margin=gm,
        gain_margin_frequency=gm_w,
        phase_margin=pm,
        phase_margin_frequency=pm_w,
        delay_margin=delay,
        delay_margin_frequency=delay_w,
        gain_margin_up=up,
        gain_margin_down=down,
        phase_crossings=phase,
        gain_crossings=gain,
        disk_margin=disk[0],
        disk_margin_frequency=disk[1],
        open_loop_unstable=P,
        closed_loop_unstable=Z,
        encirclements=Z - P,
        integrators=fixed,
        closed_loop_stable=solvable and Z == 0 and edge <= fixed,
        loci=loci,
    )


def _pick(
    phase: np.ndarray, gain: np.ndarray, loci: Loci
) -> tuple[float, float, float, float, float, float, float, float]:
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
    # A delay turns nothing at 0, and everything at infinity.
    lag = np.deg2rad(gain[:, 1] % 360.0)
    useful = (gain[:, 0] > 0) | (lag == 0)
    delays = lag[useful] / np.where(lag[useful] > 0, gain[useful, 0], 1.0)
    if len(delays):
        i = int(np.argmin(delays))
        dm_w, dm = float(gain[useful][i, 0]), float(delays[i])
    high = loci.ends.values[:, loci.ends.omega == np.inf]
    if np.any(np.abs(high) >= 1 - 4 * EPS) and dm > 0:
        dm, dm_w = 0.0, np.inf
    return gm, gm_w, pm, pm_w, dm, dm_w, up, down
