"""H2 and H-infinity norms."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import scipy.linalg as sla
from scipy.optimize import minimize_scalar

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import ParameterError
from cellsys.response.frequency import FrequencyResponse, frequency_response
from cellsys.spectra.gramians import factor, unscaled
from cellsys.spectra.realization import Realization, balance, realization
from cellsys.spectra.resolvent import Resolvent, s_plane


@checked
@dataclass(frozen=True, kw_only=True)
class SystemNorm(Drawable):
    """A norm; ``float()`` gives the value, ``plot()`` the singular values with the peak marked.

    Attributes
    ----------
    value : float
        inf for an unstable system, or the H2 norm of a continuous one with D != 0.
    frequency : float
        rad/s where the H-infinity norm is reached; nan for H2.
    upper : float
        Certified upper bound: no larger gain exists.
    kind : str
        ``"H2"`` or ``"H-infinity"``.
    note : str
        Why it is infinite.
    system : Realization
        Whose norm it is.
    """

    _figure: ClassVar[str] = "system_norm"

    value: float
    frequency: float
    upper: float
    kind: str
    note: str = ""
    system: Realization | None = field(default=None, repr=False, compare=False)

    @property
    def response(self) -> FrequencyResponse:
        """Frequency response of the system on the automatic grid."""
        if self.system is None:
            raise ParameterError("this norm came without its system; h2_norm and hinf_norm keep it")
        return frequency_response(self.system)

    def __float__(self) -> float:
        return self.value

    def __str__(self) -> str:
        at = f" at {self.frequency:.4g} rad/s" if np.isfinite(self.frequency) else ""
        return f"{self.kind} norm {self.value:.8g}{at}" + (f" ({self.note})" if self.note else "")


def _unstable(system: Realization) -> str:
    if not system.n_states:
        return ""
    values = sla.eigvals(balance(system).A)
    excess = np.abs(values) - 1 if system.is_discrete else values.real
    if excess.max() < 0:
        return ""
    return f"pole {complex(values[np.argmax(excess)]):.6g} is not inside the stability region"


@checked
def h2_norm(sys: LinearSystem) -> SystemNorm:
    """H2 norm: the rms output under unit white noise.

        |G|_2^2 = trace(C X C^T) (+ |D|_F^2 in discrete time),  A X + X A^T + B B^T = 0

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays

    Returns
    -------
    SystemNorm

    Raises
    ------
    DataError, DimensionError, ParameterError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Zhou, Doyle and Glover, Robust and Optimal Control (1996), section 4.
    """
    system = realization(sys).dense()
    return replace(_h2(system), system=system)


def _h2(system: Realization) -> SystemNorm:
    note = _unstable(system)
    d = float(sla.norm(system.D)) if system.D.size else 0.0
    if not note and d > 0 and not system.is_discrete:
        note = "D is not zero"
    if note:
        return SystemNorm(value=np.inf, frequency=np.nan, upper=np.inf, kind="H2", note=note)
    b = unscaled(balance(system))
    F = factor(b.A, b.B, discrete=system.is_discrete)
    value = float(np.hypot(np.linalg.norm(b.C @ F), d))
    return SystemNorm(value=value, frequency=np.nan, upper=value, kind="H2")


@checked
def hinf_norm(sys: LinearSystem, *, rtol: float = 1e-8) -> SystemNorm:
    """H-infinity norm: the largest singular value of the frequency response.

    Level-set iteration: the frequencies where the largest singular value equals g are the
    imaginary eigenvalues of a Hamiltonian matrix; the next g is reached at their midpoints. A
    discrete system is first mapped by s = (z - 1)/(z + 1), which keeps the norm.

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays
    rtol : float
        Gap between value and certified upper bound.

    Returns
    -------
    SystemNorm

    Raises
    ------
    DataError, DimensionError, ParameterError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Bruinsma and Steinbuch, Systems and Control Letters 14 (1990) 287.
    """
    system = realization(sys).dense()
    return replace(_hinf(system, rtol), system=system)


def _hinf(system: Realization, rtol: float) -> SystemNorm:
    note = _unstable(system)
    if note:
        return SystemNorm(
            value=np.inf, frequency=np.nan, upper=np.inf, kind="H-infinity", note=note
        )
    if min(system.n_inputs, system.n_outputs) == 0:
        return SystemNorm(
            value=0.0,
            frequency=np.nan,
            upper=0.0,
            kind="H-infinity",
            note="no inputs or no outputs",
        )
    b = unscaled(balance(system))
    plain = Realization(b.A, b.B, b.C, b.D)
    if system.is_discrete:
        plain = _bilinear(plain)
    value, omega, upper = _level_sets(plain, rtol)
    if system.is_discrete:
        omega = 2 * np.arctan(omega) / system.dt
    return SystemNorm(value=value, frequency=omega, upper=upper, kind="H-infinity")


@checked
def norm(sys: LinearSystem, order: float | str = 2) -> SystemNorm:
    """H2 norm (order 2) or H-infinity norm (order ``np.inf`` or ``"inf"``).

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays
    order : 2, np.inf or "inf"

    Returns
    -------
    SystemNorm
        See `h2_norm` and `hinf_norm` for equations, sources and errors.

    Raises
    ------
    ParameterError
        Another order.
    """
    if order == 2:
        return h2_norm(sys)
    if order in ("inf", np.inf):
        return hinf_norm(sys)
    raise ParameterError(f"order must be 2 or inf, got {order!r}")


def _bilinear(system: Realization) -> Realization:
    """z = (1 + s)/(1 - s); A + I is regular for a stable A."""
    A, B, C, D = system.A, system.B, system.C, system.D
    n = len(A)
    lu = sla.lu_factor(A + np.eye(n)) if n else None
    if lu is None:
        return system
    left = sla.lu_solve(lu, np.hstack([A - np.eye(n), np.sqrt(2) * B]))
    return Realization(
        left[:, :n],
        left[:, n:],
        np.sqrt(2) * sla.lu_solve(lu, C.T, trans=1).T,
        D - C @ sla.lu_solve(lu, B),
    )


def _largest(G: np.ndarray) -> np.ndarray:
    """Largest singular value of (p, m, k)."""
    if G.shape[:2] == (1, 1):
        return np.abs(G[0, 0])
    return np.linalg.svd(np.moveaxis(G, -1, 0), compute_uv=False)[:, 0]


def _level_sets(system: Realization, rtol: float) -> tuple[float, float, float]:
    evaluate = Resolvent(system)
    D = system.D
    end = float(sla.svdvals(D)[0])
    if not system.n_states:
        return end, 0.0, end
    values = sla.eigvals(system.A)
    turn = np.abs(values.imag)
    start = np.unique(np.concatenate([[0.0], turn, np.abs(values)]))
    gain = _largest(evaluate(s_plane(start, 0.0)))
    i = int(np.argmax(gain))
    best, omega = float(gain[i]), float(start[i])
    if end >= best:
        best, omega = end, np.inf
    if best == 0:
        return 0.0, 0.0, 0.0
    best, omega = _polish(evaluate, best, omega)
    for _ in range(30):
        level = best * (1 + rtol)
        found = _imaginary(system, level)
        if found.size:
            middles = np.sqrt(found[1:] * found[:-1])
            trial = np.concatenate([found, middles, 0.5 * (found[1:] + found[:-1])])
            gain = _largest(evaluate(s_plane(trial, 0.0)))
            i = int(np.argmax(gain))
            if gain[i] > level:
                best, omega = _polish(evaluate, float(gain[i]), float(trial[i]))
                continue
        return best, omega, level
    return best, omega, np.inf


def _imaginary(system: Realization, level: float) -> np.ndarray:
    """Frequencies >= 0 where the largest singular value may equal `level`, rising."""
    A, B, C, D = system.A, system.B, system.C, system.D
    R = level**2 * np.eye(D.shape[1]) - D.T @ D
    lu = sla.lu_factor(R)
    F = A + B @ sla.lu_solve(lu, D.T @ C)
    S = -C.T @ (C + D @ sla.lu_solve(lu, D.T @ C))
    # Both off-diagonal blocks scaled to the same size: the eigenvalues stay.
    mu = sla.eigvals(np.block([[F, level * (B @ sla.lu_solve(lu, B.T))], [S / level, -F.T]]))
    near = np.abs(mu.real) <= 1e-6 * np.abs(mu) + 1e-10 * float(sla.norm(A))
    return np.unique(np.abs(mu.imag[near]))


def _polish(evaluate: Resolvent, best: float, omega: float) -> tuple[float, float]:
    """Climb to the top of the peak at omega."""
    if not np.isfinite(omega) or omega == 0:
        return best, omega

    def negative(x: float) -> float:
        return -float(_largest(evaluate(np.array([1j * np.exp(x)])))[0])

    x = np.log(omega)
    for width in (0.5, 1e-2, 1e-4, 1e-6):
        found = minimize_scalar(
            negative, bounds=(x - width, x + width), method="bounded", options={"xatol": 1e-12}
        )
        if -found.fun > best:
            best, x = -float(found.fun), float(found.x)
    return best, float(np.exp(x))
