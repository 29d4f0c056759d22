"""`observe`: one table of read-outs for a full-order run, a reduced run, tracks and masks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from cellsys.arguments import checked
from cellsys.contours import CellOutlines
from cellsys.errors import DataError, ParameterError
from cellsys.geometry.membrane import enclosed_volume
from cellsys.geometry.surface import contour, gap
from cellsys.model.latent import LatentModel
from cellsys.observe.motion import mean_squares, movement, persistence
from cellsys.observe.polygons import contour_shape, directionality_deg
from cellsys.observe.table import ReadOutTable
from cellsys.observe.top_view import top_view
from cellsys.observe.tractions import Tractions, traction_ports
from cellsys.tracks import Tracks
from cellsys.trajectory import Trajectory, cell_names
from cellsys.units import real_number

_MANY = 20  # cells above which pairs are read only within a distance that is given


@checked
def observe(
    what: Trajectory | Tracks | CellOutlines,
    *,
    model: LatentModel | None = None,
    within: float | None = None,
) -> ReadOutTable:
    """Read-outs per cell and time and per pair and time, alike for a model and an experiment.

    Each has one definition: contours are seen from above (`top_view`, masks), area, centroid and
    principal axis are those of the polygon (`contour_shape`), the contour distance is the least
    distance of two contours, negative where they overlap (`contour_gap`), the movement goes from
    centroid to centroid of following samples, and the directionality is the mean of axis and
    movement [thesis B.2].

    Parameters
    ----------
    what : Trajectory, Tracks or CellOutlines
        A run (full-order, or reduced and reconstructed), tracks (points: no contours), or the
        contours of masks.
    model : LatentModel, optional
        Of a reduced run, whose latent states it reconstructs.
    within : float, optional
        Read only pairs whose centroids come as near as this at some time, in the unit of length;
        default: all pairs of up to 20 cells, none of more.

    Returns
    -------
    ReadOutTable

    Raises
    ------
    DataError
        A run without cells, or a latent one without its model.
    """
    if within is not None and not real_number(within, "within") > 0:
        raise ParameterError(f"within must be > 0, got {within!r}")
    if isinstance(what, Trajectory):
        run = what if model is None else _reconstructed(what, model)
        if "z[0]" in run.states.names or not cell_names(run.states):
            raise DataError(
                "this run holds no cell with a membrane; of a reduced run give its model: "
                "observe(run, model=model)"
            )
        outlines = top_view(run)
        return _table(outlines, _paths_of(outlines), within, _forces(run), what.label)
    if model is not None:
        raise ParameterError("model: only a reduced run has one; leave it out")
    if isinstance(what, CellOutlines):
        return _table(what, _paths_of(what), within, {}, str(what.source.get("file", "")))
    paths = {c: (what.times(c), what.path(c), what.frame[what.cells[c]]) for c in what.cells}
    return _table(what, paths, within, {}, str(what.source.get("file", "")))


_Path = tuple[np.ndarray, np.ndarray, np.ndarray]  # times, places, frames


def _reconstructed(run: Trajectory, model: LatentModel) -> Trajectory:
    if model.states is None:
        raise DataError("the model has no names of states; reduce from snapshots of a scene")
    z = [b for b in run.states if b.name == "z"]
    if not z or z[0].size != model.order:
        raise DataError(
            f"a run of this model has {model.order} latent states z, this one "
            f"{[b.name for b in run.states][:4]}"
        )
    x = model.reconstruct(run.block("z"))
    return replace(
        run, x=x, states=model.states, eta=None, u=None, auxiliaries=type(model.states)(),
        W_x=None, W_eta=None, eta_start=None, virial=None, stiffness=None, estimator=None,
        events=(),
    )  # fmt: skip


def _paths_of(outlines: CellOutlines) -> dict[str, _Path]:
    paths = {}
    for name in outlines.names:
        rows = outlines.rows(name)
        centres = np.array([contour_shape(outlines.outline[k]).centroid for k in rows])
        paths[name] = (outlines.t[rows], centres, outlines.frame[rows])
    return paths


def _table(
    what: CellOutlines | Tracks,
    paths: Mapping[str, _Path],
    within: float | None,
    forces: Mapping[str, Mapping[str, np.ndarray]],
    label: str,
) -> ReadOutTable:
    L, s = what.length_unit, what.time_unit
    time = f"t_{s}"
    columns: dict[str, list[np.ndarray]] = {}
    motion: dict[str, list[object]] = {}
    heading: dict[str, np.ndarray] = {}
    for name, (t, place, _) in paths.items():
        moved = movement(t, place) if len(t) > 1 else None
        nothing = np.full(len(t), np.nan)
        direction = nothing if moved is None else moved.direction_deg
        row: dict[str, np.ndarray] = {
            "cell": np.full(len(t), name, dtype=object), time: t,
            f"x_{L}": place[:, 0], f"y_{L}": place[:, 1],
        }  # fmt: skip
        heading[name] = direction
        if isinstance(what, CellOutlines):
            shapes = [contour_shape(what.outline[k]) for k in what.rows(name)]
            axis = np.array([s.axis_deg for s in shapes])
            heading[name] = directionality_deg(axis, direction)
            row |= {
                f"area_{L}2": np.array([s.area for s in shapes]),
                f"perimeter_{L}": np.array([s.perimeter for s in shapes]),
                "elongation_axis_deg": axis,
                "aspect_ratio": np.array([s.aspect_ratio for s in shapes]),
            }
        row["movement_direction_deg"] = direction
        if isinstance(what, CellOutlines):
            row["directionality_deg"] = heading[name]
        row[f"speed_{L}_{s}"] = nothing if moved is None else moved.speed
        row |= forces.get(name, {})
        for key, values in row.items():
            columns.setdefault(key, []).append(np.asarray(values))
        for key, value in _motion(name, t, place, L, s).items():
            motion.setdefault(key, []).append(value)
    return ReadOutTable(
        cells={k: np.concatenate(v) for k, v in columns.items()}
        or {"cell": np.zeros(0, dtype=object), time: np.zeros(0)},
        pairs=_pairs(what, paths, heading, within),
        motion={k: np.array(v, dtype=object if k == "cell" else float) for k, v in motion.items()},
        msd=mean_squares({name: (t, place) for name, (t, place, _) in paths.items()}),
        length_unit=L,
        time_unit=s,
        source={"of": label, **dict(what.source)},
    )


def _motion(name: str, t: np.ndarray, place: np.ndarray, L: str, s: str) -> dict[str, object]:
    steps = np.linalg.norm(np.diff(place, axis=0), axis=1)
    kept = persistence(t, place)
    return {
        "cell": name,
        f"mean_speed_{L}_{s}": float(steps.sum() / (t[-1] - t[0])) if len(t) > 1 else np.nan,
        f"path_length_{L}": float(steps.sum()),
        f"net_displacement_{L}": float(np.linalg.norm(place[-1] - place[0])),
        "persistence_ratio": kept.ratio,
        f"persistence_time_{s}": kept.time,
    }


def _pairs(
    what: CellOutlines | Tracks,
    paths: Mapping[str, _Path],
    heading: Mapping[str, np.ndarray],
    within: float | None,
) -> dict[str, np.ndarray]:
    if within is None and len(paths) > _MANY:
        return {}
    L, s = what.length_unit, what.time_unit
    columns: dict[str, list[np.ndarray]] = {}
    for first, second in combinations(paths, 2):
        (t, p, frames), (_, q, others) = paths[first], paths[second]
        _, i, j = np.intersect1d(frames, others, return_indices=True)
        way = q[j, :2] - p[i, :2]
        apart = np.linalg.norm(q[j] - p[i], axis=1)
        if not i.size or (within is not None and not apart.min() <= within):
            continue
        bearing = np.degrees(np.arctan2(way[:, 1], way[:, 0]))
        row: dict[str, np.ndarray] = {
            "first": np.full(len(i), first, dtype=object),
            "second": np.full(len(i), second, dtype=object),
            f"t_{s}": t[i],
            f"centroid_distance_{L}": apart,
        }
        if isinstance(what, CellOutlines):
            a, b = what.rows(first)[i], what.rows(second)[j]
            row[f"contour_distance_{L}"] = np.array(
                [gap(contour(what.outline[m]), contour(what.outline[n]))
                 for m, n in zip(a, b, strict=True)]
            )  # fmt: skip
        row["first_to_second_deg"] = _between(heading[first][i], bearing)
        row["second_to_first_deg"] = _between(heading[second][j], bearing + 180.0)
        for key, values in row.items():
            columns.setdefault(key, []).append(values)
    return {key: np.concatenate(values) for key, values in columns.items()}


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between directions, deg in [0, 180]."""
    return np.asarray(np.abs((a - b + 180.0) % 360.0 - 180.0))


