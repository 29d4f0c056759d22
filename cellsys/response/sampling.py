"""Between continuous and discrete time, names kept: c2d, d2c."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.errors import ParameterError
from cellsys.response.sampling_rules import FirstOrderHold, ImpulseInvariance, MatchedPoles
from cellsys.spectra.realization import EPS, Realization, balancing, realization
from cellsys.units import real_number

if TYPE_CHECKING:
    import control


@checked
@dataclass(frozen=True)
class ZeroOrderHold:
    """Input constant over each step: x+ = exp(A h) x + int exp(A s) ds B u. Exact at samples."""

    def discrete(self, system: Realization, dt: float) -> Realization:
        """Sample with step dt (s)."""
        n = system.n_states
        F = exponential(system.A, system.B, dt)
        return replace(system, A=F[:n, :n], B=F[:n, n:], dt=dt)

    def continuous(self, system: Realization) -> Realization:
        """The continuous system with these samples; ParameterError where there is none."""
        n, m = system.n_states, system.n_inputs
        values = sla.eigvals(balancing(system.A)[0]) if n else np.zeros(0)
        _refuse_negative(values, 10 * n * EPS * float(sla.norm(balancing(system.A)[0])))
        A, scale = balancing(system.A)
        M = np.block([[A, system.B / scale[:, None]], [np.zeros((m, n)), np.eye(m)]])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # its accuracy is measured below
            L = np.real(sla.logm(M)) / system.dt if n else np.zeros((m, m))
        back = sla.expm(L * system.dt)
        if float(sla.norm(back - M)) > 1e-6 * max(float(sla.norm(M)), 1e-300):
            raise ParameterError("the logarithm of the sampled system is not accurate to 1e-6")
        return replace(
            system,
            A=L[:n, :n] * scale[:, None] / scale[None, :],
            B=L[:n, n:] * scale[:, None],
            dt=0.0,
        )


@checked
@dataclass(frozen=True)
class Tustin:
    """Bilinear rule s = (2/h) (z - 1)/(z + 1); the response is kept, the frequency axis warped.

    Parameters
    ----------
    match : float
        Frequency in rad/s at which the two responses agree exactly; 0 for the plain rule.
    """

    match: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "match", real_number(self.match, "Tustin.match"))

    def _rate(self, dt: float) -> float:
        if not 0 <= self.match < np.pi / dt:
            raise ParameterError(
                f"Tustin.match must lie in [0, pi/dt) = [0, {np.pi / dt:.6g}) rad/s, "
                f"got {self.match!r}"
            )
        return self.match / np.tan(self.match * dt / 2) if self.match else 2.0 / dt

    def discrete(self, system: Realization, dt: float) -> Realization:
        """Sample with step dt (s)."""
        a = self._rate(dt)
        return _moebius(
            system,
            a * np.eye(system.n_states) - system.A,
            a * np.eye(system.n_states) + system.A,
            np.sqrt(2 * a),
            1.0,
            dt,
        )

    def continuous(self, system: Realization) -> Realization:
        """Undo `discrete`; ParameterError when -1 is a pole."""
        a, n = self._rate(system.dt), system.n_states
        return _moebius(
            system, np.eye(n) + system.A, a * (system.A - np.eye(n)), np.sqrt(2 * a), -1.0, 0.0
        )


def _refuse_negative(values: np.ndarray, size: float) -> None:
    """ParameterError for poles at 0 or on the negative real axis of the z plane."""
    cure = "; keep the discrete system, sample faster, or undo the bilinear rule: Tustin()"
    if np.any(np.abs(values) <= size):
        raise ParameterError(
            "a pole at z = 0 is a pure delay of one sample: no continuous system of finite order "
            f"sampled with a zero-order hold gives it{cure}"
        )
    real = (values.real < 0) & (np.abs(values.imag) <= 1e-12 * np.abs(values))
    if np.any(real):
        bad = float(values.real[np.argmax(real)])
        raise ParameterError(
            f"z = {bad:.6g} is a pole on the negative real axis: it has no real principal "
            "logarithm, so that no continuous system of the same order with all modes below the "
            "Nyquist frequency gives it under a zero-order hold (one of higher order does, in "
            f"which it is an oscillation at the Nyquist frequency){cure}"
        )


def _moebius(
    system: Realization, M: np.ndarray, N: np.ndarray, root: float, sign: float, dt: float
) -> Realization:
    """A -> M^-1 N, B -> root M^-1 B, C -> root C M^-1, D -> D + sign C M^-1 B."""
    if not len(M):
        return replace(system, dt=dt)
    if sla.svdvals(balancing(M)[0])[-1] <= len(M) * EPS * sla.norm(M):
        raise ParameterError("the bilinear rule meets a pole of the system at its own singularity")
    lu = sla.lu_factor(M)
    return replace(
        system,
        A=sla.lu_solve(lu, N),
        B=root * sla.lu_solve(lu, system.B),
        C=root * sla.lu_solve(lu, system.C.T, trans=1).T,
        D=system.D + sign * system.C @ sla.lu_solve(lu, system.B),
        dt=dt,
    )


def exponential(A: np.ndarray, B: np.ndarray, h: float) -> np.ndarray:
    """[exp(A h), int_0^h exp(A s) ds B], (n, n + m), by one exponential of a balanced matrix."""
    n, m = B.shape
    A, scale = balancing(A)
    M = np.zeros((n + m, n + m))
    M[:n, :n], M[:n, n:] = A, B / scale[:, None]
    # Inputs in large units may not decide the number of squarings.
    unit = 1.0
    if n and np.any(M[:n, n:]) and np.any(A):
        ratio = float(sla.norm(M[:n, n:], 1)) / float(sla.norm(A, 1))
        unit = float(np.exp2(np.clip(np.floor(np.log2(ratio)), -1000, 1000)))
    M[:n, n:] /= unit
    F = sla.expm(M * h)[:n] if n else np.zeros((0, m))
    F[:, n:] *= unit
    F[:, :n] = F[:, :n] / scale[None, :]
    return F * scale[:, None]


Sampling = Annotated[
    ZeroOrderHold | Tustin | FirstOrderHold | MatchedPoles | ImpulseInvariance,
    "cellsys.ZeroOrderHold(), Tustin(match=...), FirstOrderHold(), MatchedPoles() or "
    "ImpulseInvariance()",
]


@checked
def c2d(sys: LinearSystem, dt: float, method: Sampling = ZeroOrderHold()) -> control.StateSpace:
    """Sample a continuous system; state, input and output names stay.

    Parameters
    ----------
    sys : control.StateSpace, continuous
    dt : float
        Sampling time, s.
    method : ZeroOrderHold, Tustin, FirstOrderHold, MatchedPoles or ImpulseInvariance

    Returns
    -------
    control.StateSpace

    Raises
    ------
    ParameterError
        The system is discrete already, dt is not > 0, the rule meets a pole, the rule
        needs D = 0, or `method` is none of these.
    DataError, DimensionError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Van Loan, IEEE Trans. Automatic Control 23 (1978) 395.
    """
    system = realization(sys).dense()
    if system.is_discrete:
        raise ParameterError(f"the system is discrete already (dt = {system.dt:g} s)")
    dt = real_number(dt, "dt")
    if dt <= 0:
        raise ParameterError(f"dt must be > 0 s, got {dt!r}")
    return method.discrete(system, dt).state_space()


@checked
def d2c(sys: LinearSystem, method: Sampling = ZeroOrderHold()) -> control.StateSpace:
    """The continuous system behind a sampled one; names stay.

    Parameters
    ----------
    sys : control.StateSpace, discrete
    method : ZeroOrderHold or Tustin
        How it was sampled.

    Returns
    -------
    control.StateSpace

    Raises
    ------
    ParameterError
        The system is continuous already; `method` is none of the two; a pole at 0 (none of
        finite order gives it) or on the negative real axis (none of the same order below the
        Nyquist frequency does) under a zero-order hold, or at -1 (Tustin).
    DataError, DimensionError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Higham, Functions of Matrices (2008), section 11 (the principal logarithm).
    """
    system = realization(sys).dense()
    if not system.is_discrete:
        raise ParameterError("the system is continuous already (dt = 0)")
    return method.continuous(system).state_space()
