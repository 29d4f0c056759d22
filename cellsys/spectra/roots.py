"""`RootSet`: poles or zeros as a complex array that knows its condition numbers and clusters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import wraps
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.drawable import Drawable
from cellsys.spectra.spectrum import Spectrum


@checked
class RootSet(Drawable, np.ndarray):
    """Poles or zeros: a read-only complex array (k,), sorted by falling real part.

    Arithmetic, slices, methods and numpy's functions give plain arrays. What is known about the
    errors is worked out on first use (it needs eigenvectors).

    Attributes
    ----------
    kind : str
        ``"pole"`` or ``"zero"``.
    dt : float
        0 in continuous time, else the sampling time in s.
    note : str
        What was decided on the way (thresholds, dropped roots).
    """

    _figure: ClassVar[str] = "pole_zero_map"
    _detail: Spectrum | Callable[[np.ndarray], Spectrum] | None
    kind: str
    dt: float
    note: str

    def __new__(
        cls,
        values: np.ndarray,
        *,
        kind: str,
        dt: float,
        detail: Spectrum | Callable[[np.ndarray], Spectrum],
        note: str = "",
    ) -> RootSet:
        """Make one from values (k,) and a `Spectrum` in the same order (or how to get it)."""
        new = np.array(values, dtype=complex).view(cls)
        new._detail, new.kind, new.dt, new.note = detail, kind, dt, note
        new.setflags(write=False)
        return new

    def __array_finalize__(self, source: object) -> None:
        """Views carry no details: they may hold other entries."""
        self._detail, self.kind, self.dt, self.note = None, "root", 0.0, ""

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: object, **options: object
    ) -> object:
        """Arithmetic is that of plain arrays, and gives plain arrays."""
        return getattr(ufunc, method)(*_plain_all(inputs), **_plain_named(options))

    def __array_function__(
        self,
        func: Callable[..., object],
        types: Iterable[type],
        args: Iterable[object],
        kwargs: Mapping[str, object],
    ) -> object:
        """Functions of numpy take and give plain arrays."""
        return func(*_plain_all(args), **_plain_named(kwargs))

    @property
    def spectrum(self) -> Spectrum:
        """Condition numbers, bounds and clusters, worked out on first use."""
        if self._detail is None:
            raise AttributeError("a slice or copy of a RootSet has no error bounds; use the whole")
        if not isinstance(self._detail, Spectrum):
            self._detail = self._detail(np.asarray(self))
        return self._detail

    @property
    def condition(self) -> np.ndarray:
        """Condition number of each root in balanced coordinates, >= 1 for poles."""
        return self.spectrum.condition

    @property
    def error_bound(self) -> np.ndarray:
        """Distance within which a true root lies, 1/s (or 1 in discrete time)."""
        return self.spectrum.bound

    @property
    def cluster(self) -> np.ndarray:
        """Label of the cluster each root belongs to."""
        return self.spectrum.cluster

    @property
    def cluster_size(self) -> np.ndarray:
        """Number of roots in the cluster of each."""
        return self.spectrum.cluster_size

    def __deepcopy__(self, memo: dict[int, object] | None) -> RootSet:
        return self  # read-only

    def __reduce__(self) -> tuple[Callable[..., RootSet], tuple[object, ...]]:
        """Pickles keep the details."""
        return _rebuild, (np.array(self), self.kind, self.dt, self.spectrum, self.note)

    def __str__(self) -> str:
        if self._detail is None:
            return str(np.asarray(self))
        lines = [f"{len(self)} {self.kind}s" + (f" ({self.note})" if self.note else "")]
        size = self.cluster_size
        for i in range(min(len(self), 20)):
            line = f"  {complex(self[i]):.6g}  +- {self.error_bound[i]:.1e}"
            lines.append(line + (f"  (one of a cluster of {size[i]})" if size[i] > 1 else ""))
        if len(self) > 20:
            lines.append(f"  ... and {len(self) - 20} more")
        return "\n".join(lines)

    def __repr__(self) -> str:
        """The roots with their bounds, at most twenty."""
        return str(self) if self._detail is not None else repr(np.asarray(self))

    def _rows(self) -> tuple[Sequence[str], Sequence[Sequence[object]]] | None:
        if self._detail is None:
            return None
        names = (self.kind, "error bound", "condition number", "roots in the cluster")
        columns = (np.asarray(self), self.error_bound, self.condition, self.cluster_size)
        return names, [[v.item() for v in row] for row in zip(*columns, strict=True)]


def _plain(value: object) -> object:
    """The same with every `RootSet` in it as a plain, read-only array."""
    if isinstance(value, RootSet):
        return value.view(np.ndarray)
    if isinstance(value, (tuple, list)) and any(_holds(part) for part in value):
        return type(value)(_plain(part) for part in value)
    if isinstance(value, dict):
        return _plain_named(value)
    return value


def _plain_all(values: Iterable[object]) -> list[object]:
    return [_plain(value) for value in values]


def _plain_named(values: Mapping[str, object]) -> dict[str, object]:
    return {name: _plain(value) for name, value in values.items()}


def _holds(value: object) -> bool:
    return isinstance(value, (RootSet, tuple, list, dict))


def _of_plain_arrays(name: str) -> Callable[..., object]:
    plain = getattr(np.ndarray, name)

    @wraps(plain)
    def method(self: RootSet, *args: object, **options: object) -> object:
        return plain(np.asarray(self), *_plain_all(args), **_plain_named(options))

    return method


def _plain_part(name: str, doc: str) -> property:
    def part(self: RootSet) -> np.ndarray:
        return getattr(np.asarray(self), name)

    return property(part, doc=doc)


# p[0], p.round(3), p.copy(), p.reshape(...): what plain arrays give.
for _name in (
    "__getitem__ argpartition argsort astype byteswap choose clip compress conj conjugate copy "
    "cumprod cumsum diagonal dot flatten getfield mean prod ravel repeat reshape round "
    "searchsorted squeeze std sum swapaxes take trace transpose var"
).split():
    setattr(RootSet, _name, _of_plain_arrays(_name))
# Read only, where numpy's own may be set.
for _name, _doc in {
    "T": "Plain array, as it is.",
    "real": "Real parts, a plain array (k,).",
    "imag": "Imaginary parts, a plain array (k,).",
}.items():
    setattr(RootSet, _name, _plain_part(_name, _doc))


def _rebuild(values: np.ndarray, kind: str, dt: float, detail: Spectrum, note: str) -> RootSet:
    return RootSet(values, kind=kind, dt=dt, detail=detail, note=note)


def poles_of(found: Spectrum, dt: float, note: str = "") -> RootSet:
    """The eigenvalues of a system as poles, by falling real part, each with its bound."""
    rank = order(found.values)
    detail = replace(
        found,
        values=found.values[rank],
        condition=found.condition[rank],
        bound=found.bound[rank],
        cluster=found.cluster[rank],
    )
    return RootSet(detail.values, kind="pole", dt=dt, detail=detail, note=note)


def order(values: np.ndarray) -> np.ndarray:
    """Indices that sort by falling real part, then by imaginary part."""
    return np.lexsort((values.imag, -values.real))
