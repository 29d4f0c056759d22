"""Root locus: closed-loop poles over a gain, or over any parameter such as kappa."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sla
from scipy.optimize import brentq

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem, StateSpaceLike, TransferFunctionLike
from cellsys.drawable import Drawable
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.spectra.eigenvalues import track
from cellsys.spectra.realization import balancing, realization
from cellsys.spectra.zeros import zeros


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class RootLocus(Drawable):
    """Poles over a parameter.

    Attributes
    ----------
    parameter : array (k,)
        Gain or parameter values, rising.
    poles : complex array (k, n)
        Column i is one continuous branch.
    zeros : complex array
        Open-loop zeros, where branches of a gain locus end; empty for a family.
    crossings : array (c,)
        Parameter values at which the pole furthest out crosses the stability boundary.
    dt : float
    """

    _figure: ClassVar[str] = "root_locus"
    parameter: np.ndarray
    poles: np.ndarray
    zeros: np.ndarray
    crossings: np.ndarray
    dt: float

    def __str__(self) -> str:
        at = ", ".join(f"{c:.6g}" for c in self.crossings) or "nowhere"
        return (
            f"root locus of {self.poles.shape[1]} poles over {len(self.parameter)} values "
            f"{self.parameter[0]:.4g} .. {self.parameter[-1]:.4g}; crosses the boundary at {at}"
        )


@checked
def root_locus(
    sys: LinearSystem | Callable[[float], LinearSystem], values: np.ndarray | None = None
) -> RootLocus:
    """Poles of the negative feedback loop 1 + k L over the gain k, or of a family over a parameter.

        A(k) = A - k B (I + k D)^-1 C

    A locus over kappa is the gain locus of the return ratio broken at kappa
    [notes: theory, return ratio], k being
    the factor on kappa; or pass a function ``kappa -> closed-loop system``.

    Parameters
    ----------
    sys : control.StateSpace (square), tuple of arrays, or callable
        Return ratio L; or a function of one float that gives a system (or a matrix A), the poles
        of which are drawn as they are.
    values : array (k,)
        Gains or parameters, rising. Default for L: 0 and 240 values over eight decades around
        the gains that move the poles. Needed for a callable.

    Returns
    -------
    RootLocus

    Raises
    ------
    ParameterError
        values missing for a callable, not rising, or I + k D singular.
    DimensionError
        L is not square; the order of the family changes.
    DataError
        NaN or inf.

    References
    ----------
    Evans, Trans. AIEE 67 (1948) 547.
    """
    # control's systems are callable, too
    if callable(sys) and not isinstance(sys, (StateSpaceLike, TransferFunctionLike)):
        if values is None:
            raise ParameterError("a family of systems needs values=")
        first = realization(sys(float(np.asarray(values, dtype=float).ravel()[0])))
        dt, ends = first.dt, np.zeros(0, complex)

        def matrix(k: float) -> np.ndarray:
            return realization(sys(k)).dense().A
    else:
        system = realization(sys).dense()
        if system.n_inputs != system.n_outputs:
            raise DimensionError(
                f"a root locus needs a square L, got {system.n_outputs} x {system.n_inputs}"
            )
        dt, ends = system.dt, np.asarray(zeros(system))
        identity = np.eye(system.n_inputs)

        def matrix(k: float) -> np.ndarray:
            F = identity + k * system.D
            if F.size and sla.svdvals(F)[-1] < 1e-13 * sla.norm(F):
                raise ParameterError(f"I + k D is singular at k = {k!r}: an algebraic loop")
            if not F.size:
                return system.A
            return system.A - k * system.B @ sla.solve(F, system.C)

        if values is None:
            values = _gains(system.A, system.B, system.C)
    values = np.atleast_1d(np.asarray(values, dtype=float))
    if values.ndim != 1 or not len(values) or not np.all(np.isfinite(values)):
        raise DataError("values must be a finite one-dimensional array, not empty")
    if np.any(np.diff(values) <= 0):
        raise ParameterError("values must rise")
    rows = [_eigenvalues(matrix(float(k))) for k in values]
    if len({len(row) for row in rows}) > 1:
        raise DimensionError("the order of the family changes along values")
    branches = track(np.array(rows).T).T
    margin = np.array([_outermost(row, dt) for row in rows])
    crossings = [
        brentq(
            lambda k: _outermost(_eigenvalues(matrix(k)), dt),
            values[i],
            values[i + 1],
            xtol=1e-300,
            rtol=1e-14,
        )
        for i in np.flatnonzero(margin[:-1] * margin[1:] < 0)
    ] + [
        float(values[i])
        for i in range(1, len(values) - 1)
        if margin[i] == 0 and margin[i - 1] * margin[i + 1] < 0
    ]
    return RootLocus(
        parameter=values, poles=branches, zeros=ends, crossings=np.sort(crossings), dt=dt
    )


def _eigenvalues(A: np.ndarray) -> np.ndarray:
    return sla.eigvals(balancing(A)[0]) if len(A) else np.zeros(0, complex)


def _outermost(values: np.ndarray, dt: float) -> float:
    if not len(values):
        return -1.0
    return float(np.abs(values).max() - 1 if dt > 0 else values.real.max())


def _gains(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> np.ndarray:
    """0, then 240 gains over eight decades around |A| / |B C|."""
    size = float(sla.norm(B) * sla.norm(C)) if B.size and C.size else 0.0
    middle = float(sla.norm(A)) / size if size > 0 and A.size else 1.0
    middle = middle if middle > 0 else 1.0
    return np.concatenate([[0.0], np.geomspace(1e-4 * middle, 1e4 * middle, 240)])
