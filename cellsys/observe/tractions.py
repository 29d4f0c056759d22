"""What a cell does to its matrix: tractions, their net force, dipole, front and rear, and work.

The traction t_j of a matrix node j is the sum of all forces that elements of one cell put on it,
the ports ``matrix.*.CELL`` of a run with its auxiliaries; the force of the cell on the matrix. A
run holds means over each sampling interval, so a read-out belongs to an interval, with places and
displacements halfway between its samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
from scipy.spatial import ConvexHull, QhullError, cKDTree

from cellsys.arguments import checked
from cellsys.drawable import Drawable
from cellsys.errors import DataError, ParameterError
from cellsys.geometry.membrane import enclosed_volume
from cellsys.observe.spreading import CONTACT_HEIGHT
from cellsys.trajectory import Trajectory
from cellsys.units import shaped_array

SMOOTHING = 3.0  # um: radius over which a traction microscope of today resolves a force
SPACING = 1.0  # um between the points of a map


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Tractions(Drawable):
    """Tractions of one cell over one sampling interval.

    Parameters
    ----------
    force : (N, 3)
        Of the cell on every matrix node, pN.
    place : (N, 3)
        Matrix nodes as they lie, um.
    displacement : (N, 3)
        From rest, um.
    centre : (3,)
        Of the cell, um.
    polarity : (3,) or None
        Of the cell; None in a run without one.
    drag : (3,)
        Force of the medium on the cell, -sum C v, pN.
    drag_couple : float
        Its couple about the normal through the centre, -sum r x C v, pN um.
    """

    force: np.ndarray
    place: np.ndarray
    displacement: np.ndarray
    centre: np.ndarray
    polarity: np.ndarray | None
    drag: np.ndarray
    drag_couple: float = 0.0

    _figure: ClassVar[str] = "traction_field"

    def __str__(self) -> str:
        return (
            f"tractions: sum {1e-3 * self.sum_pN:.3g} nN, net {100 * self.net_share:.2g} % of it, "
            f"dipole {1e-3 * float(np.trace(self.dipole_pN_um)):.3g} nN um"
        )

    def __post_init__(self) -> None:
        for name in ("force", "place", "displacement"):
            object.__setattr__(self, name, shaped_array(getattr(self, name), name, (None, 3)))

    @property
    def sum_pN(self) -> float:
        """Sum of the magnitudes in the plane, pN."""
        return float(np.hypot(self.force[:, 0], self.force[:, 1]).sum())

    @property
    def net_pN(self) -> np.ndarray:
        """Net force of the cell on the matrix (3,), pN: what the drag of the medium leaves."""
        return self.force.sum(axis=0)

    @property
    def net_share(self) -> float:
        """Net force in the plane over the sum of the magnitudes; 0 without a traction."""
        return self._share(float(np.hypot(*self.net_pN[:2])))

    @property
    def imbalance_share(self) -> float:
        """|sum t + sum C v| in the plane over the sum of the magnitudes: 0 where forces balance."""
        return self._share(float(np.hypot(*(self.net_pN - self.drag)[:2])))

    def _share(self, size: float) -> float:
        return size / self.sum_pN if self.sum_pN > 0.0 else 0.0

    @property
    def arm(self) -> np.ndarray:
        """Places from the cell's centre (N, 3), um."""
        return self.place - self.centre

    @property
    def dipole_pN_um(self) -> np.ndarray:
        """sum r t^T in the plane (2, 2), pN um; its trace is negative for a cell that contracts."""
        return self.arm[:, :2].T @ self.force[:, :2]

    @property
    def torque_share(self) -> float:
        """|sum r x t| about the normal over sum |r| |t|."""
        return self._turning(0.0)

    @property
    def torque_imbalance_share(self) -> float:
        """|sum r x t + sum r x C v| about the normal over sum |r| |t|: 0 where couples balance."""
        return self._turning(self.drag_couple)

    def _turning(self, taken: float) -> float:
        r, t = self.arm, self.force
        size = float(np.hypot(r[:, 0], r[:, 1]) @ np.hypot(t[:, 0], t[:, 1]))
        turn = float(r[:, 0] @ t[:, 1] - r[:, 1] @ t[:, 0]) - taken
        return abs(turn) / size if size > 0.0 else 0.0

    @property
    def front_rear_pN(self) -> tuple[float, float]:
        """Net traction along the polarity of the nodes ahead of the centre, and behind it, pN.

        A cell that contracts pulls its front back (< 0) and its rear forward (> 0).
        """
        if self.polarity is None:
            raise DataError("front and rear need a polarity, and the run has none")
        axis = self.polarity[:2] / np.hypot(*self.polarity[:2])
        along, ahead = self.force[:, :2] @ axis, self.arm[:, :2] @ axis > 0.0
        return float(along[ahead].sum()), float(along[~ahead].sum())

    @property
    def strain_energy_fJ(self) -> float:
        """W = 1/2 sum t.u, fJ: the work of a linear matrix (1 pN um = 1e-3 fJ)."""
        return 0.5e-3 * float(np.vdot(self.force, self.displacement))

    def map(
        self, spacing: float = SPACING, smoothing: float = SMOOTHING, margin: float = 10.0
    ) -> TractionMap:
        """Stress in the plane on a grid around the cell, smoothed as a reconstruction would.

        Nodal forces are spread by the kernel 4 (1 - d^2/h^2)^3/(pi h^2), whose integral is 1.

        Parameters
        ----------
        spacing, smoothing, margin : float
            Of the grid, h of the kernel, and beyond the outermost traction, um.
        """
        for name, value in (("spacing", spacing), ("smoothing", smoothing)):
            if not (np.isfinite(value) and value > 0.0):
                raise ParameterError(f"{name} must be > 0 um, got {value!r}")
        if not (np.isfinite(margin) and margin >= 0.0):
            raise ParameterError(f"margin must be >= 0 um, got {margin!r}")
        loaded = np.any(self.force[:, :2] != 0.0, axis=1)
        place, force = self.place[loaded, :2], self.force[loaded, :2]
        low, high = self.centre[:2] - margin, self.centre[:2] + margin
        if loaded.any():
            low, high = (
                np.minimum(low, place.min(axis=0) - smoothing),
                np.maximum(high, place.max(axis=0) + smoothing),
            )
        x, y = (np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True))
        points = np.stack(np.meshgrid(x, y), axis=-1)
        stress = np.zeros_like(points)
        if loaded.any():
            # pN/um^2 is Pa
            near = cKDTree(points.reshape(-1, 2)).query_ball_point(place, smoothing)
            flat, at = stress.reshape(-1, 2), points.reshape(-1, 2)
            for node, found in enumerate(near):
                d2 = ((at[found] - place[node]) ** 2).sum(axis=1)
                kernel = 4.0 * (1.0 - d2 / smoothing**2) ** 3 / (np.pi * smoothing**2)
                flat[found] += kernel[:, None] * force[node]
        return TractionMap(x, y, stress)


