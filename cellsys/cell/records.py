"""What the equivariant reductor reads from snapshots: one record per cell and run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.cell.port import Footprint, PolarPort, PortSites
from cellsys.errors import DataError, ParameterError
from cellsys.samples.snapshots import RunData, Snapshots
from cellsys.trajectory import cell_names


@dataclass(frozen=True, eq=False, kw_only=True)
class CellRecord:
    """One cell of one run on the grid of the model's step.

    Parameters
    ----------
    nodes : (K + 1, n, 3)
        um.
    loads : list of K + 1 dict
        Charges of the load density at the grid times: mean of the intervals before and after.
    velocity : list of K dict
        Charges of the matrix velocity gathered over each step at the centroid of its start.
    amplitude, heading : (K,)
        Means over each step.
    label : str
    """

    nodes: np.ndarray
    loads: list[dict[int, np.ndarray]]
    velocity: list[dict[int, np.ndarray]]
    amplitude: np.ndarray
    heading: np.ndarray
    run: int
    cell: str
    label: str

    @property
    def centers(self) -> np.ndarray:
        """Centroid in the plane (K + 1, 2), um."""
        return self.nodes.mean(axis=1)[:, :2]

    @property
    def steps(self) -> int:
        """K."""
        return len(self.amplitude)


def stride(data: Snapshots, step: float) -> int:
    """Samples per step of the model; refused where the step is no multiple of the sampling."""
    ratio = step / data.dt
    if ratio < 0.999 or abs(ratio - round(ratio)) > 1e-6:
        raise ParameterError(
            f"step = {step:g} s must be a multiple of the sampling interval {data.dt:g} s; "
            "change step or sample the runs differently"
        )
    return round(ratio)


def sites_of(data: Snapshots) -> PortSites:
    """Where loads act, from the rest places that the runs carry."""
    missing = [k for k in ("matrix.rest", "matrix.surface") if k not in data.geometry]
    if missing or "matrix.displacement" not in data.states:
        raise DataError(
            "an equivariant model needs cells on a matrix with its rest places: "
            f"{', '.join(missing) or 'state block matrix.displacement'} is missing; use runs of a "
            "scene with a [matrix], or give snapshots a geometry"
        )
    return PortSites.of(data.geometry["matrix.rest"], data.geometry["matrix.surface"])


def read_records(
    data: Snapshots, step: float, port: PolarPort, sites: PortSites | None = None
) -> list[CellRecord]:
    """Records of every cell in every run.

    Raises
    ------
    DataError
        Where commands, auxiliaries or the places of the matrix are missing.
    """
    sites = sites_of(data) if sites is None else sites
    return [
        _record(data, run, k, name, stride(data, step), port, sites)
        for k, run in enumerate(data.runs)
        for name in cell_names(data.states)
    ]


def _record(
    data: Snapshots,
    run: RunData,
    index: int,
    name: str,
    every: int,
    port: PolarPort,
    sites: PortSites,
) -> CellRecord:
    label = f"{run.label or f'run {index}'}, {name}"
    if run.commands is None or f"{name}.amplitude" not in data.command_names:
        raise DataError(f"{label}: no commands (heading and amplitude) were recorded")
    if run.eta is None:
        raise DataError(f"{label}: recorded without auxiliaries, so its load is unknown")
    steps = (len(run.x) - 1) // every
    if steps < 2:
        raise DataError(f"{label}: {len(run.x)} samples are fewer than two steps of the model")
    grid = every * np.arange(steps + 1)
    x = np.asarray(run.x)
    nodes = data.states.view(x, f"{name}.position")[grid]
    centre = nodes.mean(axis=1)
    moved = data.states.view(x, "matrix.displacement")[grid]
    under = [sites.under(at, port) for at in centre]
    loads = _loads(data, run, name, grid, under)
    dt = every * data.dt
    velocity = [
        under[k].gather((moved[k + 1] - moved[k])[under[k].nodes] / dt) for k in range(steps)
    ]
    table = data.commands_of(run, tuple(f"{name}.{c}" for c in ("amplitude", "cos", "sin")))
    if table is None:
        raise DataError(f"{label}: no commands (heading and amplitude) were recorded")
    mean = table[: steps * every].reshape(steps, every, 3).mean(axis=1)
    run.release()
    return CellRecord(
        nodes=nodes,
        loads=loads,
        velocity=velocity,
        amplitude=mean[:, 0],
        heading=np.arctan2(mean[:, 2], mean[:, 1]),
        run=index,
        cell=name,
        label=label,
    )


def _loads(
    data: Snapshots,
    run: RunData,
    name: str,
    grid: np.ndarray,
    under: list[Footprint],
) -> list[dict[int, np.ndarray]]:
    """Load of one cell at the grid times."""
    blocks = [
        b.name
        for b in data.auxiliaries
        if b.name.startswith("matrix.") and b.name.endswith(f".{name}") and b.unit == "pN"
    ]
    if not blocks:
        raise DataError(
            f"no load of {name} on the matrix among the auxiliaries; the scene needs an adhesion"
        )
    eta = run.eta  # as it is: of columns on disk only the asked ones are read
    if eta is None:
        raise DataError(f"{run.label}: no auxiliaries were recorded, hence no load of {name}")
    columns = [data.auxiliaries.slice(b) for b in blocks]
    last = len(run.x) - 2
    loads = []
    for k, footprint in zip(grid, under, strict=True):
        around = slice(max(k - 1, 0), min(k, last) + 1)
        if k == 0 and run.eta_start is not None:
            parts = [np.asarray(run.eta_start)[c] for c in columns]
        else:
            parts = [np.mean(eta[around, c], axis=0) for c in columns]
        force = sum(parts, start=np.zeros(()))
        loads.append(footprint.load(force.reshape(-1, 3)))
    return loads
