"""Distinct poles of coupled cells with their multiplicities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.drawable import Drawable


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class PoleSet(Drawable):
    """Poles of a coupled system, each block's once.

    Attributes
    ----------
    values : complex array (n,)
        1/s, by falling real part.
    multiplicity : int array (n,)
        How often each occurs in the whole; equal poles of different blocks are not merged, poles
        of a block that occurs many times are counted, not repeated.
    omega : array (n,)
        Eigenvalue of the interaction whose block the pole comes from; nan where it is in all.
    note : str
        What was dropped and what is not determined.
    determined : bool
        False when a direction has 1e-7 > 1 - lambda > tolerance: the data do not say whether it
        is purely matrix.
    alternative : PoleSet or None
        The poles with these directions counted as purely matrix; None when determined.
    spread : array (n,) or None
        How far each moves when a part of the data behind the cell is left out; None where that
        is not known.
    """

    values: np.ndarray
    multiplicity: np.ndarray
    omega: np.ndarray
    note: str = ""
    determined: bool = True
    alternative: PoleSet | None = None
    spread: np.ndarray | None = None

    _figure: ClassVar[str] = "coupled_poles"

    @property
    def count(self) -> int:
        """Number of poles of the whole system, K m."""
        return int(self.multiplicity.sum())

    @property
    def abscissa(self) -> float:
        """Largest real part, 1/s."""
        return float(self.values.real.max())

    @property
    def zeros(self) -> int:
        """How many poles are exactly zero."""
        return int(self.multiplicity[self.values == 0].sum())

    def expanded(self) -> np.ndarray:
        """Every pole, repeated; by falling real part."""
        return np.repeat(self.values, self.multiplicity)

    def __str__(self) -> str:
        lines = [f"{self.count} poles, {len(self.values)} listed with multiplicities: {self.note}"]
        for k, (v, n) in enumerate(zip(self.values[:20], self.multiplicity[:20], strict=True)):
            known = "" if self.spread is None else f"  +- {self.spread[k]:.1e}"
            lines.append(f"  {complex(v):.6g}{known}  x {n}")
        if len(self.values) > 20:
            lines.append(f"  ... and {len(self.values) - 20} more")
        if not self.determined and self.alternative is not None:
            lines.append(f"  not determined by the data; otherwise {self.alternative}")
        return "\n".join(lines)


def pole_set(
    parts: list[tuple[np.ndarray, int, float]],
    note: str,
    alternative: PoleSet | None,
    spreads: list[np.ndarray] | None = None,
) -> PoleSet:
    """Sort and join (values, multiplicity, omega) of the blocks, and the spreads of the values."""
    values = np.concatenate([np.asarray(v, complex) for v, _, _ in parts])
    times = np.concatenate([np.full(len(v), n, dtype=np.int64) for v, n, _ in parts])
    omega = np.concatenate([np.full(len(v), w) for v, _, w in parts])
    order = np.lexsort((values.imag, -values.real))
    spread = None if spreads is None else np.concatenate(spreads)[order]
    return PoleSet(
        values=values[order],
        multiplicity=times[order],
        omega=omega[order],
        note=note,
        determined=alternative is None,
        alternative=alternative,
        spread=spread,
    )
