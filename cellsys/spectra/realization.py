"""`Realization`: the four matrices of a linear system with names and a sampling time.

    dx/dt = A x + B u   (dt = 0)      or      x+ = A x + B u   (dt > 0),        y = C x + D u

Everything in this room works on these arrays. `realization` makes one from a
``control.StateSpace``, from a SISO ``control.TransferFunction``, from a tuple of arrays or from a
square matrix A alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp
from scipy.linalg import lapack

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem, StateSpaceLike, TransferFunctionLike
from cellsys.errors import DataError, DimensionError, MemoryBudgetError, ParameterError
from cellsys.kinds import FILLED, Filled, Takes
from cellsys.state_space import state_space
from cellsys.store.memory import size_text
from cellsys.system import Matrix, is_sparse
from cellsys.units import real_array, real_number

if TYPE_CHECKING:
    import control

DENSE_LIMIT = 4000  # states; a dense complex matrix of this size takes 256 MB
LARGEST = 1e150  # of an entry of A, B, C, D
EPS = float(np.finfo(float).eps)


def _names(given: Sequence[str] | None, count: int, letter: str, what: str) -> tuple[str, ...]:
    if given is None:
        return tuple(f"{letter}[{i}]" for i in range(count))
    names = tuple(str(name) for name in given)
    if len(names) != count:
        raise DimensionError(f"{len(names)} {what} names are given for {count} {what}s")
    return names


def _dense(value: object, name: str) -> np.ndarray:
    array = real_array(value.toarray() if is_sparse(value) else value, name)
    array = np.atleast_2d(array.copy())
    if array.ndim != 2:
        raise DimensionError(f"{name} must be a matrix, got shape {array.shape}")
    return array


def _finite(array: np.ndarray, name: str) -> None:
    if not np.all(np.isfinite(array)):
        bad = np.argwhere(~np.isfinite(np.atleast_1d(array)))[0]
        raise DataError(f"{name}{bad.tolist()} is not finite; mend the model first")


@checked
@dataclass(frozen=True, eq=False)
class Realization:
    """A linear time-invariant system in state space.

        dx/dt = A x + B u,  y = C x + D u      (dt = 0);      x+ = A x + B u      (dt > 0)

    Parameters
    ----------
    A : array (n, n) or scipy.sparse
        A sparse A stays sparse.
    B : array (n, m), optional
        Left out: no inputs.
    C : array (p, n), optional
        Left out: no outputs.
    D : array (p, m), optional
        Left out: zero.
    dt : float
        0 for continuous time, else the sampling time in s.
    states, inputs, outputs : sequence of str, optional
        Names.

    Raises
    ------
    DimensionError
        Sizes do not fit.
    DataError
        A matrix holds NaN, inf or complex numbers.
    ParameterError
        dt is negative or not finite.
    """

    A: Annotated[Any, Takes(Matrix)]  # dense or sparse: no type has what both have
    B: Filled[np.ndarray] = FILLED
    C: Filled[np.ndarray] = FILLED
    D: Filled[np.ndarray] = FILLED
    _: KW_ONLY
    dt: float = 0.0
    states: Filled[tuple[str, ...]] = FILLED
    inputs: Filled[tuple[str, ...]] = FILLED
    outputs: Filled[tuple[str, ...]] = FILLED

    def __post_init__(self) -> None:
        put = object.__setattr__
        if is_sparse(self.A):
            put(self, "A", sp.csc_array(self.A, dtype=float))
            _finite(self.A.data, "A.data")
        else:
            A = real_array(self.A, "A")
            put(self, "A", np.zeros((0, 0)) if A.size == 0 else _dense(A, "A"))
            _finite(self.A, "A")
        n = self.A.shape[0]
        if self.A.shape != (n, n):
            raise DimensionError(f"A must be square, got {self.A.shape}")
        # Roots of a_ij a_ji, which no choice of the states' units changes.
        root = abs(self.A) ** 0.5
        rate = root * root.T if isinstance(root, np.ndarray) else root.multiply(root.T)
        largest = float(rate.max()) if n else 0.0
        if largest > LARGEST:
            raise DataError(
                f"A holds rates of {largest:.3g}, beyond {LARGEST:g}: their squares are no "
                "doubles; take another unit of time"
            )
        D = None if self.D is None else _dense(self.D, "D")
        m = D.shape[1] if self.B is None and D is not None else 0
        p = D.shape[0] if self.C is None and D is not None else 0
        B = np.zeros((n, m)) if self.B is None else self._edge(self.B, "B", 0, n, D)
        C = np.zeros((p, n)) if self.C is None else self._edge(self.C, "C", 1, n, D)
        if D is None or D.size == 0 or (D.size == 1 and D.item() == 0):  # 0 stands for none
            D = np.zeros((C.shape[0], B.shape[1]))
        if D.shape != (C.shape[0], B.shape[1]):
            raise DimensionError(
                f"D has shape {D.shape}, but C has {C.shape[0]} rows and B {B.shape[1]} columns"
            )
        for name, array in (("B", B), ("C", C), ("D", D)):
            _finite(array, name)
            largest = float(np.abs(array).max(initial=0.0))
            if largest > LARGEST:
                raise DataError(f"{name} holds {largest:.3g}, beyond {LARGEST:g}; take other units")
            array.setflags(write=False)
            put(self, name, array)
        if not sp.issparse(self.A):
            self.A.setflags(write=False)
        dt = real_number(self.dt, "dt")
        if dt < 0:
            raise ParameterError(f"dt must be 0 (continuous) or a sampling time > 0 s, got {dt!r}")
        put(self, "dt", dt)
        put(self, "states", _names(self.states, n, "x", "state"))
        put(self, "inputs", _names(self.inputs, B.shape[1], "u", "input"))
        put(self, "outputs", _names(self.outputs, C.shape[0], "y", "output"))

    @staticmethod
    def _edge(value: np.ndarray, name: str, axis: int, n: int, D: np.ndarray | None) -> np.ndarray:
        array = _dense(value, name)
        if array.size == 0:
            known = 0 if D is None else D.shape[1 - axis]
            other = max(array.shape[1 - axis] if array.shape[axis] == n else known, known)
            array = np.zeros((n, other) if axis == 0 else (other, n))
        if array.shape[axis] != n:
            side = "rows" if axis == 0 else "columns"
            raise DimensionError(f"{name} must have {n} {side} like A, got shape {array.shape}")
        return array

    @property
    def n_states(self) -> int:
        """Order n of the system."""
        return self.A.shape[0]

    @property
    def n_inputs(self) -> int:
        """Number m of inputs."""
        return self.B.shape[1]

    @property
    def n_outputs(self) -> int:
        """Number p of outputs."""
        return self.C.shape[0]

    @property
    def is_discrete(self) -> bool:
        """True when dt > 0."""
        return self.dt > 0

    @property
    def is_sparse(self) -> bool:
        """True when A is a scipy.sparse array."""
        return sp.issparse(self.A)

    def dense(self, limit: int = DENSE_LIMIT) -> Realization:
        """The same system with a dense A.

        Raises
        ------
        MemoryBudgetError
            When A is sparse and n > `limit`: the dense matrix is not made behind your back.
        """
        if not self.is_sparse:
            return self
        n = self.n_states
        if n > limit:
            raise MemoryBudgetError(
                f"this needs a dense {n} x {n} matrix ({size_text(8.0 * n * n)}), above the limit "
                f"of {limit} states; frequency_response takes the sparse one, for the rest reduce "
                "the model first"
            )
        return replace(self, A=self.A.toarray())

    def state_space(self) -> control.StateSpace:
        """As ``control.StateSpace`` with the same names and dt."""
        full = self.dense()
        return state_space(
            full.A,
            full.B,
            full.C,
            full.D,
            full.dt,
            states=list(self.states) or None,
            inputs=list(self.inputs) or None,
            outputs=list(self.outputs) or None,
        )


@runtime_checkable
class _Channels(Protocol):
    """What python-control's transfer functions know of their channels."""

    ninputs: int
    noutputs: int
    input_labels: list[str]
    output_labels: list[str]


