"""What cells do to the gel around them: thickness along its axis, densification, pull, range.

    T(x, t) = sum n.x / sum n.x0   over the nodes of the lateral boundary in a slice of rest x

n is the outward normal: T is the ratio of radii of a cylinder, of thicknesses of a box
[thesis 4.6.4, Fig. 29]. A journal's volume of slices is T^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sla
from scipy.spatial import cKDTree

from cellsys.arguments import checked
from cellsys.drawable import Drawable
from cellsys.errors import DataError, ParameterError
from cellsys.shown import Shown
from cellsys.trajectory import Trajectory, cell_names
from cellsys.units import shaped_array

SLICE = 10.0  # um
REACHED = 0.95  # thickness ratio below which the gel counts as contracted
MATRIX = "matrix.displacement"


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class GelContraction(Drawable):
    """Thickness of the lateral boundary along the axis, over a run.

    Parameters
    ----------
    t : (T,)
        s.
    x : (S,)
        Middles of the slices at rest, um.
    width : float
        Of a slice, um.
    thickness : (T, S)
        Ratio to the rest.
    """

    t: np.ndarray
    x: np.ndarray
    width: float
    thickness: np.ndarray

    _figure: ClassVar[str] = "gel_thickness"

    def __str__(self) -> str:
        return (
            f"thinnest slice {self.least:.3f} of its rest, contraction integrated along the axis "
            f"{self.integral_um:.2f} um, below {REACHED:g} over {self.range_um:.0f} um"
        )

    @property
    def least(self) -> float:
        """Least thickness ratio at the end."""
        return float(self.thickness[-1].min())

    @property
    def greatest_contraction(self) -> float:
        """1 - `least`."""
        return 1.0 - self.least

    @property
    def integral_um(self) -> float:
        """Integral of 1 - T along the axis at the end, um."""
        return float((1.0 - self.thickness[-1]).sum() * self.width)

    @property
    def range_um(self) -> float:
        """Length with T < `REACHED` at the end, um, by whole slices."""
        return float((self.thickness[-1] < REACHED).sum() * self.width)

    @property
    def volume_ratio(self) -> np.ndarray:
        """Volume of the slices over that at rest (T, S): the square of the thickness."""
        return self.thickness**2

    def course(self) -> np.ndarray:
        """Greatest contraction over time (T,)."""
        return 1.0 - self.thickness.min(axis=1)


def lateral_boundary(run: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of the lateral boundary, their outward normals, and all rest places, um.

    Raises
    ------
    DataError
        When the run is not one in a gel.
    """
    missing = [k for k in ("matrix.lateral", "matrix.outward") if k not in run.geometry]
    if missing or MATRIX not in run.states:
        raise DataError(
            "the run has no lateral boundary: it is not one in a gel (matrix.kind = 'gel')"
        )
    geometry = run.geometry
    return geometry["matrix.lateral"], geometry["matrix.outward"], geometry["matrix.rest"]


@checked
def gel_contraction(
    run: Trajectory, *, width: float = SLICE, displacement: np.ndarray | None = None
) -> GelContraction:
    """Thickness of slices of a gel along its axis.

    Parameters
    ----------
    run : Trajectory
        In a gel.
    width : float
        Of a slice at rest, um; one has its middle at x = 0. Slices without a node of the boundary
        are left out.
    displacement : (T, N, 3), optional
        Of the nodes at the run's times, um, in place of the run's own: that of a reduced model.
    """
    if not (np.isfinite(width) and width > 0):
        raise ParameterError(f"width must be > 0 um, got {width!r}")
    lateral, outward, rest = lateral_boundary(run)
    if displacement is None:
        moved = run.block(MATRIX)[:, lateral]
    else:
        u = shaped_array(displacement, "displacement", (len(run), len(rest), 3))
        moved = u[:, lateral]
    x0 = rest[lateral]
    slices = np.floor(x0[:, 0] / width + 0.5).astype(int)
    there, place = np.unique(slices, return_inverse=True)
    before = np.bincount(place, np.einsum("ij,ij->i", x0, outward))
    out = np.einsum("tij,ij->ti", moved, outward)
    change = np.stack([np.bincount(place, row) for row in out])
    return GelContraction(
        t=np.asarray(run.t),
        x=there * width,
        width=float(width),
        thickness=1.0 + change / before,
    )


