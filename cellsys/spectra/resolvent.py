"""G(s) = C (s I - A)^-1 B + D at many points s, with its accuracy, by the fitting route.

Few channels: one controller-Hessenberg form per input (or per output of the transposed system).
Many channels: one Schur form. Few points of a small A: one LU each, all in one call. Sparse A:
one sparse LU per point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from cellsys.errors import DataError
from cellsys.spectra import hessenberg, triangular
from cellsys.spectra.realization import EPS, Realization, balance

# One Schur form costs about as much as eight Hessenberg forms.
_CHANNELS = 8
_CHUNK = 500  # points at a time: measured best for n = 50..1000, rows of 16 kB
_BYTES = 64_000_000  # of state columns held at a time
# G (p, m, k), norms of the state columns (m, k) and of the rows (p, k); these (0, 0) unasked for
Answer = tuple[np.ndarray, np.ndarray, np.ndarray]
_UNASKED = np.zeros((0, 0))
_SMALL, _FEW = 30, 20  # states and points: below, preparing costs more than solving


def s_plane(omega: np.ndarray, dt: float) -> np.ndarray:
    """j omega in continuous time, exp(j omega dt) in discrete time."""
    return np.exp(1j * omega * dt) if dt > 0 else 1j * omega


@dataclass(eq=False)
class Resolvent:
    """Prepared once, evaluated at any number of points.

    Parameters
    ----------
    system : Realization
    """

    system: Realization
    _columns: list[hessenberg.ControllerHessenberg] | None = field(default=None, init=False)
    _rows: list[hessenberg.ControllerHessenberg] | None = field(default=None, init=False)
    _form: triangular.TriangularForm | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if self.system.is_sparse:
            self.norm = float(spla.norm(self.system.A)) if self.system.n_states else 0.0
            self._rows_norm = np.linalg.norm(self.system.C, axis=1)
            self._columns_norm = np.linalg.norm(self.system.B, axis=0)
            self._scale = np.ones(self.system.D.shape)
            return
        self._b = balance(self.system)
        self._rows_norm = np.linalg.norm(self._b.C, axis=1)
        self._columns_norm = np.linalg.norm(self._b.B, axis=0)
        self.norm = float(np.linalg.norm(self._b.A))
        self._scale = self._b.left[:, None] * self._b.right[None, :]
        if self.system.n_inputs + self.system.n_outputs > _CHANNELS:
            self._form = triangular.triangular_form(self._b.A, self._b.B, self._b.C)

    @property
    def backward(self) -> float:
        """Relative size of the backward error counted on: (10 + sqrt n) eps.

        LAPACK's bound for the orthogonal reduction is a modest multiple of n eps; what is seen
        grows like sqrt n or slower (Higham 2002, section 19).
        """
        return (10.0 + np.sqrt(self.system.n_states)) * EPS

    def __call__(self, s: np.ndarray) -> np.ndarray:
        """G at the points s (k,), shape (p, m, k); not finite at a pole."""
        return self._evaluate(s, False)[0]

    def with_accuracy(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """G (p, m, k) and a bound of the absolute error of each entry (p, m, k).

        |dG_ij| <= backward ((|A|_F + |s|) |c_i R| |R b_j| + |c_i| |R b_j| + |c_i R| |b_j|)
                   + eps (|D_ij| + 4 |G_ij|),     R = (s I - A)^-1
        """
        return self._evaluate(s, True)

    def at(self, s: complex) -> np.ndarray:
        """G at one point, (p, m)."""
        return self(np.array([s], dtype=complex))[:, :, 0]

    def _evaluate(self, s: np.ndarray, accuracy: bool) -> tuple[np.ndarray, np.ndarray]:
        s = np.asarray(s, dtype=complex)
        p, m, n = self.system.n_outputs, self.system.n_inputs, self.system.n_states
        G = np.empty((p, m, len(s)), complex)
        bound = np.empty((p, m, len(s))) if accuracy else _UNASKED
        if min(p, m) == 0:
            return G, bound
        channels = max(p, m) if self._form is not None else 1
        step = max(16, min(_CHUNK, _BYTES // (16 * max(n, 1) * channels)))
        for lo in range(0, len(s), step):
            part = slice(lo, lo + step)
            route = self._route(len(s))
            G[:, :, part], right, left = route(s[part], accuracy)
            if accuracy:
                with np.errstate(invalid="ignore", over="ignore"):
                    size = (self.norm + np.abs(s[part])) * left[:, None] * right[None]
                    size += self._rows_norm[:, None, None] * right[None]
                    size += left[:, None] * self._columns_norm[None, :, None]
                    bound[:, :, part] = self.backward * size / self._scale[:, :, None]
        D = self.system.D[:, :, None]
        if accuracy:
            # A product inf * 0 (a pole nobody sees) says nothing: no bound.
            bound = np.where(np.isnan(bound), np.inf, bound)
            bound += EPS * (np.abs(D) + 4 * np.abs(G))
        with np.errstate(invalid="ignore"):
            return G + D, bound

    def _route(self, points: int) -> Callable[[np.ndarray, bool], Answer]:
        if self.system.is_sparse:
            return self._sparse
        return self._direct if self.system.n_states <= _SMALL and points <= _FEW else self._dense

    def _direct(self, s: np.ndarray, accuracy: bool) -> Answer:
        b = self._b
        M = s[:, None, None] * np.eye(len(b.A)) - b.A
        try:
            X = np.linalg.solve(M, b.B[None].astype(complex))
            back = np.swapaxes(M, 1, 2)
            Y = np.linalg.solve(back, b.C.T[None].astype(complex)) if accuracy else X
        except np.linalg.LinAlgError:  # one of the points is a pole
            return self._dense(s, accuracy)
        G = np.moveaxis(b.C @ X, 0, -1) / self._scale[:, :, None]
        if not accuracy:
            return G, _UNASKED, _UNASKED
        return G, np.linalg.norm(X, axis=1).T, np.linalg.norm(Y, axis=1).T

    def _dense(self, s: np.ndarray, accuracy: bool) -> Answer:
        b, scale = self._b, self._scale[:, :, None]
        right = left = _UNASKED
        if self._form is not None:
            G, right, left = triangular.response(self._form, s)
            return _divide(G, scale), right, left
        p, m = scale.shape[:2]
        by_columns = m <= p
        G = np.empty((p, m, len(s)), complex)
        if by_columns or accuracy:
            if self._columns is None:
                self._columns = [hessenberg.controller_hessenberg(b.A, c, b.C) for c in b.B.T]
            parts = [hessenberg.response(form, s) for form in self._columns]
            right = np.array([size for _, size in parts])
            if by_columns:
                G = np.stack([g for g, _ in parts], axis=1)
        if not by_columns or accuracy:
            if self._rows is None:
                A_t = np.ascontiguousarray(b.A.T)
                self._rows = [
                    hessenberg.controller_hessenberg(A_t, c, np.ascontiguousarray(b.B.T))
                    for c in b.C
                ]
            parts = [hessenberg.response(form, s) for form in self._rows]
            left = np.array([size for _, size in parts])
            if not by_columns:
                G = np.stack([g for g, _ in parts], axis=0)
        return _divide(G, scale), right, left

    def _sparse(self, s: np.ndarray, accuracy: bool) -> Answer:
        system = self.system
        n, p, m = system.n_states, system.n_outputs, system.n_inputs
        G = np.empty((p, m, len(s)), complex)
        right, left = np.zeros((m, len(s))), np.zeros((p, len(s)))
        identity = sp.identity(n, dtype=complex, format="csc")
        for i, value in enumerate(s):
            try:
                lu = spla.splu(sp.csc_matrix(value * identity - system.A))
            except RuntimeError as error:
                if "singular" not in str(error):
                    raise DataError(f"sparse factorisation at s = {value:.6g}: {error}") from error
                G[:, :, i], right[:, i], left[:, i] = np.inf, np.inf, np.inf
                continue
            X = lu.solve(system.B.astype(complex))
            G[:, :, i] = system.C @ X
            if accuracy:
                right[:, i] = np.linalg.norm(X, axis=0)
                solve: Callable[..., np.ndarray] = lu.solve  # scipy's stubs know no `trans`
                left[:, i] = np.linalg.norm(solve(system.C.T.astype(complex), trans="T"), axis=0)
        return G, right, left


def _divide(G: np.ndarray, scale: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):  # inf at a pole
        return G / scale
