"""Read-outs of cells that share a matrix: gap, matrix speed between and around them.

Speeds between two cells say little by themselves: one cell alone moves the matrix there too. So
every read-out of a pair takes the *one-cell control*, each cell alone at the same place, over the
same nodes and times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import Embedding
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.kinds import Count
from cellsys.mechanics.contact import edge_gap, gap_at, until_contact
from cellsys.observe.spreading import contact_radius, node_speed
from cellsys.scene.scene import Scene
from cellsys.shown import Shown
from cellsys.system import Layout
from cellsys.trajectory import Trajectory
from cellsys.units import shaped_array

CLOSE = 40.0  # um between the edges: cells farther apart are not read as a pair
RIM = 0.87  # share of the matrix radius beyond which the clamped edge is felt


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class PairReadout(Shown):
    """What two cells do to each other's matrix, beside one cell alone.

    Speeds are means over nodes and times, nm/s. `alone` are means over the controls, each cell
    alone at the same place: same nodes, same times.

    Attributes
    ----------
    t : (T - 1,)
        Starts of the sampling intervals, s.
    gap : (T,)
        `edge_gap`, um.
    normalised_gap : (T,)
        Over its start; NaN for cells that start in contact.
    gap_speed, periphery_speed : (T - 1,)
        Of the matrix between the cells, and away from both.
    gap_alone, periphery_alone : (T - 1,)
    """

    t: np.ndarray
    gap: np.ndarray
    normalised_gap: np.ndarray
    gap_speed: np.ndarray
    periphery_speed: np.ndarray
    gap_alone: np.ndarray
    periphery_alone: np.ndarray

    def means(self) -> dict[str, float]:
        """Averages over the run, in nm/s and um."""
        return {
            "gap_start_um": float(self.gap[0]),
            "gap_min_um": float(self.gap.min()),
            "gap_end_um": float(self.gap[-1]),
            "normalised_gap_end": float(self.normalised_gap[-1]),
            "gap_speed_nm_s": float(np.nanmean(self.gap_speed)),
            "gap_speed_one_cell_nm_s": float(np.nanmean(self.gap_alone)),
            "periphery_speed_nm_s": float(np.nanmean(self.periphery_speed)),
            "periphery_speed_one_cell_nm_s": float(np.nanmean(self.periphery_alone)),
        }

    def __str__(self) -> str:
        m = self.means()
        return (
            f"edge gap {m['gap_start_um']:.1f} -> {m['gap_end_um']:.1f} um; matrix speed in the "
            f"gap {m['gap_speed_nm_s']:.2f} nm/s (one cell alone {m['gap_speed_one_cell_nm_s']:.2f}"
            f"), at the periphery {m['periphery_speed_nm_s']:.2f} (one cell alone "
            f"{m['periphery_speed_one_cell_nm_s']:.2f})"
        )


@checked
def pair_regions(
    run: Trajectory, rest: np.ndarray, first: str = "cell1", second: str = "cell2"
) -> tuple[np.ndarray, np.ndarray]:
    """Which matrix nodes lie between two cells, and which away from both, at each sample.

    *Gap*: between the centres, within half the smaller contact radius of their line, under
    neither cell. *Periphery*: farther than two contact radii from the line that joins the
    centres, inside `RIM` of the matrix radius.

    Returns
    -------
    gap, periphery : bool arrays (T, N)
    """
    rest = shaped_array(rest, "rest", (None, 3))[:, :2]
    a, b = run.block(f"{first}.position"), run.block(f"{second}.position")
    radius = np.hypot(*rest.T)
    inside = radius < RIM * radius.max()
    gap, periphery = [], []
    for p, q in zip(a, b, strict=True):
        centres = [p[:, :2].mean(axis=0), q[:, :2].mean(axis=0)]
        reach = [contact_radius(p), contact_radius(q)]
        off = [np.linalg.norm(rest - c, axis=1) for c in centres]
        e = centres[1] - centres[0]
        distance = float(np.linalg.norm(e))
        e = e / distance
        along = (rest - centres[0]) @ e
        aside = np.abs((rest - centres[0]) @ np.array([-e[1], e[0]]))
        # A cell that has not spread yet counts with half its radius.
        size = [max(r, 0.25 * float(np.ptp(x[:, 0]))) for r, x in zip(reach, (p, q), strict=True)]
        free = (off[0] > reach[0]) & (off[1] > reach[1])
        between = free & (along > 0) & (along < distance)
        gap.append(between & (aside < 0.5 * min(size)))
        nearest = np.hypot(aside, np.maximum(np.maximum(-along, along - distance), 0.0))
        periphery.append(inside & (nearest > 2.0 * max(size)))
    return np.array(gap), np.array(periphery)


@checked
def observe_pair(run: Trajectory, alone: Sequence[Trajectory], rest: np.ndarray) -> PairReadout:
    """Gap and matrix speeds of a pair, with the one-cell controls over the same nodes.

    Parameters
    ----------
    run : Trajectory
        With ``cell1``, ``cell2`` and ``matrix.displacement``.
    alone : sequence of Trajectory
        Each cell alone at the same place on the same matrix, at least as long (`alone_scenes`).
    rest : (N, 3)
        Rest positions of the matrix nodes, um.

    Raises
    ------
    DimensionError, DataError
        No control, other times, another matrix.
    """
    if not alone:
        raise DataError("a pair is read beside its one-cell controls; run alone_scenes(scene)")
    rest, T = shaped_array(rest, "rest", (None, 3)), len(run)
    speeds = [1e3 * node_speed(run, "matrix.displacement")]
    for single in alone:
        if len(single) < T or not np.allclose(single.t[:T], run.t):
            raise DimensionError("a one-cell control must be sampled at the times of the pair")
        speeds.append(1e3 * node_speed(single, "matrix.displacement")[: T - 1])
        if speeds[-1].shape != speeds[0].shape or len(rest) != speeds[0].shape[1]:
            raise DimensionError("pair, controls and rest positions must be of one matrix")
    gap, periphery = pair_regions(run, rest)

    def mean(speed: np.ndarray, mask: np.ndarray) -> np.ndarray:
        count = mask[:-1].sum(axis=1)
        total = np.where(mask[:-1], speed, 0.0).sum(axis=1)
        return np.divide(total, count, out=np.full(T - 1, np.nan), where=count > 0)

    between = edge_gap(run)
    return PairReadout(
        t=run.t[:-1],
        gap=between,
        normalised_gap=between / between[0] if between[0] > 0 else np.full(T, np.nan),
        gap_speed=mean(speeds[0], gap),
        periphery_speed=mean(speeds[0], periphery),
        gap_alone=np.mean([mean(s, gap) for s in speeds[1:]], axis=0),
        periphery_alone=np.mean([mean(s, periphery) for s in speeds[1:]], axis=0),
    )


@checked
def speed_against_spacing(readouts: Sequence[PairReadout]) -> np.ndarray:
    """Rows (start gap um, gap speed, one-cell control; nm/s) of several pairs, by spacing."""
    rows = [(r.gap[0], np.nanmean(r.gap_speed), np.nanmean(r.gap_alone)) for r in readouts]
    return np.array(sorted(rows), dtype=float).reshape(-1, 3)


@checked
@dataclass(frozen=True, eq=False)
class Attenuation(Shown):
    """How a matrix displacement decays away from a cell: u ~ exp(-r/length).

    Attributes
    ----------
    length : float
        um.
    radius, displacement : arrays
        Bins from the contact radius to the rim, um, and rms displacement there, um.
    residual : float
        Rms of the logarithm left over.
    """

    length: float
    radius: np.ndarray
    displacement: np.ndarray
    residual: float

    def __str__(self) -> str:
        return f"attenuation length {self.length:.1f} um (residual of the log {self.residual:.2f})"


@checked
def attenuation_length(
    run: Trajectory, rest: np.ndarray, *, cell: str = "cell1", sample: int = -1, bins: Count = 12
) -> Attenuation:
    """Attenuation length of the matrix around one cell, by a straight line through the logarithm.

    Parameters
    ----------
    run : Trajectory
        With one cell and ``matrix.displacement``.
    rest : (N, 3)
        um.
    cell : str
    sample : int
        Which sample; the last one by default.
    bins : int
        Rings of equal width between the contact radius and the rim.

    Raises
    ------
    DataError
        Fewer than three rings hold nodes that move by more than the error of the run
        (`Trajectory.error_of`), or nothing decays.
    """
    if not -len(run) <= sample < len(run):
        raise ParameterError(f"sample must be one of the run's {len(run)}, got {sample}")
    x = run.block(f"{cell}.position")[sample]
    u = np.linalg.norm(run.block("matrix.displacement")[sample], axis=1)
    rest = shaped_array(rest, "rest", (None, 3))
    if len(rest) != len(u):
        raise DimensionError(f"rest must hold {len(u)} nodes, got {len(rest)}")
    centre = x[:, :2].mean(axis=0)
    away = np.linalg.norm(rest[:, :2] - centre, axis=1)
    size = np.hypot(rest[:, 0], rest[:, 1])
    outer = RIM * size.max() - float(np.linalg.norm(centre))
    inner = max(contact_radius(x), 0.5 * float(np.ptp(x[:, 0])))
    if not inner < outer:
        raise DataError(
            f"{cell} reaches {inner:.3g} um from its centre and the rim, which is held, begins "
            f"{outer:.3g} um from it: no ring lies between; read a cell farther from the rim"
        )
    edges = np.linspace(inner, outer, bins + 1)
    middles, moved, errors = [], [], run.errors_of("matrix.displacement")
    for low, high in pairwise(edges):
        ring = (away >= low) & (away < high)
        value = float(np.sqrt(np.mean(u[ring] ** 2))) if ring.any() else 0.0
        error = float(np.sqrt(np.mean(errors[ring] ** 2))) if ring.any() else 0.0
        if value > error:
            middles.append(0.5 * (low + high))
            moved.append(value)
    if len(middles) < 3:
        raise DataError(
            f"only {len(middles)} rings of the matrix move by more than the error of the run at "
            f"t = {run.t[sample]:g} s; no decay can be fitted"
        )
    radius, rms = np.array(middles), np.array(moved)
    slope, level = np.polyfit(radius, np.log(rms), 1)
    if not slope < 0:
        raise DataError("the displacement does not fall with the distance from the cell")
    left = np.log(rms) - (level + slope * radius)
    return Attenuation(float(-1.0 / slope), radius, rms, float(np.sqrt(np.mean(left**2))))


@checked
def pair_of(run: Trajectory, i: int, j: int) -> Trajectory:
    """Cells i and j (from 0) of a run as cell1 and cell2, with the matrix and nothing else."""
    names = [f"cell{i + 1}.position", f"cell{j + 1}.position", "matrix.displacement"]
    blocks = [
        replace(run.states[old], name=new)
        for old, new in zip(names, ("cell1.position", "cell2.position", names[2]), strict=True)
    ]
    x = np.column_stack([run.block(n).reshape(len(run), -1) for n in names])
    geometry = {
        f"cell{new}.triangles": run.geometry[f"cell{old + 1}.triangles"]
        for new, old in ((1, i), (2, j))
        if f"cell{old + 1}.triangles" in run.geometry
    }
    return Trajectory(t=run.t, x=x, states=Layout(blocks), geometry=geometry)


@checked
def observe_neighbours(
    run: Trajectory, alone: Sequence[Trajectory], rest: np.ndarray, within: float = CLOSE
) -> dict[tuple[int, int], PairReadout]:
    """`observe_pair` of every two cells (from 0) whose edges start at most `within` um apart.

    A pair is read until it touches. `alone` are the one-cell controls of all cells, in order.
    """
    found = {}
    for i, j in combinations(range(len(alone)), 2):
        pair = pair_of(run, i, j)
        if gap_at(pair, 0) > within:
            continue
        pair = until_contact(pair)
        if len(pair) > 1:
            found[i, j] = observe_pair(pair, [alone[i], alone[j]], rest)
    return found


@checked
def alone_scenes(scene: Scene) -> list[Scene]:
    """The one-cell controls of a scene: each of its cells alone, at its place, same matrix."""
    if len(scene.cells) < 2:
        raise ParameterError("a one-cell control needs a scene of at least two cells")
    matrix = scene.matrix
    if isinstance(matrix, Embedding):
        matrix = matrix.control(scene)
    return [
        replace(
            scene,
            cells=scene.cells[k : k + 1],
            matrix=matrix,
            name=f"{scene.name}, cell {k + 1} alone",
            until=None,
        )
        for k in range(len(scene.cells))
    ]
