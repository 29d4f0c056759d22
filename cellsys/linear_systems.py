"""Contracts of linear systems: what python-control, scipy and arrays have in common."""

from __future__ import annotations

from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np

from cellsys.system import Matrix


@runtime_checkable
class StateSpaceLike(Protocol):
    """A linear system in state space, such as control.ss(A, B, C, D, 0)."""

    @property
    def A(self) -> Matrix:
        """(n, n)."""

    @property
    def B(self) -> np.ndarray:
        """(n, m)."""

    @property
    def C(self) -> np.ndarray:
        """(p, n)."""

    @property
    def D(self) -> np.ndarray:
        """(p, m)."""

    @property
    def dt(self) -> float:
        """Sampling time, s; 0 of a continuous system."""


@runtime_checkable
class TransferFunctionLike(Protocol):
    """A transfer function, such as control.tf(num, den, 0)."""

    num: Any
    den: Any
    dt: float


@runtime_checkable
class FrequencyDataLike(Protocol):
    """Frequency response data, such as control.frd(H, omega)."""

    omega: np.ndarray

    def eval(self, omega: np.ndarray) -> np.ndarray:
        """Values at frequencies it holds."""


LinearSystem = Annotated[
    StateSpaceLike | TransferFunctionLike | tuple[Any, ...] | Matrix,
    "a linear system: a control.StateSpace or a TransferFunction (of scipy.signal too; other forms "
    "of it by .to_ss()), (A, B, C, D), (A, B, C, D, dt) or a matrix A",
]
