"""Further rules of sampling: first-order hold, matched poles and zeros, impulse invariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.errors import DimensionError, ParameterError
from cellsys.response.feedback import series
from cellsys.spectra.poles import poles
from cellsys.spectra.realization import Realization
from cellsys.spectra.resolvent import Resolvent
from cellsys.spectra.zeros import zeros

_BACK = "; undo it from the continuous system it was made of"


def _one_way(rule: str) -> ParameterError:
    return ParameterError(f"{rule} has no inverse here{_BACK}, or use ZeroOrderHold() or Tustin()")


@checked
@dataclass(frozen=True)
class FirstOrderHold:
    """Input straight between samples (triangle hold): exact at samples for such inputs.

        x+ = Phi x + (G1 + Phi G2 - G2) u,   y = C x + (D + C G2) u
        [Phi, G1, G2] of exp [[A h, B h, 0], [0, 0, I], [0, 0, 0]]

    References
    ----------
    Franklin, Powell and Workman, Digital Control of Dynamic Systems (1998), section 6.3.2.
    """

    def discrete(self, system: Realization, dt: float) -> Realization:
        """Sample with step dt (s)."""
        n, m = system.n_states, system.n_inputs
        M = np.zeros((n + 2 * m, n + 2 * m))
        M[:n, :n], M[:n, n : n + m] = system.A * dt, system.B * dt
        M[n : n + m, n + m :] = np.eye(m)
        F = sla.expm(M)[:n]
        Phi, G1, G2 = F[:, :n], F[:, n : n + m], F[:, n + m :]
        return replace(
            system, A=Phi, B=G1 + Phi @ G2 - G2, D=system.D + system.C @ G2, dt=dt
        )  # fmt: skip

    def continuous(self, system: Realization) -> Realization:
        """Refused."""
        raise _one_way("the first-order hold")


@checked
@dataclass(frozen=True)
class ImpulseInvariance:
    """Samples of the impulse response, times the step: h C exp(A k h) B.

    References
    ----------
    Oppenheim and Schafer, Discrete-Time Signal Processing (2010), section 7.2.
    """

    def discrete(self, system: Realization, dt: float) -> Realization:
        """Sample with step dt (s); ParameterError where D is not 0."""
        if np.any(system.D):
            raise ParameterError(
                "impulse invariance needs D = 0: the impulse of a feedthrough has no samples; "
                "use FirstOrderHold() or Tustin()"
            )
        F = sla.expm(system.A * dt)
        return replace(
            system, A=F, B=dt * F @ system.B, D=dt * system.C @ system.B, dt=dt
        )  # fmt: skip

    def continuous(self, system: Realization) -> Realization:
        """Refused."""
        raise _one_way("impulse invariance")


@checked
@dataclass(frozen=True)
class MatchedPoles:
    """Poles and zeros moved by z = exp(s h), zeros at infinity to -1 but for one, gain kept at 0.

    One channel. Where 0 is a pole or a zero, what is left without it keeps its gain there.

    References
    ----------
    Franklin, Powell and Workman (1998), section 6.2.3.
    """

    def discrete(self, system: Realization, dt: float) -> Realization:
        """Sample with step dt (s); DimensionError for several channels."""
        if (system.n_inputs, system.n_outputs) != (1, 1):
            raise DimensionError(
                f"matched poles and zeros are for one channel, got {system.n_outputs} x "
                f"{system.n_inputs}; use ZeroOrderHold() or Tustin()"
            )
        given = system.state_space()
        p, z = np.asarray(poles(given)), np.asarray(zeros(given))
        floor = 1e-9 * max(np.abs(np.concatenate([p, z])).max(initial=0.0), 1.0 / dt)
        order = int((np.abs(p) <= floor).sum()) - int((np.abs(z) <= floor).sum())
        at = 1e-6 / dt if order else 0.0
        more = max(len(p) - len(z) - 1, 0)
        mapped = np.concatenate([np.exp(z * dt), np.full(more, -1.0)])
        unscaled = series(_sections(np.exp(p * dt), mapped, dt))
        wanted = Resolvent(system)(np.array([at], complex))[0, 0, 0].real
        found = Resolvent(unscaled)(np.array([np.exp(at * dt)], complex))[0, 0, 0].real
        # s^k against ((z - 1)/h)^k, which it becomes at 0.
        gain = wanted / found * (at * dt / np.expm1(at * dt)) ** order if order else wanted / found
        return replace(
            unscaled, C=gain * unscaled.C, D=gain * unscaled.D, inputs=system.inputs,
            outputs=system.outputs,
        )  # fmt: skip

    def continuous(self, system: Realization) -> Realization:
        """Refused."""
        raise _one_way("matching poles and zeros")


def _pairs(roots: np.ndarray) -> list[np.ndarray]:
    """Real polynomials z^2 + a z + b of pairs, at most one z + a at the end: (2,) or (1,)."""
    real = np.sort(roots[np.abs(roots.imag) == 0].real)[::-1]
    upper = roots[roots.imag > 0]
    out = [np.array([-2 * r.real, abs(r) ** 2]) for r in upper[np.argsort(-np.abs(upper))]]
    both = len(real) // 2 * 2
    out += [np.array([-(a + b), a * b]) for a, b in zip(real[:both:2], real[1:both:2], strict=True)]
    return [*out, *(np.array([-r]) for r in real[both:])]


def _sections(p: np.ndarray, z: np.ndarray, dt: float) -> list[Realization]:
    """First and second order sections in a row, of gain 1 at high frequency where it is."""
    below, above = _pairs(p), _pairs(z)
    out = []
    for k, den in enumerate(below):
        num = above[k] if k < len(above) else np.zeros(0)
        n = len(den)
        A = np.eye(n, k=-1)
        A[0] = -den
        over = np.concatenate([np.zeros(n - len(num)), [1.0], num])
        C = (over[1:] - over[0] * den)[None, :]
        out.append(Realization(A, np.eye(n, 1), C, over[:1, None], dt=dt))
    return out or [Realization(np.zeros((0, 0)), D=np.ones((1, 1)), dt=dt)]
