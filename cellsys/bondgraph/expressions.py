"""What the laws of a graph compute with: numbers, arrays, or CasADi expressions in their place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, overload

import numpy as np
import scipy.sparse as sp

if TYPE_CHECKING:
    import casadi as ca


class Symbol(Protocol):
    """A CasADi expression, SX or MX; CasADi itself is not imported."""

    def __add__(self, other: Any, /) -> Symbol: ...

    def __radd__(self, other: Any, /) -> Symbol: ...

    def __mul__(self, other: Any, /) -> Symbol: ...

    def __rmul__(self, other: Any, /) -> Symbol: ...

    def __truediv__(self, other: Any, /) -> Symbol: ...

    def __rtruediv__(self, other: Any, /) -> Symbol: ...

    def __rmatmul__(self, other: Any, /) -> Symbol: ...

    def __getitem__(self, place: Any, /) -> Symbol: ...

    def __setitem__(self, place: Any, value: Any, /) -> None: ...


Vector = np.ndarray | Symbol
Numbers = float | np.ndarray
Expression = float | np.ndarray | Symbol
Matrix = np.ndarray | sp.csr_array
States = Mapping[str, Expression]


def numbers(value: Expression) -> np.ndarray:
    """What a law gives for numbers, as an array."""
    return np.asarray(value, dtype=float)


def apply(matrix: Matrix, vector: Vector) -> Vector:
    """Matrix times a numpy vector or a CasADi one."""
    if isinstance(vector, np.ndarray):
        return matrix @ vector
    import casadi as ca

    return ca.DM(sp.csc_matrix(matrix)) @ vector


@overload
def shaped(vector: np.ndarray, shape: tuple[int, ...]) -> Numbers:
    """Of numbers."""


@overload
def shaped(vector: Vector, shape: tuple[int, ...]) -> Expression:
    """Of either."""


def shaped(vector: Vector, shape: tuple[int, ...]) -> Expression:
    """A piece of a vector as a law sees it: a number, or an array of `shape` (numpy only)."""
    if isinstance(vector, np.ndarray):
        return vector.reshape(shape) if shape else vector[0]
    return vector


def column(values: list[Expression]) -> Symbol:
    """Symbols and numbers below each other."""
    import casadi as ca

    if any(isinstance(v, ca.MX) for v in values):
        return ca.vcat([v if isinstance(v, ca.MX) else ca.MX(_dm(v)) for v in values])
    return ca.vcat([v if isinstance(v, ca.SX) else ca.SX(_dm(v)) for v in values])


def _dm(value: Expression) -> ca.DM:
    import casadi as ca

    return ca.DM(numbers(value).ravel())
