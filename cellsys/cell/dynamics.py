"""One cell as charges: scheduled contractive blocks, load read-out, centroid, passive port.

    x_q+ = A_q(t) x_q + B_q(t) r(a) e^{i q theta} - gamma_q (I + A_q)/2 C_q^T y_q
    f_q  = C_q (x_q + x_q+)/2                    load density on the matrix
    c+   = c + R_z(t) (x_1 + x_1+)/2 + R_u(t) r(a) e^{i theta} + R_y y_W0

r(a) = [1; a - 1; (a - 1)^2]; x_q are coordinates in which ||A_q||_2 <= 1 at every vertex, so that

    |x+|^2 - |x|^2 <= -2 gamma f.y          (u = 0; every schedule)    [notes: theory, passivity]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.cell.charges import command_features
from cellsys.cell.schedule import Clock
from cellsys.errors import DimensionError

# r(a) = [1; a - 1; (a - 1)^2] = _POWERS [1; a; a^2]
_POWERS = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [1.0, -2.0, 1.0]])


def _columns(q: int, part: int) -> list[int]:
    """Inputs of the real (0) or imaginary (1) part of charge q: plain, times a, times a^2."""
    first = 2 + 6 * (q - 1) + part
    return [first, first + 2, first + 4]


@dataclass(frozen=True, eq=False)
class ChargeBlock:
    """One charge.

    Parameters
    ----------
    A : (H, m, m)
        Step matrices at the vertices.
    B : (H, m, 3)
    gamma : float
        Gain of the port, 1/(pN um/s) in whitened units; 0 is a cascade.
    C : (n_load, m)
        Load read-out of x, pN/um.
    """

    A: np.ndarray
    B: np.ndarray
    gamma: float
    C: np.ndarray

    def __post_init__(self) -> None:
        H, m = self.A.shape[:2] if self.A.ndim == 3 else (-1, -1)
        shapes = (self.A.shape == (H, m, m), self.B.shape[:2] == (H, m), self.C.shape[1:] == (m,))
        if not all(shapes):
            raise DimensionError(
                f"a block must have A (H, m, m), B (H, m, inputs) and C (loads, m), got "
                f"{self.A.shape}, {self.B.shape} and {self.C.shape}"
            )

    @property
    def size(self) -> int:
        """m."""
        return self.A.shape[1]

    def norm(self) -> float:
        """Greatest ||A_h||_2: at most 1 certifies bounded roll-outs of any length."""
        if not self.size:
            return 0.0
        return float(np.linalg.norm(self.A, 2, axis=(1, 2)).max())

    def at(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A and B for the weights w (H,)."""
        return np.tensordot(w, self.A, 1), np.tensordot(w, self.B, 1)


@dataclass(frozen=True, eq=False)
class ReadOut:
    """Centroid increments; see the module's text.

    Parameters
    ----------
    R_z : (H, m_1), R_u : (H, 3)
    R_y : (n_hats,)
        Weights of the matrix velocity under the cell, zero where it is not used.
    """

    R_z: np.ndarray
    R_u: np.ndarray
    R_y: np.ndarray


