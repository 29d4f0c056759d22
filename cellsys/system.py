"""`OdeSystem`: what an integrator accepts.

    dx/dt = W_x x + W_eta eta(t, x) + u(t, x)                         [thesis eq. 5, 39, 65]

`W_x` and `W_eta` are constant; `eta` holds the outputs of the constitutive laws. States,
auxiliaries and inputs are named blocks of a `Layout`, so that an array never travels without
the names of its entries.
"""

from __future__ import annotations

import builtins
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Generic,
    NamedTuple,
    TypeGuard,
    TypeVar,
    overload,
)

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked, unchecked
from cellsys.errors import (
    DataError,
    DimensionError,
    NotSymbolicError,
    ParameterError,
    UnknownNameError,
)
from cellsys.kinds import FILLED, Takes, shown
from cellsys.units import real_array

if TYPE_CHECKING:
    import casadi

Symbol = TypeVar("Symbol", "casadi.SX", "casadi.MX")
ROLES = ("component", "field", "controller")
Matrix = Annotated[
    np.ndarray | sp.sparray | sp.spmatrix, "a matrix of numbers, an array or scipy.sparse"
]


def is_sparse(matrix: object) -> TypeGuard[sp.csr_array | sp.csc_array]:
    """Whether it is a sparse matrix, of whichever format."""
    return sp.issparse(matrix)


@checked
@dataclass(frozen=True)
class Block:
    """A named, contiguous piece of a vector.

    Parameters
    ----------
    name : str
        For example ``"cell1.position"``.
    shape : tuple of int
        Shape of the piece; ``()`` for a scalar.
    unit : str
        Unit of its entries.
    role : {"component", "field", "controller"}
        To which part of the loop it belongs: a cell, the shared matrix, or the polarity law.
    kind : str
        ``"position"``, ``"rate"`` or ``"internal"``: which blocks share a scale factor; or
        ``"label"``: a discrete label, which no reduced model learns.
    """

    name: str
    shape: tuple[int, ...] = ()
    unit: str = "1"
    _: KW_ONLY
    role: str = "component"
    kind: str = "position"

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise ParameterError(f"Block.role must be one of {ROLES}, got {self.role!r}")

    @property
    def size(self) -> int:
        """Number of entries."""
        return math.prod(self.shape)

    def entry_names(self) -> list[str]:
        """One name per entry, in C order; the last axis of length 3 reads x, y, z."""
        if not self.shape:
            return [self.name]
        names = []
        for index in np.ndindex(*self.shape):
            if self.shape[-1] == 3 and len(self.shape) > 1:
                head = "".join(f"[{i}]" for i in index[:-1])
                names.append(f"{self.name}{head}.{'xyz'[index[-1]]}")
            else:
                names.append(self.name + "".join(f"[{i}]" for i in index))
        return names


@checked
class Layout(Sequence[Block]):
    """An ordered set of blocks that together name the entries of a vector."""

    def __init__(self, blocks: Iterable[Block | str] = ()) -> None:
        self._blocks = tuple(b if isinstance(b, Block) else Block(b) for b in blocks)
        names = [b.name for b in self._blocks]
        if twice := sorted(n for n, times in Counter(names).items() if times > 1):
            listed = ", ".join(shown(n) for n in twice[:6]) + ", ..." * (len(twice) > 6)
            raise ParameterError(f"block names must be unique, got {listed} more than once")
        self._by_name = {b.name: b for b in self._blocks}
        edges = np.concatenate([[0], np.cumsum([b.size for b in self._blocks])]).astype(int)
        self._slices = {
            b.name: slice(int(edges[i]), int(edges[i + 1])) for i, b in enumerate(self._blocks)
        }
        self.size = int(edges[-1])

    def __len__(self) -> int:
        return len(self._blocks)

    def __iter__(self) -> Iterator[Block]:
        return iter(self._blocks)

    @overload
    def __getitem__(self, key: str | int) -> Block: ...

    @overload
    def __getitem__(self, key: builtins.slice) -> tuple[Block, ...]: ...

    def __getitem__(self, key: str | int | builtins.slice) -> Block | tuple[Block, ...]:
        try:
            return self._by_name[key] if isinstance(key, str) else self._blocks[key]
        except (KeyError, TypeError):
            raise self._unknown(key) from None

    def __contains__(self, key: object) -> bool:
        return key in self._slices or key in self._blocks

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Layout) and self._blocks == other._blocks

    def __hash__(self) -> int:
        return hash(self._blocks)

    def __add__(self, other: Layout) -> Layout:
        return Layout(self._blocks + tuple(other))

    def __repr__(self) -> str:
        return f"Layout({', '.join(f'{b.name}{list(b.shape)}' for b in self._blocks)})"

    @unchecked
    def slice(self, name: str) -> slice:
        """Where the block lies in the vector; UnknownNameError with the known names otherwise."""
        try:
            return self._slices[name]
        except (KeyError, TypeError):
            raise self._unknown(name) from None

    def _unknown(self, name: object) -> UnknownNameError:
        known = ", ".join(self._slices) or "none"
        return UnknownNameError(f"no block {shown(name)}; known blocks: {known}")

    @unchecked
    def view(self, array: np.ndarray, name: str) -> np.ndarray:
        """The block's entries as a view of shape ``array.shape[:-1] + block.shape``."""
        return array[..., self.slice(name)].reshape(array.shape[:-1] + self._by_name[name].shape)

    @property
    def names(self) -> list[str]:
        """One name per entry of the vector."""
        return [name for block in self._blocks for name in block.entry_names()]

    def where(self, *, role: str | None = None, kind: str | None = None) -> np.ndarray:
        """Indices (int, sorted) of all entries with this role and kind."""
        mask = np.zeros(self.size, bool)
        for block in self._blocks:
            if role in (None, block.role) and kind in (None, block.kind):
                mask[self._slices[block.name]] = True
        return np.flatnonzero(mask)


