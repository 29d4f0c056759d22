"""Systems that are linear except for a few slow states: what `Exponential` takes apart.

    z' = A z + B c(y) + b        y' = r(y, S z + s)

A latent model under a polarity law has this form: z is long and linear, y is the polarity, three
numbers a cell. What y needs of the past of z is the kernel S e^{A r} B of n_o x n_c numbers, so
an integrator can work on y alone and find z afterwards, for all samples at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla

from cellsys.errors import DataError, DimensionError

NODES = 24  # Chebyshev nodes on each dyadic piece of the kernel
_LOG_FACTORIAL = float(np.sum(np.log(np.arange(1, NODES + 1))))
_LOG_CLOSED = float(np.log(1e-13))  # share of the kernel that may be lost by interpolating it


@dataclass(frozen=True, eq=False, kw_only=True)
class Semilinear:
    """z' = A z + B c(y) + b, y' = r(y, S z + s), for `cells` cells with the same matrices.

    Parameters
    ----------
    A, B, b : (m, m), (m, n_c), (m,)
        Linear part, 1/s.
    S, s : (n_o, m), (n_o,)
        What the slow states see of z.
    commands : callable
        ``commands(y)``: (..., n_y) -> (..., n_c).
    rate : callable
        ``rate(y, o)``: (..., n_y), (..., n_o) -> (..., n_y), 1/s.
    fast, slow : int arrays (cells, m), (cells, n_y)
        Where each cell's z and y stand in the state.

    Raises
    ------
    DimensionError, DataError
        When shapes do not fit or A, B, b, S, s hold NaN or inf.
    """

    A: np.ndarray
    B: np.ndarray
    b: np.ndarray
    S: np.ndarray
    s: np.ndarray
    commands: Callable[[np.ndarray], np.ndarray]
    rate: Callable[[np.ndarray, np.ndarray], np.ndarray]
    fast: np.ndarray
    slow: np.ndarray

    def __post_init__(self) -> None:
        m = len(self.A)
        shapes = {"A": (m, m), "B": (m, self.B.shape[-1]), "b": (m,), "S": (len(self.s), m)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if np.shape(value) != shape:
                raise DimensionError(f"{name} must have shape {shape}, got {np.shape(value)}")
            if not np.all(np.isfinite(value)):
                raise DataError(f"{name} holds NaN or inf")
        if self.fast.shape != (len(self.slow), m):
            raise DimensionError(
                f"fast must have shape ({len(self.slow)}, {m}), got {self.fast.shape}"
            )

    @cached_property
    def modal(self) -> ModalFlow:
        """Coordinates in which A is diagonal; `ModalFlow.loss` says what they cost in digits."""
        return ModalFlow(self)

    @cached_property
    def dense(self) -> DenseFlow:
        """Coordinates z themselves: for an A whose eigenvectors are too close to each other."""
        return DenseFlow(self)

    @cached_property
    def tables(self) -> dict:
        """Tables of windows, by kind of coordinates, nodes and length; a cache."""
        return {}

    def slopes(self, y: np.ndarray, o: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """dc/dy (..., n_c, n_y), dr/dy (..., n_y, n_y), dr/do (..., n_y, n_o) by differences.

        They steer an iteration; its solution does not depend on them.
        """
        step = 1e-6
        dy = step * np.eye(y.shape[-1])[(slice(None), *[None] * (y.ndim - 1))]
        do = step * np.eye(o.shape[-1])[(slice(None), *[None] * (o.ndim - 1))]
        c, r = self.commands(y), self.rate(y, o)
        parts = (
            (self.commands(y + dy) - c) / step,
            (self.rate(y + dy, o) - r) / step,
            (self.rate(y, o + do) - r) / step,
        )
        return tuple(np.moveaxis(part, 0, -1) for part in parts)

    @cached_property
    def inputs(self) -> np.ndarray:
        """[B, b] (m, n_c + 1): the offset is a command that is always 1."""
        return np.column_stack([self.B, self.b])


def phi(z: np.ndarray, count: int) -> np.ndarray:
    """phi_0 .. phi_count of z, shape (count + 1, *z.shape): phi_k+1 = (phi_k - 1/k!)/z.

    Upward recurrence for |z| >= 1; below, the Taylor series of the highest one and downward.
    """
    z = np.asarray(z)
    small = np.abs(z) < 1.0 + 0.5 * count
    out = np.empty((count + 1, *z.shape), dtype=np.result_type(z, float))
    safe = np.where(small, 1.0, z)
    out[0] = np.exp(z)
    factorial = 1.0
    for k in range(count):
        out[k + 1] = (out[k] - 1.0 / factorial) / safe
        factorial *= k + 1
    if np.any(small):
        w = np.where(small, z, 0.0)
        term = np.full(z.shape, 1.0 / factorial, dtype=out.dtype)
        total = term.copy()
        for j in range(1, 40):
            term = term * w / (count + j)
            total = total + term
        for k in range(count, 0, -1):
            out[k] = np.where(small, total, out[k])
            factorial /= k
            total = total * w + 1.0 / factorial
    return out


def interval_weights(nodes: np.ndarray) -> np.ndarray:
    """(q, q) matrix: Lagrange polynomial j on `nodes` in [0, 1] as sum_k M[j, k] x^k / k!."""
    q = len(nodes)
    V = np.vander(nodes, q, increasing=True) / np.cumprod([1.0, *range(1, q)])
    return sla.solve(V, np.eye(q)).T


class Flow(ABC):
    """What both forms of exp(A t) share: how finely the kernel must be sampled."""

    rates: np.ndarray
    size: int

    def levels(self, h: float) -> int | None:
        """Dyadic pieces [h/2, h], [h/4, h/2], .. that resolve e^{A r} on [0, h]; None: too long.

        Interpolation at n Chebyshev nodes loses (w/2)^n/n! of e^{lambda r} on a piece of half
        length w/|lambda|, and the exponential itself has decayed by the start of the piece.
        """
        for levels in range(30):
            far = h * 0.5 ** np.arange(levels + 1)
            near = np.append(0.5 * far[:-1], 0.0)
            half = np.multiply.outer(0.5 * (far - near), np.abs(self.rates))
            log = NODES * np.log(np.maximum(0.5 * half, 1e-300)) - _LOG_FACTORIAL
            lost = (log + np.multiply.outer(near, self.rates.real)).max(axis=1, initial=-np.inf)
            if lost.max() < _LOG_CLOSED:
                return levels
            if lost[:-1].max(initial=-np.inf) >= _LOG_CLOSED:
                return None
        return None

    @abstractmethod
    def start(self, z: np.ndarray) -> np.ndarray:
        """w (..., M), what the flow acts on, of z (..., m)."""

    @abstractmethod
    def read(self, w: np.ndarray) -> np.ndarray:
        """z (..., m) of w (..., M)."""

    @abstractmethod
    def exponential(self, t: float) -> np.ndarray:
        """e^{A t} as `apply` wants it."""

    @abstractmethod
    def apply(self, E: np.ndarray, w: np.ndarray) -> np.ndarray:
        """e^{A t} w."""

    @abstractmethod
    def interval(self, step: np.ndarray | float, nodes: np.ndarray) -> np.ndarray:
        """Weights of commands at `nodes` in their effect after `step` seconds."""

    @abstractmethod
    def response(self, weights: np.ndarray, C: np.ndarray) -> np.ndarray:
        """Effect (T, M) of commands C (T, q, n_c) by `interval` weights."""


class ModalFlow(Flow):
    """exp(A t) in the eigenvector coordinates of A; one of each conjugate pair is kept.

    z = Re(V w), w' = lambda w + V^-1 (B c + b).
    """

    def __init__(self, system: Semilinear) -> None:
        values, vectors = (part.astype(complex) for part in sla.eig(system.A))
        keep = values.imag >= 0
        weight = np.where(values.imag[keep] > 0, 2.0, 1.0)
        self.rates = values[keep]
        self.loss = np.inf
        sizes = sla.svdvals(vectors) if len(values) else np.ones(1)
        if not sizes[-1] > 1e-13 * sizes[0]:
            return
        inverse = sla.solve(vectors, np.eye(len(values)))
        # Digits lost in going to the coordinates and back.
        self.loss = float(sizes[0] / sizes[-1]) * np.finfo(float).eps
        self._to = inverse[keep]
        self.V = vectors[:, keep] * weight
        self.B = self._to @ system.inputs
        self.size = len(self.rates)
        self.S = system.S @ self.V
        self._back = _interleave(self.V).T

    def start(self, z: np.ndarray) -> np.ndarray:
        """w (..., M) of z (..., m)."""
        return z @ self._to.T

    def read(self, w: np.ndarray) -> np.ndarray:
        """z (..., m) of w (..., M)."""
        return np.ascontiguousarray(w).view(float) @ self._back

    def observer(self, times: np.ndarray) -> np.ndarray:
        """(times * n_o, 2 M): S e^{A t} on w seen as real numbers."""
        table = self.S[None] * np.exp(np.multiply.outer(times, self.rates))[:, None]
        return _interleave(table.reshape(-1, self.size))

    def exponential(self, t: float) -> np.ndarray:
        """e^{A t} as `apply` wants it."""
        return np.exp(self.rates * t)

    @staticmethod
    def apply(E: np.ndarray, w: np.ndarray) -> np.ndarray:
        """e^{A t} w."""
        return w * E

    def kernel(self, times: np.ndarray) -> np.ndarray:
        """e^{A r} [B, b] at the times r: (times, M, n_c)."""
        return np.exp(np.multiply.outer(times, self.rates))[:, :, None] * self.B

    def seen(self, kernel: np.ndarray) -> np.ndarray:
        """S e^{A r} [B, b] (times, n_o, n_c)."""
        return np.matmul(self.S.real, kernel.real) - np.matmul(self.S.imag, kernel.imag)

    def interval(self, step: np.ndarray | float, nodes: np.ndarray) -> np.ndarray:
        """Weights (..., q, M) of commands at `nodes` in their effect after `step` seconds."""
        z = np.multiply.outer(step, self.rates)
        parts = np.moveaxis(phi(z, len(nodes))[1:], 0, -2)
        return np.expand_dims(np.asarray(step), (-1, -2)) * (interval_weights(nodes) @ parts)

    def response(self, weights: np.ndarray, C: np.ndarray) -> np.ndarray:
        """Effect (T, M) of commands C (T, q, n_c) by `interval` weights (q, M)."""
        matrix = np.einsum("qm,mc->qcm", weights, self.B)
        flat = C.reshape(len(C), -1)
        return (flat @ matrix.reshape(flat.shape[1], -1).view(float)).view(complex)


class DenseFlow(Flow):
    """exp(A t) by scaling and squaring; slower, but any A will do."""

    def __init__(self, system: Semilinear) -> None:
        self.A, self.B, self.S = system.A, system.inputs, system.S
        self.size = len(self.A)
        self.loss = 100 * np.finfo(float).eps
        self.rates = sla.eigvals(self.A)

    def start(self, z: np.ndarray) -> np.ndarray:
        """z itself."""
        return np.array(z, dtype=float)

    def read(self, w: np.ndarray) -> np.ndarray:
        """z itself."""
        return w

    def observer(self, times: np.ndarray) -> np.ndarray:
        """(times * n_o, m): S e^{A t}."""
        return np.concatenate([self.S @ self.exponential(t) for t in times])

    def exponential(self, t: float) -> np.ndarray:
        """e^{A t} (m, m)."""
        return sla.expm(self.A * t)

    @staticmethod
    def apply(E: np.ndarray, w: np.ndarray) -> np.ndarray:
        """e^{A t} w for w (..., m)."""
        return w @ E.T

    def kernel(self, times: np.ndarray) -> np.ndarray:
        """e^{A r} [B, b] at the times r: (times, m, n_c)."""
        return np.stack([self.exponential(t) @ self.B for t in times])

    def seen(self, kernel: np.ndarray) -> np.ndarray:
        """S e^{A r} [B, b] (times, n_o, n_c)."""
        return np.matmul(self.S, kernel)

    def interval(self, step: np.ndarray | float, nodes: np.ndarray) -> np.ndarray:
        """Weights (..., m, q n_c) of commands at `nodes` in their effect after `step` seconds."""
        steps, q, (m, n_c) = np.asarray(step), len(nodes), self.B.shape
        lagrange = interval_weights(nodes)
        out = np.zeros((*steps.shape, m, q * n_c))
        for index, t in np.ndenumerate(steps):
            # exp of [[A t, B t, 0..], [0, 0, I, ..], ..] has t phi_k(A t) B in its first row.
            big = np.zeros((m + q * n_c, m + q * n_c))
            big[:m, :m], big[:m, m : m + n_c] = self.A * t, self.B * t
            big[m : m + (q - 1) * n_c, m + n_c :] = np.eye((q - 1) * n_c)
            row = sla.expm(big)[:m, m:].reshape(m, q, n_c)
            out[index] = np.einsum("jk,mkc->mjc", lagrange, row).reshape(m, -1)
        return out

    @staticmethod
    def response(weights: np.ndarray, C: np.ndarray) -> np.ndarray:
        """Effect (T, m) of commands C (T, q, n_c) by `interval` weights."""
        return C.reshape(len(C), -1) @ weights.T


def _interleave(matrix: np.ndarray) -> np.ndarray:
    """Real (a, 2 b) matrix whose product with a complex vector seen as reals is Re(matrix w)."""
    out = np.empty((matrix.shape[0], 2 * matrix.shape[1]))
    out[:, 0::2], out[:, 1::2] = matrix.real, -matrix.imag
    return out
