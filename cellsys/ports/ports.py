"""A cell with a load port: what it pulls with, what matrix velocity does to it, is it passive.

    continuous   z' = A z + b + B u + C y      f = F z
    step of dt   z+ = A z + b + B u + C y      f = F (z + z+)/2       y = E (q+ - q)/dt

f (n_f,) are the loads on the matrix in the port's coordinates, y (n_f,) the matrix velocity in
the same coordinates, so that f.y is the power the matrix gains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.kinds import FILLED, Filled
from cellsys.model import StiffnessSensor
from cellsys.shown import Shown
from cellsys.units import real_array

ACTIVE = -1e-10  # a port below counts as active [notes: theory, passivity]
_RESIDUAL = 1e-10


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class CellPort:
    """A linear cell with a load port.

    Parameters
    ----------
    A : (m, m)
        1/s, or the step matrix when `dt` is given.
    F : (n_f, m)
        Load read-out.
    C : (m, n_f), optional
        What the matrix velocity does to the cell; default none (the cell drives the matrix, a
        cascade).
    B : (m, n_c), optional
    offset : (m,), optional
    metric : (m, m), optional
        P > 0 in which the cell is contractive; default I.
    dt : float, optional
        s; None for continuous time.
    input_names : tuple of str, optional
    sensor : StiffnessSensor, optional
    z_start : (m,), optional

    Raises
    ------
    DimensionError, DataError, ParameterError
        Sizes that do not fit, NaN, a metric that is not positive definite.
    """

    A: np.ndarray
    F: np.ndarray
    C: Filled[np.ndarray] = FILLED
    B: Filled[np.ndarray] = FILLED
    offset: Filled[np.ndarray] = FILLED
    metric: Filled[np.ndarray] = FILLED
    dt: float | None = None
    input_names: Filled[tuple[str, ...]] = FILLED
    sensor: StiffnessSensor | None = None
    z_start: np.ndarray | None = None

    def __post_init__(self) -> None:
        A, F = (np.atleast_2d(real_array(getattr(self, k), k).copy()) for k in "AF")
        m, n = len(A), len(F)
        values = {
            "A": (A, (m, m)),
            "F": (F, (n, m)),
            "C": (np.zeros((m, n)) if self.C is None else real_array(self.C, "C").copy(), (m, n)),
            "offset": (
                np.zeros(m) if self.offset is None else real_array(self.offset, "offset").copy(),
                (m,),
            ),
            "metric": (
                np.eye(m) if self.metric is None else real_array(self.metric, "metric").copy(),
                (m, m),
            ),
        }
        B = np.zeros((m, 0)) if self.B is None else np.atleast_1d(real_array(self.B, "B").copy())
        values["B"] = (B, (m, B.shape[-1]))
        if self.z_start is not None:
            values["z_start"] = (real_array(self.z_start, "z_start").copy(), (m,))
        for name, (value, shape) in values.items():
            if value.shape != shape:
                raise DimensionError(f"{name} must have shape {shape}, got {value.shape}")
            if not np.all(np.isfinite(value)):
                raise DataError(f"{name} holds NaN or inf")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        P: np.ndarray = self.metric
        if np.abs(P - P.T).max() > 1e-12 * np.abs(P).max() or sla.eigvalsh(P)[0] <= 0:
            raise ParameterError("metric must be symmetric and positive definite")
        if self.dt is not None and not (np.isfinite(self.dt) and self.dt > 0):
            raise ParameterError(f"dt must be > 0 s, or None, got {self.dt!r}")
        names = self.input_names
        names = tuple(f"c[{i}]" for i in range(B.shape[1])) if names is None else tuple(names)
        if len(names) != B.shape[1]:
            raise DimensionError(f"{len(names)} input names for {B.shape[1]} inputs")
        object.__setattr__(self, "input_names", names)

    @classmethod
    def collocated(
        cls,
        A: np.ndarray,
        F: np.ndarray,
        *,
        gamma: float,
        metric: np.ndarray | None = None,
        B: np.ndarray | None = None,
        offset: np.ndarray | None = None,
        dt: float | None = None,
    ) -> CellPort:
        """The passive port: C = -gamma P^-1 F^T, or -gamma (I + A)/2 P^-1 F^T for a step of dt.

        Passive at once when gamma >= 0 and the cell is contractive in P: the storage
        |z|_P^2 / (2 gamma) grows by no more than -f.y (per step by dt times that).
        """
        if not (np.isfinite(gamma) and gamma >= 0):
            raise ParameterError(f"gamma must be finite and >= 0, got {gamma!r}")
        A, F = np.atleast_2d(np.asarray(A, float)), np.atleast_2d(np.asarray(F, float))
        P = np.eye(len(A)) if metric is None else np.asarray(metric, float)
        C = -gamma * sla.solve(P, F.T, assume_a="pos")
        if dt is not None:
            C = 0.5 * (C + A @ C)
        return cls(
            A=A,
            F=F,
            C=C,
            B=FILLED if B is None else B,
            offset=FILLED if offset is None else offset,
            metric=P,
            dt=dt,
        )

    @property
    def order(self) -> int:
        """m."""
        return len(self.A)

    @property
    def n_loads(self) -> int:
        """n_f."""
        return len(self.F)

    def response(self, omega: float) -> np.ndarray:
        """-f from y at omega, rad/s: its Hermitian part is >= 0 for a passive port."""
        m = self.order
        if self.dt is None:
            # Singular where A has a pole on the axis: shifted by rounding.
            s = 1j * omega + 1e-14 * (1.0 + sla.norm(self.A))
            return -self.F @ sla.solve(s * np.eye(m) - self.A, self.C.astype(complex))
        z = np.exp(1j * omega * self.dt) * (1.0 + 1e-12)
        half = 0.5 * (1.0 + z)
        return -half * self.F @ sla.solve(z * np.eye(m) - self.A, self.C.astype(complex))

    def frequencies(self, n: int = 400) -> np.ndarray:
        """Where `passivity` looks: a grid over all time constants, denser about every pole."""
        values = sla.eigvals(self.A)
        if self.dt is not None:
            with np.errstate(divide="ignore"):
                values = np.log(values.astype(complex)) / self.dt
            values = values[np.isfinite(values)]
        size = np.abs(values[np.abs(values) > 0])
        low, high = (size.min(), size.max()) if size.size else (1e-3, 1.0)
        grid = np.geomspace(1e-3 * low, 1e3 * high, n)
        near = np.abs(values.imag)[:, None] + np.abs(values.real)[:, None] * np.array(
            [-2.0, -1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0, 2.0]
        )
        grid = np.concatenate([[0.0], grid, near.ravel()])
        grid = grid[grid >= 0]
        if self.dt is not None:
            # Up to a shade below the Nyquist frequency, where the port has no gain.
            edge = np.pi / self.dt
            grid = np.concatenate([grid[grid < edge], np.linspace(0, edge, n)[1:-1]])
        return np.unique(grid)

    def passivity(self) -> PortPassivity:
        """Index over frequency, and the algebraic certificate in the given metric."""
        if not np.any(self.C):
            index, worst = 0.0, 0.0
        else:
            index, worst = self._index()
        contraction = self._contraction(np.arange(self.order))
        takes = np.abs(self.C).max(axis=1, initial=0.0) > 0
        gamma, residual, upstream = 0.0, 0.0, 0.0
        if takes.any():
            on, off = np.flatnonzero(takes), np.flatnonzero(~takes)
            # States without velocity input drive the others and must not be driven by them.
            upstream = float(np.abs(self.A[np.ix_(off, on)]).max(initial=0.0))
            P = self.metric[np.ix_(on, on)]
            want = -sla.solve(P, self.F[:, on].T, assume_a="pos")
            if self.dt is not None:
                want = 0.5 * (want + self.A[np.ix_(on, on)] @ want)
            have = self.C[on]
            gamma = float(np.sum(have * want) / max(np.sum(want * want), 1e-300))
            residual = float(sla.norm(have - gamma * want) / sla.norm(have))
        size = max(1.0, float(sla.norm(self.A, 2)))
        certified = (
            contraction <= 1e-12 * self.order * size
            and residual <= _RESIDUAL
            and upstream <= 1e-14 * size
            and gamma >= 0
        )
        return PortPassivity(
            index=index,
            frequency=worst,
            contraction=contraction,
            gamma=gamma,
            residual=residual,
            certified=certified,
        )

    def _contraction(self, on: np.ndarray) -> float:
        """Largest growth in the metric: eigenvalue of (A^T P + P A)/2, or |A|_P^2 - 1."""
        L = sla.cholesky(self.metric[np.ix_(on, on)], lower=True)
        A = self.A[np.ix_(on, on)]
        # In coordinates L^T z the metric is the identity.
        M = sla.solve_triangular(L, (L.T @ A).T, lower=True).T
        if self.dt is None:
            return float(sla.eigvalsh(0.5 * (M + M.T))[-1])
        return float(sla.norm(M, 2) ** 2 - 1.0)

    def _index(self) -> tuple[float, float]:
        grid = self.frequencies()
        least, gain = np.empty(len(grid)), np.empty(len(grid))
        # H acts within the span of F and C^T, of at most 2 m directions however many loads.
        Q, R, _ = sla.qr(np.hstack([self.F, self.C.T]), mode="economic", pivoting=True)
        size = np.abs(np.diag(R))
        Q = Q[:, size > 1e-14 * size.max()]
        small = replace(self, F=Q.T @ self.F, C=self.C @ Q)
        beyond = 0.0 if Q.shape[1] < self.n_loads else np.inf
        for i, omega in enumerate(grid):
            H = small.response(float(omega))
            least[i] = min(sla.eigvalsh(0.5 * (H + H.conj().T))[0], beyond)
            gain[i] = sla.norm(H, 2)
        i = int(np.argmin(least))
        return float(least[i] / gain.max()) if gain.max() > 0 else 0.0, float(grid[i])


@checked
@dataclass(frozen=True, kw_only=True)
class PortPassivity(Shown):
    """Passivity of a cell's port.

    Attributes
    ----------
    index : float
        Least eigenvalue of the Hermitian part of y -> -f over its greatest gain, on a grid of
        frequencies; below -1e-10 the port is active.
    frequency : float
        Where it is least, rad/s.
    contraction : float
        Growth of the free cell in its metric, at most 0: eigenvalue of the symmetric part, 1/s,
        or |A|_P^2 - 1 of a step.
    gamma : float
        Gain of the collocated port nearest to C.
    residual : float
        |C - C_collocated| / |C|.
    certified : bool
        Contractive and collocated with gamma >= 0: passive for certain, not only on the grid.
    """

    index: float
    frequency: float
    contraction: float
    gamma: float
    residual: float
    certified: bool

    @property
    def active(self) -> bool:
        """Index below -1e-10."""
        return self.index < ACTIVE

    def __str__(self) -> str:
        kind = "certified" if self.certified else ("active" if self.active else "not certified")
        return (
            f"port {kind}: index {self.index:.2g} (at {self.frequency:.3g} rad/s), contraction "
            f"{self.contraction:.2g}, gamma {self.gamma:.3g}, collocation residual "
            f"{self.residual:.1e}"
        )