def _matrix(value: sp.csr_array | None, name: str, shape: tuple[int, int]) -> sp.csr_array:
    matrix = sp.csr_array(shape if value is None else value)
    matrix.data = np.asarray(matrix.data, dtype=float)
    if matrix.shape != shape:
        raise DimensionError(f"{name} must have shape {shape}, got {matrix.shape}")
    if not np.all(np.isfinite(matrix.data)):
        raise DataError(f"{name} holds NaN or inf")
    return matrix


@checked
class Event(NamedTuple):
    """Something that happened at one instant of a run."""

    time: float  # s
    name: str  # for example "rupture"
    detail: str  # for example "cell1 node 17"


@checked
@dataclass(frozen=True, kw_only=True)
class EventFunction:
    """A guard located by root finding, and the jump of the state that it causes.

    Parameters
    ----------
    name : str
        Written to the trajectory's events.
    guard : callable
        ``guard(t, x)`` -> float, smooth between events; zero is the event.
    direction : {-1, 0, 1}
        Fires where the guard falls through zero, passes it either way, or rises through it.
    reset : callable, optional
        ``reset(t, x)`` -> new state; None only notes the event.
    level : bool
        Fires also where the guard is past zero at the start or after a reset. Needs a direction.
    """

    name: str
    guard: Callable[[float, np.ndarray], float]
    direction: int = 0
    reset: Callable[[float, np.ndarray], np.ndarray] | None = None
    level: bool = False