@dataclass(frozen=True, eq=False)
class CellState:
    """Charges and centroid of one or of K cells (leading axes alike)."""

    x: tuple[np.ndarray, ...]
    place: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class CellDynamics:
    """All charges of a cell, its clock and its read-outs.

    Parameters
    ----------
    blocks : tuple of ChargeBlock
        Charges 0, 1, ...
    clock : Clock
    dt : float
        Step, s.
    alone : ReadOut
        Centroid without a matrix velocity.
    riding : ReadOut
        Centroid that rides on the matrix.
    """

    blocks: tuple[ChargeBlock, ...]
    clock: Clock
    dt: float
    alone: ReadOut
    riding: ReadOut

    def features(self, amplitude: np.ndarray, heading: np.ndarray) -> list[np.ndarray]:
        """r(a) e^{i q theta} of every charge, (..., 3)."""
        return [command_features(amplitude, heading, q) for q in range(len(self.blocks))]

    def advance(
        self, state: CellState, features: list[np.ndarray], w: np.ndarray
    ) -> list[np.ndarray]:
        """x+ of every charge without the port; features (..., 2) of the step."""
        out = []
        for q, block in enumerate(self.blocks):
            A, B = block.at(w)
            out.append(state.x[q] @ A.T + features[q] @ B.T)
        return out

    def moved(
        self,
        before: np.ndarray,
        after: np.ndarray,
        features: np.ndarray,
        w: np.ndarray,
        velocity: np.ndarray | None = None,
    ) -> np.ndarray:
        """Centroid increment (..., 2) um from charge 1 before and after a step.

        `velocity` (..., n_hats) is the gathered matrix velocity W_0; with it the read-out that
        rides on the matrix is used.
        """
        read = self.alone if velocity is None else self.riding
        middle = 0.5 * (before + after)
        step = middle @ (w @ read.R_z) + features @ (w @ read.R_u)
        if velocity is not None:
            step = step + velocity @ read.R_y
        return np.stack([step.real, step.imag], axis=-1)

    def step_matrices(
        self, t: float, *, riding: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Real step matrices at the frozen time t: states, harmonics, offset.

        `riding`: centroids are read out as on a matrix, here one that does not move.

        States: x_0, then Re and Im of each further charge, then the centroid.
        Inputs: see `harmonic_names`: a and a^2, then for q = 1 .. top cos and sin of q theta
        plain, times a, and times a^2.
        """
        w = self.clock.weights(t)
        sizes = [b.size for b in self.blocks]
        top = len(sizes) - 1
        m = sizes[0] + 2 * sum(sizes[1:])
        A, B = np.zeros((m + 2, m + 2)), np.zeros((m + 2, 2 + 6 * top))
        offset, starts = np.zeros(m + 2), self.starts()
        for q, block in enumerate(self.blocks):
            Aw, Bw = block.at(w)
            by_power = Bw @ _POWERS
            i = starts[q]
            if q == 0:
                rows = slice(i, i + block.size)
                A[rows, rows] = Aw
                offset[rows] = by_power[:, 0]
                B[rows, :2] = by_power[:, 1:]
                continue
            for part in range(2):  # real part follows cos, imaginary part sin
                rows = slice(i + part * block.size, i + (part + 1) * block.size)
                A[rows, rows] = Aw
                B[rows, _columns(q, part)] = by_power
        A[m:, m:] = np.eye(2)
        read = self.riding if riding else self.alone
        R_z, R_u = w @ read.R_z, (w @ read.R_u) @ _POWERS
        for part in range(2):
            i = starts[1] + part * sizes[1]
            rows = slice(i, i + sizes[1])
            A[m + part] += 0.5 * (R_z @ A[rows])
            A[m + part, rows] += 0.5 * R_z
            B[m + part] += 0.5 * (R_z @ B[rows])
            B[m + part, _columns(1, part)] += R_u
        return A, B, offset

    def starts(self) -> list[int]:
        """First real state of every charge."""
        sizes = [b.size * (1 if q == 0 else 2) for q, b in enumerate(self.blocks)]
        return [int(s) for s in np.concatenate([[0], np.cumsum(sizes)[:-1]])]

    def split(self, z: np.ndarray) -> CellState:
        """Charges and centroid of real states (..., m + 2)."""
        out = []
        for q, (i, block) in enumerate(zip(self.starts(), self.blocks, strict=True)):
            part = z[..., i : i + block.size]
            if q:
                part = part + 1j * z[..., i + block.size : i + 2 * block.size]
            out.append(part)
        return CellState(tuple(out), z[..., -2:])

    def join(self, state: CellState) -> np.ndarray:
        """Real states (..., m + 2); inverse of `split`."""
        parts = [state.x[0]]
        for x in state.x[1:]:
            parts += [x.real, x.imag]
        return np.concatenate([*parts, state.place], axis=-1)

    def labels(self) -> np.ndarray:
        """Charge of every real state; -1 marks the centroid."""
        each = [np.full(b.size * (1 if q == 0 else 2), q) for q, b in enumerate(self.blocks)]
        return np.concatenate([*each, [-1, -1]])

    def norm(self) -> float:
        """Contraction norm over all charges and vertices."""
        return max(b.norm() for b in self.blocks)

    def passivity_index(self, n: int = 181) -> float:
        """Least eigenvalue of the Hermitian part of y -> -f over its greatest gain.

        Over the unit circle, at every vertex of the schedule and every charge; 0 for a cascade.
        """
        least, gain = 0.0, 0.0
        for block in self.blocks:
            if block.gamma == 0 or not block.size:
                continue
            for A in block.A:
                for angle in np.linspace(0.0, np.pi, n):
                    H = _port_response(A, block, np.exp(1j * angle))
                    least = min(least, float(sla.eigvalsh(0.5 * (H + H.conj().T))[0]))
                    gain = max(gain, float(np.linalg.norm(H, 2)))
        return least / gain if gain > 0 else 0.0


def _port_response(A: np.ndarray, block: ChargeBlock, z: complex) -> np.ndarray:
    """y -> -f of x+ = A x - gamma (I + A)/2 C^T y, f = C (x + x+)/2, at the point z."""
    one = np.eye(len(A))
    drive = block.gamma * 0.5 * (one + A) @ block.C.T
    # Singular where A has an eigenvalue on the circle: shift by rounding.
    x = np.linalg.solve(z * (1.0 + 1e-9) * one - A, drive)
    return 0.5 * block.C @ ((1.0 + z) * x)