@checked
def densification(
    run: Trajectory,
    first: str = "cell1",
    second: str = "cell2",
    *,
    half_length: float = 6.0,
    radius: float = 10.0,
    k: int = -1,
) -> float:
    """Volume of the gel between two cells over that at rest: det F, x = F x0 + c in least squares.

    Of the nodes within `half_length` (um) of the middle between the two cells along the line of
    their starting centres, and within `radius` (um) of that line. Below 1 the gel is denser.

    Raises
    ------
    DataError
        When the run has no such cells, or fewer than four nodes lie between them.
    """
    names = cell_names(run.states)
    for name in (first, second):
        if name not in names:
            raise DataError(f"the run has no cell {name!r}; it has {', '.join(names) or 'none'}")
    _, _, rest = lateral_boundary(run)
    a, b = (run.block(f"{name}.position")[0].mean(axis=0) for name in (first, second))
    return local_volume(
        rest, run.block(MATRIX)[k], 0.5 * (a + b), b - a, half_length=half_length, radius=radius
    )


@checked
def local_volume(
    rest: np.ndarray,
    u: np.ndarray,
    middle: np.ndarray,
    along: np.ndarray,
    *,
    half_length: float = 6.0,
    radius: float = 10.0,
) -> float:
    """det F of the nodes in a cylinder about `middle` along `along`; see `densification`.

    rest, u (N, 3) um; middle, along (3,).
    """
    axis = along / np.linalg.norm(along)
    offset = rest - middle
    far = offset @ axis
    across = np.linalg.norm(offset - far[:, None] * axis, axis=1)
    chosen = (np.abs(far) < half_length) & (across < radius)
    if chosen.sum() < 4:
        raise DataError(
            f"{int(chosen.sum())} nodes lie between the cells: fewer than four make no local map; "
            "widen half_length or radius"
        )
    return float(sla.det(affine_map(rest[chosen], u[chosen])))