class SymbolicForm(NamedTuple, Generic[Symbol]):
    """CasADi form of a system: ``xdot`` and ``eta`` as expressions of ``t``, ``x`` and ``p``."""

    t: Symbol
    x: Symbol
    xdot: Symbol
    eta: Symbol
    p: Symbol | None = None  # of named parameters, where there are any


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class OdeSystem:
    """A system of ordinary differential equations, linear in its auxiliary variables.

        dx/dt = W_x x + W_eta eta(t, x) + u(t, x)                     [thesis eq. 5, 65]

    Parameters
    ----------
    states, auxiliaries, inputs : Layout or sequence of Block or str
        Names of the entries of x (n), eta (n_eta) and of the inputs behind u. A plain string
        is a scalar.
    x0 : array (n,)
        Initial state.
    W_x : (n, n) array or sparse, optional
        Linear part, 1/s; zero when left out.
    W_eta : (n, n_eta) array or sparse, optional
        Junction matrix; needed when there are auxiliaries.
    law : callable, optional
        ``law(t, x) -> eta``; must accept CasADi symbols for the symbolic integrators.
    forcing : callable, optional
        ``forcing(t, x) -> u`` (n,), a rate in the states' units per second.

    Raises
    ------
    DimensionError, DataError
        When sizes do not fit or x0, W_x or W_eta hold NaN or inf.
    """

    states: Annotated[Layout, Takes(Layout | Sequence[Block | str])]
    x0: np.ndarray
    auxiliaries: Annotated[Layout, Takes(Layout | Sequence[Block | str])] = Layout()
    inputs: Annotated[Layout, Takes(Layout | Sequence[Block | str])] = Layout()
    W_x: Annotated[sp.csr_array, Takes(Matrix | None)] = FILLED
    W_eta: Annotated[sp.csr_array, Takes(Matrix | None)] = FILLED
    law: Callable[[Any, Any], Any] | None = None
    forcing: Callable[[Any, Any], Any] | None = None

    def __post_init__(self) -> None:
        for name in ("states", "auxiliaries", "inputs"):
            value = getattr(self, name)
            object.__setattr__(self, name, value if isinstance(value, Layout) else Layout(value))
        n, n_eta = self.states.size, self.auxiliaries.size
        x0 = real_array(self.x0, "x0").copy()
        if x0.shape != (n,):
            raise DimensionError(f"x0 must have shape ({n},), got {x0.shape}")
        if not np.all(np.isfinite(x0)):
            bad = int(np.flatnonzero(~np.isfinite(x0))[0])
            raise DataError(f"x0 of state {self.states.names[bad]!r} is {x0[bad]!r}, not finite")
        x0.setflags(write=False)
        object.__setattr__(self, "x0", x0)
        object.__setattr__(self, "W_x", _matrix(self.W_x, "W_x", (n, n)))
        object.__setattr__(self, "W_eta", _matrix(self.W_eta, "W_eta", (n, n_eta)))
        if n_eta and self.law is None and type(self).eta is OdeSystem.eta:
            raise ParameterError("a system with auxiliaries needs law(t, x) -> eta")

    @unchecked
    def eta(self, t: float, x: np.ndarray) -> np.ndarray:
        """Auxiliary variables (n_eta,) at (t, x): the outputs of the constitutive laws."""
        if self.law is None:
            return np.zeros(0)
        return np.asarray(self.law(t, x), dtype=float).reshape(self.auxiliaries.size)

    @unchecked
    def u(self, t: float, x: np.ndarray) -> np.ndarray:
        """Exogenous rate (n,) at (t, x)."""
        if self.forcing is None:
            return np.zeros(self.states.size)
        return np.asarray(self.forcing(t, x), dtype=float).reshape(self.states.size)

    @unchecked
    def rhs(self, t: float, x: np.ndarray) -> np.ndarray:
        """dx/dt (n,) at (t, x)."""
        return self.W_x @ x + self.W_eta @ self.eta(t, x) + self.u(t, x)

    @cached_property
    def _symbolic(self) -> SymbolicForm:
        numeric = [n for n in ("eta", "u", "rhs") if _overrides(self, n)]
        if numeric:
            raise NotSymbolicError(
                f"{type(self).__name__} computes {', '.join(numeric)} by compiled loops and has no "
                "CasADi form; use a numeric integrator, or reduce it first"
            )
        import casadi as ca

        t, x = ca.SX.sym("t"), ca.SX.sym("x", self.states.size)
        try:
            eta = ca.SX.zeros(0, 1) if self.law is None else ca.vcat(_entries(self.law(t, x)))
            u = 0 if self.forcing is None else ca.vcat(_entries(self.forcing(t, x)))
        except (TypeError, ValueError, NotImplementedError, RuntimeError) as error:
            raise NotSymbolicError(
                f"law or forcing of this system does not accept CasADi symbols ({error}); "
                "use laws from cellsys.laws or a numeric integrator"
            ) from error
        if not (_is_regular(eta) and _is_regular(u)):
            # float(symbol) is NaN without an error: a law that leaves the symbols shows up here.
            raise NotSymbolicError(
                "law or forcing of this system turns CasADi symbols into NaN or inf (a float() of "
                "a symbol, say); use laws from cellsys.laws or a numeric integrator"
            )
        xdot = _dm(self.W_x) @ x + u
        if self.auxiliaries.size:
            xdot = xdot + _dm(self.W_eta) @ eta
        return SymbolicForm(t, x, xdot, eta)

    def casadi(self) -> SymbolicForm:
        """CasADi form (t, x, xdot, eta); NotSymbolicError where a law is numeric only."""
        return self._symbolic

    # Optional hooks. What a system does not override, it does not have.
    @property
    def discrete(self) -> bool:
        """Whether the system changes between steps: binding, rupture, thermal forces."""
        return False

    def events(self) -> tuple[EventFunction, ...]:
        """Guard functions located by root finding; none by default."""
        return ()

    def stop_points(self) -> tuple[float, ...]:
        """Times (s) at which the right-hand side jumps: no step may cross them."""
        return ()

    def geometry(self) -> dict[str, np.ndarray]:
        """Constant places that a reader of a run needs, such as rest positions; by name."""
        return {}

    @unchecked
    def observe(self, t: float, x: np.ndarray) -> dict[str, np.ndarray]:
        """Read-outs stored with each sample: ``p``, ``d`` (cells, 3), ``amplitude`` (cells,)."""
        return {}


def _overrides(system: OdeSystem, name: str) -> bool:
    """Whether a subclass replaced one of the methods that ``law`` and ``forcing`` feed."""
    return getattr(type(system), name) is not getattr(OdeSystem, name)


def _entries(value: object) -> list:
    """A law may return a list of scalars and vectors, or one vector."""
    return list(value) if isinstance(value, (list, tuple)) else [value]


def _is_regular(expression: casadi.SX | float) -> bool:
    import casadi as ca

    matrix = ca.SX(expression)
    entries = (matrix.nz[k] for k in range(matrix.nnz()))
    return all(e.is_regular() for e in entries if e.is_constant())


def _dm(matrix: sp.csr_array) -> casadi.DM:
    import casadi as ca

    return ca.DM(sp.csc_matrix(matrix))
