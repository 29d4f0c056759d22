"""Stabilised explicit Runge-Kutta-Chebyshev method of order 2 (RKC).

A step of s stages is stable for h rho < 0.65 s^2, rho the spectral radius of the Jacobian, so
that s evaluations reach s^2 times as far as one of Euler's: for mildly stiff diffusion-like
systems (a matrix of fibres with drag) without any factorisation.
[Sommeijer, Shampine, Verwer, J. Comput. Appl. Math. 88 (1998) 315]
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import ParameterError
from cellsys.integrate.stepping import SampledRun
from cellsys.overdamped import OverdampedSystem
from cellsys.system import OdeSystem

_EPSILON = 2.0 / 13.0  # damping
_RENEW = 25  # steps between two looks at the spectral radius


@checked
@dataclass(frozen=True, kw_only=True)
class RKC:
    """Order 2, explicit, stages chosen from the spectral radius, step from the local error.

    Parameters
    ----------
    rtol, atol : float
        Local error per step is kept below rtol |x| + atol in the mean square.
    largest_step : float
        Bound on the step, s. Systems that change between steps (binding, rupture) need one.
    largest_stages : int
        Most stages of a step; a step that would need more is shortened.
    max_steps : int
        Most steps, rejected ones too, between two samples; then an `IntegrationError`. Where
        the right-hand side jumps (contact that opens and closes) steps fall with the tolerance.

    Notes
    -----
    The spectral radius is found by a power iteration on the right-hand side, with a margin of
    20 %, and again every 25 steps. For eigenvalues far from the negative real axis the method is
    not stable and its steps shrink.
    """

    rtol: float
    atol: float
    largest_step: float = np.inf
    largest_stages: int = 200
    max_steps: int = 100_000

    def __post_init__(self) -> None:
        for name in ("rtol", "atol", "largest_step"):
            value = getattr(self, name)
            if not (value > 0 and (np.isfinite(value) or name == "largest_step")):
                raise ParameterError(f"RKC.{name} must be > 0, got {value!r}")
        if self.largest_stages < 3:
            raise ParameterError(f"RKC.largest_stages must be >= 3, got {self.largest_stages!r}")
        if not self.max_steps >= 1:
            raise ParameterError(f"RKC.max_steps must be >= 1, got {self.max_steps!r}")

    def start(
        self, system: OdeSystem, t0: float, x0: np.ndarray, rng: np.random.Generator
    ) -> SampledRun:
        """A stepper at (t0, x0)."""
        if system.discrete and not np.isfinite(self.largest_step):
            raise ParameterError(
                "this system changes between steps (binding, rupture); give RKC a largest_step"
            )
        return _ChebyshevStepper(self, system, t0, x0, rng)


@lru_cache(maxsize=512)
def coefficients(s: int) -> tuple[np.ndarray, np.ndarray]:
    """(s, 4) rows mu_j, nu_j, mu~_j, gamma~_j and times c_j (s + 1,) of a step of s stages."""
    w0 = 1.0 + _EPSILON / s**2
    T, dT, ddT = np.ones(s + 1), np.zeros(s + 1), np.zeros(s + 1)
    T[1], dT[1] = w0, 1.0
    for j in range(2, s + 1):
        T[j] = 2 * w0 * T[j - 1] - T[j - 2]
        dT[j] = 2 * w0 * dT[j - 1] - dT[j - 2] + 2 * T[j - 1]
        ddT[j] = 2 * w0 * ddT[j - 1] - ddT[j - 2] + 4 * dT[j - 1]
    w1 = dT[s] / ddT[s]
    b = np.empty(s + 1)
    b[2:] = ddT[2:] / dT[2:] ** 2
    b[:2] = b[2]
    a = 1.0 - b * T
    rows = np.zeros((s, 4))
    rows[0, 2] = b[1] * w1
    for j in range(2, s + 1):
        mu_tilde = 2 * b[j] * w1 / b[j - 1]
        rows[j - 1] = 2 * b[j] * w0 / b[j - 1], -b[j] / b[j - 2], mu_tilde, -a[j - 1] * mu_tilde
    c = np.zeros(s + 1)
    c[2:] = w1 * ddT[2:] / dT[2:]
    c[1] = c[2] / dT[2]
    return rows, c


class _ChebyshevStepper(SampledRun):
    def __init__(self, method, system, t0, x0, rng) -> None:
        super().__init__(system, t0, x0, rng, 0.0)
        self.method, self.h = method, 0.0
        self.vector = rng.spawn(1)[0].standard_normal(x0.size)
        self.radius, self.age, self.left = 0.0, _RENEW, method.max_steps
        self.drawn = t0  # up to when the discrete changes have been made
        self.rate: np.ndarray | None = None
        # eta and u at the start of the step under way, and at the last look.
        nothing = np.zeros(system.auxiliaries.size), np.zeros(x0.size)
        self.kept, self.held = nothing, nothing
        self.statistics["largest_stages"] = 0
        if isinstance(system, OverdampedSystem):
            system.forget()

    def memory(self) -> dict[str, np.ndarray]:
        # The next interval looks at everything afresh, here and after a resume.
        self.rate, self.age = None, _RENEW
        return {"step": np.array([self.h]), "vector": self.vector}

    def restore(self, memory: dict[str, np.ndarray]) -> None:
        self.h, self.vector = float(memory["step"][0]), memory["vector"].copy()

    def _f(self, t: float, x: np.ndarray) -> np.ndarray:
        self.statistics["rhs"] += 1
        system = self.system
        if isinstance(system, OverdampedSystem):
            eta, u, rate = system.laws(t, x)
            self.held = eta, u
            return rate
        eta, u = system.eta(t, x), system.u(t, x)
        self.held = eta, u
        return system.W_x @ x + system.W_eta @ eta + u

    def _spectral_radius(self, t: float, x: np.ndarray, f: np.ndarray) -> float:
        """Power iteration on (f(x + d v) - f(x))/d, from the last vector found."""
        size = max(float(np.linalg.norm(x)), 1e-3)
        d, v, old = 1e-7 * size, self.vector, 0.0
        for i in range(50):
            v = v / max(float(np.linalg.norm(v)), 1e-300)
            w = (self._f(t, x + d * v) - f) / d
            new = float(np.linalg.norm(w))
            if new == 0.0 or not np.isfinite(new):
                break
            v = w
            if i >= 2 and abs(new - old) <= 0.01 * new:
                break
            old = new
        self.vector, self.age = v, 0
        return 1.2 * new

    def advance(self, t1: float) -> tuple[np.ndarray, np.ndarray]:
        t0, system = self.t, self.system
        self.left = self.method.max_steps
        eta_sum = np.zeros(system.auxiliaries.size)
        u_sum = np.zeros(system.states.size)
        stops = self.stops[(self.stops > t0) & (self.stops < t1)]
        with np.errstate(over="ignore", invalid="ignore"):
            for stop in [*stops, t1]:
                while self.t < stop:
                    eta, u, h = self._step(float(stop))
                    eta_sum += h * eta
                    u_sum += h * u
                self.rate = None if stop < t1 else self.rate
        return eta_sum / (t1 - t0), u_sum / (t1 - t0)

    def _step(self, stop: float) -> tuple[np.ndarray, np.ndarray, float]:
        """One accepted step towards `stop`: averages of eta and u over it, and its length."""
        method, system, t = self.method, self.system, self.t
        if isinstance(system, OverdampedSystem) and system.discrete:
            if t >= self.drawn:
                self.drawn = min(t + method.largest_step, stop)
                self.x, happened = system.between_steps(t, self.x, self.drawn - t, self.rng)
                # Laws jump even without an event: a thermal force is a new one.
                self.events.extend(happened)
                self.rate, self.age = None, _RENEW if happened else self.age
            # What is drawn holds up to then, in as many steps as the tolerance asks for.
            stop = min(stop, self.drawn)
        x = self.x
        f = self._f(t, x) if self.rate is None else self.rate
        if self.rate is None:
            self.kept = self.held
        if not np.isfinite(f.sum()):
            self.fail(t, self.h, self._reason(f))
        if self.age >= _RENEW:
            self.radius = self._spectral_radius(t, x, f)
        weight = method.rtol * np.abs(x) + method.atol
        h = self.h or self._first(t, x, f, weight)
        while True:
            h = min(h, method.largest_step)
            left = stop - t
            # The last two steps before a stop share what is left.
            length = left if h >= left * (1 - 1e-9) else (0.5 * left if h > 0.5 * left else h)
            s = max(2, 1 + int(np.sqrt(1.0 + 1.54 * length * self.radius)))
            if s > method.largest_stages:
                h = ((method.largest_stages - 1) ** 2 - 1.0) / (1.54 * self.radius)
                continue
            self.left -= 1
            if self.left < 0:
                self.fail(
                    t, length, f"RKC: {method.max_steps} steps since the last sample; the "
                    "right-hand side jumps or is not stiff on the real axis, use LinearlyImplicit"
                )  # fmt: skip
            new = self._stages(t, length, x, f, s)
            # At a stop point the last evaluation takes the limit from the left.
            end = t + length if length < left else float(np.nextafter(stop, t))
            f_new = self._f(end, new)
            local = 0.8 * (x - new) + 0.4 * length * (f + f_new)
            ratio = local / np.maximum(weight, method.rtol * np.abs(new) + method.atol)
            error = float(np.sqrt(np.mean(ratio**2)))
            if np.isfinite(error) and error <= 1.0:
                break
            self.statistics["rejected"] += 1
            h = length * (max(0.1, 0.8 * error ** (-1 / 3)) if np.isfinite(error) else 0.1)
            self.radius = self._spectral_radius(t, x, f)
            if h < 1e-12 * max(abs(t), 1e-3) + 1e-300:
                self.fail(t, h, "RKC: the steps shrink to nothing; use a stiff method")
        grow = min(5.0, 0.8 * max(error, 1e-10) ** (-1 / 3))
        self.h = length * max(grow, 0.1) if length >= 0.99 * h or grow < 1 else h
        self.x, self.t = new, stop if length == left else t + length
        self.rate, self.age = f_new, self.age + 1
        self.statistics["steps"] += 1
        self.statistics["largest_stages"] = max(self.statistics["largest_stages"], s)
        if not np.isfinite(new.sum()):
            self.fail(self.t, length)
        (eta, u), (eta_new, u_new) = self.kept, self.held
        self.kept = self.held
        return 0.5 * (eta + eta_new), 0.5 * (u + u_new), length

    def _reason(self, f: np.ndarray) -> str:
        name = self.system.states.names[int(np.flatnonzero(~np.isfinite(f))[0])]
        return f"RKC: the rate of {name} is not finite"

    def _first(self, t: float, x: np.ndarray, f: np.ndarray, weight: np.ndarray) -> float:
        """A step over which f hardly changes, at most one that two stages can take."""
        h = 1.0 / self.radius if self.radius > 0 else 1.0
        h = min(h, self.method.largest_step)
        change = h * (self._f(t + h, x + h * f) - f) / weight
        size = 0.5 * float(np.sqrt(np.mean(change**2)))
        return h * min(10.0, max(1e-4, 0.5 / np.sqrt(size))) if size > 0 else h

    def _stages(self, t: float, h: float, x: np.ndarray, f: np.ndarray, s: int) -> np.ndarray:
        rows, c = coefficients(s)
        before, now = x, x + (rows[0, 2] * h) * f
        for j in range(2, s + 1):
            mu, nu, mu_tilde, gamma = rows[j - 1]
            rate = self._f(t + c[j - 1] * h, now)
            before, now = (
                now,
                ((1.0 - mu - nu) * x + mu * now + nu * before + h * (mu_tilde * rate + gamma * f)),
            )
        return now