def _forces(run: Trajectory) -> dict[str, dict[str, np.ndarray]]:
    """Read-outs of the forces of every cell: of the interval after each sample, NaN at the last."""
    found: dict[str, dict[str, np.ndarray]] = {}
    for number, name in enumerate(cell_names(run.states)):
        row: dict[str, np.ndarray] = {}
        faces = run.geometry.get(f"{name}.triangles")
        if faces is not None:
            triangles = np.asarray(faces, dtype=int)
            places = run.block(f"{name}.position")
            row["volume_um3"] = np.array([enclosed_volume(x, triangles) for x in places])
        if run.eta is not None and (ports := traction_ports(run, name)):
            row |= _tractions(run, name, ports)
        if run.d is not None:
            d = np.asarray(run.d).reshape(len(run), -1, 3)
            if number < d.shape[1]:
                row["cue_strength"] = np.hypot(d[:, number, 0], d[:, number, 1])
        found[name] = row
    names = set.intersection(*(set(row) for row in found.values()))
    return {cell: {k: v for k, v in row.items() if k in names} for cell, row in found.items()}


def _tractions(run: Trajectory, name: str, ports: list[str]) -> dict[str, np.ndarray]:
    keys = ("traction_sum_pN", "net_traction_pN", "net_traction_percent", "dipole_pN_um",
            "strain_energy_fJ")  # fmt: skip
    values = np.full((len(run), len(keys)), np.nan)
    rest = run.geometry.get("matrix.rest")
    if rest is None or "matrix.displacement" not in run.states:
        return {}
    x, u = run.block(f"{name}.position"), run.block("matrix.displacement")
    for k in range(len(run) - 1):
        between = 0.5 * (u[k] + u[k + 1])
        force = sum((run.auxiliary(port)[k] for port in ports), np.zeros_like(between))
        told = Tractions(
            force=force, place=rest + between, displacement=between,
            centre=0.5 * (x[k] + x[k + 1]).mean(axis=0), polarity=None, drag=np.zeros(3),
        )  # fmt: skip
        values[k] = (
            told.sum_pN,
            float(np.hypot(*told.net_pN[:2])),
            100.0 * told.net_share,
            float(np.trace(told.dipole_pN_um)),
            told.strain_energy_fJ,
        )
    return dict(zip(keys, values.T, strict=True))