@checked
@dataclass(frozen=True, eq=False)
class TractionMap:
    """Traction stress on a grid: x (nx,), y (ny,), um, stress (ny, nx, 2), Pa."""

    x: np.ndarray
    y: np.ndarray
    stress: np.ndarray

    @property
    def peak_Pa(self) -> float:
        """Greatest stress, Pa."""
        return float(np.hypot(self.stress[..., 0], self.stress[..., 1]).max(initial=0.0))


@checked
def tractions(run: Trajectory, cell: str = "cell1", k: int = -1) -> Tractions:
    """Tractions of a cell between the samples k - 1 and k; k -1 is the last one.

    Raises
    ------
    DataError
        A run without auxiliaries, or without this cell's ports on the matrix.
    ParameterError
        A sample before which there is no interval.
    """
    if run.eta is None or run.W_eta is None:
        raise DataError("tractions need a run recorded with auxiliaries=True")
    names = traction_ports(run, cell)
    if not names:
        raise DataError(f"{cell} puts no force on a matrix in this run")
    at = k + len(run) if k < 0 else k
    if not 1 <= at < len(run):
        raise ParameterError(f"k must be between 1 and {len(run) - 1}, or negative, got {k}")
    eta = np.asarray(run.eta[at - 1])
    force = np.sum([run.auxiliaries.view(eta, name) for name in names], axis=0)
    x, u = run.block(f"{cell}.position"), run.block("matrix.displacement")
    between = 0.5 * (u[at - 1] + u[at])
    v = (x[at] - x[at - 1]) / (run.t[at] - run.t[at - 1])
    p = None if run.p is None else run.polarities[at, _number(run, cell)]
    centre = 0.5 * (x[at - 1] + x[at]).mean(axis=0)
    drag, arm = -_drag(run, cell) * v, 0.5 * (x[at - 1] + x[at]) - centre
    return Tractions(
        force=force,
        place=run.geometry["matrix.rest"] + between,
        displacement=between,
        centre=centre,
        polarity=p,
        drag=drag.sum(axis=0),
        drag_couple=float(arm[:, 0] @ drag[:, 1] - arm[:, 1] @ drag[:, 0]),
    )