def affine_map(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """F (3, 3) of x + u = F x + c in least squares over nodes (n, 3)."""
    columns = np.hstack([x - x.mean(axis=0), np.ones((len(x), 1))])
    found, *_ = sla.lstsq(columns, u)
    return np.eye(3) + found[:3].T


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class CellPull(Shown):
    """How one cell pulls on its gel over one sampling interval.

    Attributes
    ----------
    force_nN : float
        Contractile force: sum over the membrane nodes of the inward force on the gel.
    net_pN : (3,)
        Sum of the forces on the gel.
    dipole_nN_um : (3, 3)
        Sum of (x - centre) f, f the forces on the gel; its trace is negative where it contracts.
    """

    force_nN: float
    net_pN: np.ndarray
    dipole_nN_um: np.ndarray

    def __str__(self) -> str:
        return (
            f"contractile force {self.force_nN:.3g} nN, dipole "
            f"{float(np.trace(self.dipole_nN_um)):.3g} nN um"
        )


@checked
def cell_pull(run: Trajectory, cell: str = "cell1", k: int = -1) -> CellPull:
    """Contractile force and dipole of a cell on its gel, by its focal adhesions.

    Of sampling interval k, with places halfway between its samples.

    Raises
    ------
    DataError
        When the run holds no auxiliaries, or its cell no focal adhesion.
    """
    block = f"{cell}.focal_adhesion"
    if run.eta is None or block not in run.auxiliaries:
        raise DataError(
            f"{cell} has no forces of adhesions in this run; it needs focal_adhesion and a run "
            "that keeps its auxiliaries"
        )
    on_gel = -run.auxiliary(block)[k]
    at = run.block(f"{cell}.position")
    last = range(len(run) - 1)[k]
    x = 0.5 * (at[last] + at[last + 1])
    away = x - x.mean(axis=0)
    unit = away / np.linalg.norm(away, axis=1, keepdims=True)
    return CellPull(
        force_nN=-1e-3 * float(np.einsum("ij,ij->", on_gel, unit)),
        net_pN=on_gel.sum(axis=0),
        dipole_nN_um=1e-3 * away.T @ on_gel,
    )


@checked
def range_exponent(
    run: Trajectory,
    cell: str = "cell1",
    *,
    nearest: float = 11.0,
    farthest: float = 29.0,
    cone: float = 0.7,
    k: int = -1,
) -> float:
    """Exponent m of the inward displacement u_r ~ r^m around a cell, along the axis of the gel.

    A straight line through log u_r against log r, u_r the mean over shells of 2 um between
    `nearest` and `farthest` (um) from the cell's starting centre, within the cone |cos| > `cone`
    about the axis.

    Raises
    ------
    DataError
        Fewer than three shells that move inward.
    """
    _, _, rest = lateral_boundary(run)
    offset = rest - run.block(f"{cell}.position")[0].mean(axis=0)
    r = np.linalg.norm(offset, axis=1)
    inside = (np.abs(offset[:, 0]) > cone * r) & (r >= nearest) & (r < farthest)
    inward = -np.einsum("ij,ij->i", run.block(MATRIX)[k], offset) / np.maximum(r, 1e-12)
    shell = np.floor((r[inside] - nearest) / 2.0).astype(int)
    count = np.bincount(shell)
    mean = np.bincount(shell, inward[inside]) / np.maximum(count, 1)
    middle = nearest + 2.0 * np.arange(len(count)) + 1.0
    used = (count > 0) & (mean > 0)
    if used.sum() < 3:
        raise DataError(f"{int(used.sum())} shells around {cell} move inward; three make a line")
    line = np.polynomial.polynomial.polyfit(np.log(middle[used]), np.log(mean[used]), 1)
    return float(line[1])


@checked
def gel_read_outs(run: Trajectory) -> dict[str, float]:
    """Numbers of a run in a gel: contraction, its integral and range, mean pull of the cells.

    ``contraction_max``, ``contraction_integral_um``, ``contraction_range_um``; with auxiliaries
    ``contractile_force_nN`` and ``dipole_nN_um`` (trace), means over the cells; of two cells and
    more ``gap_volume_ratio`` between the first two.
    """
    found = gel_contraction(run)
    out = {
        "contraction_max": found.greatest_contraction,
        "contraction_integral_um": found.integral_um,
        "contraction_range_um": found.range_um,
    }
    names = cell_names(run.states)
    if run.eta is not None and all(f"{n}.focal_adhesion" in run.auxiliaries for n in names):
        pulls = [cell_pull(run, n) for n in names]
        if pulls:
            out["contractile_force_nN"] = float(np.mean([p.force_nN for p in pulls]))
            out["dipole_nN_um"] = float(np.mean([np.trace(p.dipole_nN_um) for p in pulls]))
    if len(names) > 1:
        out["gap_volume_ratio"] = densification(run)
    return out


@checked
def local_volumes(rest: np.ndarray, u: np.ndarray, *, neighbours: int = 12) -> np.ndarray:
    """det F at every node (N,), of the affine map of its nearest `neighbours` at rest.

    rest, u (N, 3) um. Below 1 the gel is denser there.
    """
    rest = shaped_array(rest, "rest", (None, 3))
    u = shaped_array(u, "u", rest.shape)
    if not 4 <= neighbours < len(rest):
        raise ParameterError(f"neighbours must be in [4, {len(rest) - 1}], got {neighbours}")
    near = np.asarray(cKDTree(rest).query(rest, k=neighbours + 1)[1])
    x = rest[near] - rest[near].mean(axis=1, keepdims=True)
    v = u[near] - u[near].mean(axis=1, keepdims=True)
    # Least squares of v = x G^T, node by node: Q R of x, which 13 points in space make regular.
    q, r = np.linalg.qr(x)
    gradient = np.linalg.solve(r, np.einsum("nki,nkj->nij", q, v))
    return np.linalg.det(np.eye(3) + gradient)