def _sampling(dt: float | None) -> float:
    if dt is None:
        return 0.0  # control's "unspecified"; continuous is its own default
    return 1.0 if dt is True else dt


@checked
def realization(sys: LinearSystem) -> Realization:
    """Read any linear system as a `Realization`.

    Parameters
    ----------
    sys : StateSpace or SISO TransferFunction (control or scipy.signal), Realization, tuple, array
        A tuple is (A, B, C, D) or (A, B, C, D, dt), where D = 0 stands for none; a square array is
        A alone. ``dt=None`` counts as continuous, ``dt=True`` as a sampling time of 1 s.

    Returns
    -------
    Realization

    Raises
    ------
    ParameterError
        When `sys` is none of these, or a transfer function with several channels.
    DimensionError, DataError
        From the matrices.
    """
    if isinstance(sys, Realization):
        return sys
    if isinstance(sys, tuple):
        if len(sys) not in (4, 5):
            raise ParameterError(f"a tuple must be (A, B, C, D[, dt]), got {len(sys)} entries")
        A, B, C, D = sys[:4]
        return Realization(A, B, C, D, dt=_sampling(sys[4]) if len(sys) == 5 else 0.0)
    if isinstance(sys, (np.ndarray, list, sp.sparray, sp.spmatrix)):
        return Realization(sys)
    if isinstance(sys, StateSpaceLike):
        labels = {
            f"{kind}s": getattr(sys, f"{kind}_labels", FILLED)
            for kind in ("state", "input", "output")
        }
        return Realization(sys.A, sys.B, sys.C, sys.D, dt=_sampling(sys.dt), **labels)
    return _from_transfer_function(sys)


