"""The literal input map M_pol of thesis eq. 69-70: one column of u per degree of heading.

u_i = F_L w_i(theta) t_i / C on membrane node i. Printed entries are 0 or 1 and lose the
directions t_i; here they can be signed. The angle is signed (atan2 about the substrate normal)
and columns are interpolated periodically, so that du/dtheta exists.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.laws.lamellipodium import protrusion
from cellsys.units import real_array


@checked
@dataclass(frozen=True, eq=False)
class MPol:
    """Table of input directions, one column per degree.

    Parameters
    ----------
    table : (3 n, 360)
        Column j is the input pattern for a heading of j degrees, node-major.
    lookup : {"interpolate", "nearest", "arctan"}
        Periodic linear interpolation between columns (default), the column nearest to the signed
        angle, or that of the printed angle arctan(|d_0 x d|/d_0.d) with d_0 = (1, 0, 0) [70],
        which has no sign: headings below the axis get the columns of those above it.
    """

    table: np.ndarray
    lookup: str = "interpolate"

    def __post_init__(self) -> None:
        table = real_array(self.table, "table").copy()
        if table.ndim != 2 or table.shape[1] != 360 or table.shape[0] % 3:
            raise DimensionError(f"M_pol must be (3 n, 360), got {table.shape}")
        if not np.all(np.isfinite(table)):
            raise DataError("M_pol holds NaN or inf")
        if self.lookup not in ("interpolate", "nearest", "arctan"):
            raise ParameterError(
                f"MPol.lookup must be 'interpolate', 'nearest' or 'arctan', got {self.lookup!r}"
            )
        object.__setattr__(self, "table", table)

    @classmethod
    def from_membrane(
        cls,
        position: np.ndarray,
        *,
        height: float,
        edge: float,
        full: float,
        downward: float,
        directions: str = "signed",
        lookup: str = "interpolate",
    ) -> MPol:
        """The map of a fixed membrane shape.

        Parameters
        ----------
        position : (n, 3)
            Membrane nodes, um.
        height, edge, full, downward : float
            As in `cellsys.laws.lamellipodium.protrusion`.
        directions : {"signed", "none"}
            ``none`` is the literal 0/1 membership [thesis eq. 69]: every coordinate of a leading
            node gets the same positive constant.
        """
        if directions not in ("signed", "none"):
            raise ParameterError(f"directions must be 'signed' or 'none', got {directions!r}")
        columns = []
        for degree in range(360):
            angle = np.radians(degree)
            p = np.array([np.cos(angle), np.sin(angle), 0.0])
            pattern = protrusion(position, p, 1.0, height, edge, full, downward)
            if directions == "none":
                leading = np.linalg.norm(pattern, axis=1) > 0
                pattern = np.repeat(leading.astype(float)[:, None], 3, axis=1)
            columns.append(pattern.ravel())
        return cls(np.array(columns).T, lookup)

    def at(self, p: np.ndarray) -> np.ndarray:
        """Pattern (3 n,) for polarity p (3,); p normal to the substrate gives no leading edge."""
        p = np.asarray(p, dtype=float)
        if p.shape != (3,) or not np.all(np.isfinite(p)):
            raise DimensionError("p must be three finite numbers")
        if np.hypot(p[0], p[1]) <= 1e-12 * np.linalg.norm(p) or not np.any(p):
            return np.zeros(len(self.table))
        across = abs(p[1]) if self.lookup == "arctan" else p[1]
        degree = float(np.degrees(np.arctan2(across, p[0]))) % 360.0
        if self.lookup != "interpolate":
            return self.table[:, round(degree) % 360].copy()
        low = int(degree) % 360
        share = degree - int(degree)
        return (1.0 - share) * self.table[:, low] + share * self.table[:, (low + 1) % 360]

    def explained(self, u: np.ndarray, p: np.ndarray) -> float:
        """Share of the squared norm of u (N, 3 n) explained by one constant times the map."""
        patterns = np.array([self.at(row) for row in p])
        square = float(np.sum(patterns**2))
        if u.shape != patterns.shape:
            raise DimensionError(f"u must have shape {patterns.shape}, got {u.shape}")
        factor = float(np.sum(patterns * u)) / square if square > 0 else 0.0
        total = float(np.sum(u**2))
        return 1.0 - float(np.sum((u - factor * patterns) ** 2)) / total if total > 0 else 0.0