def traction_ports(run: Trajectory, cell: str) -> list[str]:
    """Blocks of eta that hold forces of this cell on the matrix."""
    return [
        b.name
        for b in run.auxiliaries
        if b.name.startswith("matrix.") and b.name.endswith(f".{cell}") and b.unit == "pN"
    ]


def _drag(run: Trajectory, cell: str) -> np.ndarray:
    """C (n, 3) of the membrane, pN s/um: the inverse of the block of W_eta of one of its ports."""
    position = run.states[f"{cell}.position"]
    port = next(
        b.name
        for b in run.auxiliaries
        if b.name.startswith(f"{cell}.") and b.unit == "pN" and b.shape == position.shape
    )
    rows, columns = run.states.slice(position.name), run.auxiliaries.slice(port)
    if run.W_eta is None:
        raise DataError("the run was stored without W_eta, which holds the drag of the cell")
    return (1.0 / sp.csr_array(run.W_eta)[rows, columns].diagonal()).reshape(-1, 3)


def _number(run: Trajectory, cell: str) -> int:
    names = [b.name.rpartition(".")[0] for b in run.states if b.name.endswith(".position")]
    return [n for n in names if "." not in n].index(cell)


@checked
def contact_area(position: np.ndarray) -> float:
    """Area of the convex hull of the nodes (n, 3) in contact, seen from above, um^2."""
    position = shaped_array(position, "position", (None, 3))
    low = position[position[:, 2] < CONTACT_HEIGHT, :2]
    try:
        return float(ConvexHull(low).volume) if len(low) > 2 else 0.0
    except QhullError:  # on one line
        return 0.0


@checked
def volume_course(run: Trajectory, cell: str = "cell1") -> np.ndarray:
    """Enclosed volume of a cell at every sample (T,), um^3."""
    triangles = run.geometry.get(f"{cell}.triangles")
    if triangles is None:
        raise DataError(f"the run does not hold the triangles of {cell}")
    faces = np.asarray(triangles, dtype=int)
    return np.array([enclosed_volume(x, faces) for x in run.block(f"{cell}.position")])


@checked
def traction_read_outs(run: Trajectory, cell: str = "cell1", k: int = -1) -> dict[str, float]:
    """`Tractions` of one interval, contact area, volume and strength of the cue as numbers.

    ``net_traction_percent`` and ``torque_percent`` are shares of the sums of magnitudes,
    ``front_pN`` and ``rear_pN`` along the polarity, ``traction_peak_Pa`` of the map,
    ``volume_least_percent`` and ``volume_greatest_percent`` of the volume at the start over the
    run, ``cue_strength`` |d| at the end; what a run does not have is left out.
    """
    return traction_numbers(tractions(run, cell, k)) | shape_numbers(run, cell)


@checked
def pulling(run: Trajectory, cell: str) -> dict[str, float]:
    """`traction_read_outs` of a run that holds tractions, else what it shows of the shape."""
    if run.eta is None or run.W_eta is None or len(run) < 2 or not traction_ports(run, cell):
        return shape_numbers(run, cell)
    return traction_read_outs(run, cell)


def traction_numbers(found: Tractions) -> dict[str, float]:
    """The numbers of one `Tractions`."""
    out = {
        "traction_sum_pN": found.sum_pN,
        "net_traction_pN": float(np.hypot(*found.net_pN[:2])),
        "net_traction_percent": 100.0 * found.net_share,
        "dipole_pN_um": float(np.trace(found.dipole_pN_um)),
        "torque_percent": 100.0 * found.torque_share,
        "strain_energy_fJ": found.strain_energy_fJ,
        "traction_peak_Pa": found.map().peak_Pa,
    }
    if found.polarity is not None:
        out["front_pN"], out["rear_pN"] = found.front_rear_pN
    return out


def shape_numbers(run: Trajectory, cell: str) -> dict[str, float]:
    """Contact area at the end, volume over the run, and strength of the cue at the end."""
    out = {"contact_area_end_um2": contact_area(run.block(f"{cell}.position")[-1])}
    if f"{cell}.triangles" in run.geometry:
        volume = volume_course(run, cell)
        out["volume_end_um3"] = float(volume[-1])
        out["volume_least_percent"] = 100.0 * float(volume.min() / volume[0])
        out["volume_greatest_percent"] = 100.0 * float(volume.max() / volume[0])
    if run.d is not None:
        d = np.asarray(run.d[-1]).reshape(-1, 3)[_number(run, cell)]
        out["cue_strength"] = float(np.hypot(*d[:2]))
    return out