def _from_transfer_function(sys: TransferFunctionLike) -> Realization:
    """Controller canonical form of one channel; balanced later, like every other system."""
    if isinstance(sys, _Channels):
        channels = sys.noutputs * sys.ninputs
        over, under = (sys.num[0][0], sys.den[0][0]) if channels == 1 else (0.0, 1.0)
        names = (tuple(sys.input_labels), tuple(sys.output_labels))
    else:  # scipy.signal: one row of coefficients per output
        rows = np.atleast_2d(real_array(sys.num, "num"))
        channels, over, under, names = len(rows), rows[0], sys.den, (FILLED, FILLED)
    if channels != 1:
        raise ParameterError(
            "a transfer function with several channels has no unique state space: realise it "
            "with control.ss first"
        )
    den = np.trim_zeros(np.atleast_1d(real_array(under, "den")), "f")
    num = np.trim_zeros(np.atleast_1d(real_array(over, "num")), "f")
    _finite(den, "den")
    _finite(num, "num")
    n = len(den) - 1
    if n < 0:
        raise ParameterError("the denominator of the transfer function is zero")
    if len(num) > n + 1:
        raise ParameterError(
            f"improper transfer function: {len(num) - 1} zeros, {n} poles; no state space has it"
        )
    num = np.concatenate([np.zeros(n + 1 - len(num)), num]) / den[0]
    den = den / den[0]
    A = np.eye(n, k=-1)
    A[:1] = -den[1:]
    B = np.eye(n, 1)
    C = (num[1:] - num[0] * den[1:])[None, :]
    return Realization(
        A, B, C, num[:1, None], dt=_sampling(sys.dt), inputs=names[0], outputs=names[1]
    )


def same_time(first: Realization, second: Realization) -> float:
    """The common sampling time; ParameterError when the two differ."""
    if first.dt != second.dt:
        raise ParameterError(
            f"mixed sampling times {first.dt:g} s and {second.dt:g} s; convert one with c2d or d2c"
        )
    return first.dt


def balancing(M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T^-1 M T with T diagonal, powers of two (exact), and the diagonal of T [LAPACK gebal].

    Rows and columns of the result have about the same 2-norm.
    """
    if not M.size:
        return M, np.ones(0)
    balanced, _, _, scale, _ = lapack.dgebal(M, scale=1, permute=0)
    return balanced, scale


@dataclass(frozen=True, eq=False, kw_only=True)
class Balanced:
    """A realization scaled by powers of two, exact: T^-1 A T, T^-1 B R, L C T, L D R.

    `left` (p,) and `right` (m,) scale the outputs and inputs; ``G = G_b / (left right)``.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: np.ndarray  # (n,) diagonal of T
    left: np.ndarray
    right: np.ndarray


def balance(system: Realization) -> Balanced:
    """Scale states, inputs and outputs by powers of two so that rows and columns match in norm.

    The padded matrix [[A, B], [C, 0]] is balanced as a whole [LAPACK gebal; Lemonnier and
    Van Dooren 2006 for state space]. No rounding takes place.
    """
    n, m, p = system.n_states, system.n_inputs, system.n_outputs
    q = max(m, p)
    M = np.zeros((n + q, n + q))
    M[:n, :n], M[:n, n : n + m], M[n : n + p, :n] = system.A, system.B, system.C
    if n == 0 or not np.any(M):
        ones = np.ones
        return Balanced(
            A=system.A,
            B=system.B,
            C=system.C,
            D=system.D,
            states=ones(n),
            left=ones(p),
            right=ones(m),
        )
    scale = balancing(M)[1]
    # ldexp arithmetic: exact, and the product of two scales may leave the range of a float.
    power = np.rint(np.log2(scale)).astype(int)
    t, io = power[:n], power[n:]
    A = np.ldexp(system.A, t[None, :] - t[:, None])
    B = np.ldexp(system.B, io[None, :m] - t[:, None])
    C = np.ldexp(system.C, t[None, :] - io[:p, None])
    D = np.ldexp(system.D, io[None, :m] - io[:p, None])
    return Balanced(
        A=A, B=B, C=C, D=D, states=scale[:n], left=np.exp2(-io[:p]), right=np.exp2(io[:m])
    )
