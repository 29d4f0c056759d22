"""`RootSet`: poles or zeros as a complex array that knows its condition numbers and clusters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.drawable import Drawable
from cellsys.response.spectrum import Spectrum


@checked
class RootSet(Drawable, np.ndarray):
    """Poles or zeros: a read-only complex array (k,), sorted by falling real part.

    Arithmetic, slices and reductions give plain arrays. What is known about the errors is worked
    out on first use (it needs eigenvectors).

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

    def __array_finalize__(self, source: Any) -> None:
        """Views carry no details: they may hold other entries."""
        self._detail, self.kind, self.dt, self.note = None, "root", 0.0, ""

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        """Results of arithmetic are plain arrays."""
        array = np.asarray(array)
        return array[()] if return_scalar else array

    def __getitem__(self, key: Any) -> Any:
        """Plain array or scalar."""
        return np.asarray(self)[key]

    @property
    def real(self) -> np.ndarray:
        """Real parts, a plain array (k,)."""
        return np.asarray(self).real

    @property
    def imag(self) -> np.ndarray:
        """Imaginary parts, a plain array (k,)."""
        return np.asarray(self).imag

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

    def __deepcopy__(self, memo: dict) -> RootSet:
        return self  # read-only

    def __reduce__(self) -> tuple:
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
        return repr(np.asarray(self))


def _rebuild(
    values: np.ndarray, kind: str, dt: float, detail: Spectrum, note: str
) -> RootSet:
    return RootSet(values, kind=kind, dt=dt, detail=detail, note=note)


def order(values: np.ndarray) -> np.ndarray:
    """Indices that sort by falling real part, then by imaginary part."""
    return np.lexsort((values.imag, -values.real))
