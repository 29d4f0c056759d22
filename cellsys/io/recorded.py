"""Recorded runs of other programs, and of this one in their layout, as runs and snapshots."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from cellsys.arguments import checked
from cellsys.errors import CellsysError, DataError, FileFormatError
from cellsys.io.recorded_layout import (
    C_CELL,
    C_CORTEX,
    C_MATRIX,
    CELL_COLUMNS,
    CORTEX_COLUMNS,
    KIND,
    MATRIX_COLUMNS,
    PN,
    SCHEMA,
    SIDECAR,
    UM,
    Place,
    RecordedFiles,
    Sample,
)
from cellsys.io.row_file import RowFile, array_folder
from cellsys.samples import Snapshots, snapshots
from cellsys.store.memory import check_memory
from cellsys.store.regular import open_regular
from cellsys.system import Block, Event, Layout
from cellsys.trajectory import Trajectory
from cellsys.trajectory_file import layout_of


@checked
def read_recorded(folder: str | Path | Sequence[str | Path], *, scale: str = "block") -> Snapshots:
    """Recorded runs [thesis A.1] as snapshots, which go through `cs.reduce` as those of a scene.

    Parameters
    ----------
    folder : path or list of paths
        Each holds the files of one run (`cellsys.io.recorded_layout`); they are read one sample
        after the other, and what is over 64 MB stays on disk.
    scale : {"none", "block", "column"}
        See `Snapshots`.

    Returns
    -------
    Snapshots
        See `recorded_run`.
    """
    places = [folder] if isinstance(folder, (str, Path)) else list(folder)
    if not places:
        raise DataError("folder is an empty list; give at least one recorded run")
    return snapshots([recorded_run(place) for place in places], scale=scale)


@checked
def recorded_run(folder: str | Path) -> Trajectory:
    """One recorded run as a trajectory, um, pN and s.

    With C = C_c + C_cort = 2e-3 N s/m for the cell and C_e = 1e-3 N s/m for the matrix,

        C dx/dt = F_tract + F_E + F_L - F_T + C_cort v_cort + closure,   C_e du/dt = F_tract + F_E

    over the interval that follows each sample; the closure, what the forces leave over, is the
    block ``step_residual`` (as rates). The thesis shifts it by one sample (A.2).

    Parameters
    ----------
    folder : path
        Files of other programs, or what `cs.write_recorded` wrote: then every block of that run
        is read back to the digits written.

    Returns
    -------
    Trajectory
        `source` says the share of the closure in the rates. ``geometry["cell1.bond_node"]``
        (T, n) is the bond table: of each membrane node with bonds the nearest matrix node that
        bears a traction, -1 for the others. Without a known rest the matrix is displaced from
        its first sample.

    Raises
    ------
    FileNotFoundError
    FileFormatError, DataError
        With the file, the row and the column.
    """
    place = Path(folder)
    if not place.is_dir():
        raise FileNotFoundError(f"no folder {str(place)!r}")
    told = _sidecar(place)
    files = RecordedFiles(place, told is not None)
    first = files.sample(0)
    plan = _foreign(files, first) if told is None else _own(told, files, first)
    return _read(files, plan, place)


_NO = Place("", 0, 0.0)


class _ReadPlan:
    """Blocks of a recorded run, where they stand, and their part in the rates."""

    def __init__(
        self, states: Layout, auxiliaries: Layout, places: Mapping[str, Place], W_eta: sp.csr_array
    ) -> None:
        self.states, self.auxiliaries, self.places, self.W_eta = states, auxiliaries, places, W_eta
        self.t: np.ndarray | None = None
        self.rest: np.ndarray | None = None
        self.geometry: dict[str, np.ndarray] = {}
        self.events: tuple[Event, ...] = ()
        self.observed: dict[str, tuple[int, ...]] = {}
        self.eta_start: np.ndarray | None = None
        self.label, self.source = "", {"layout": "thesis A.1"}
        self.headings = {"p": True, "d": True}
        self.inputs: tuple[str, ...] = ()

    @property
    def first_input(self) -> int:
        """Row of the file of blocks at which the exogenous rates begin."""
        kept = [b for b in (*self.states, *self.auxiliaries)
                if self.places.get(b.name, _NO).file == "blocks"]  # fmt: skip
        return sum(b.size for b in kept)

    def drive(self, sample: Sample, row: np.ndarray) -> None:
        """Fill a row of u."""
        start = self.first_input
        for name in self.inputs:
            piece = self.states.slice(name)
            row[piece] = sample.blocks[start : start + piece.stop - piece.start]
            start += piece.stop - piece.start

    def state(self, sample: Sample, row: np.ndarray) -> None:
        """Fill a row of x."""
        self._fill(sample, self.states, row)
        for i, table in enumerate(sample.cells):
            self.states.view(row, f"cell{i + 1}.position")[...] = table[:, :3] * UM
        rest = np.zeros(3) if self.rest is None else self.rest
        self.states.view(row, "matrix.displacement")[...] = sample.matrix[:, :3] * UM - rest

    def load(self, sample: Sample, row: np.ndarray) -> None:
        """Fill a row of eta, without its last block."""
        self._fill(sample, self.auxiliaries, row)

    def _fill(self, sample: Sample, layout: Layout, row: np.ndarray) -> None:
        for block in layout:
            place = self.places.get(block.name)
            if place is None:
                continue
            piece = row[layout.slice(block.name)]
            if place.file == "blocks":
                piece[:] = sample.blocks[place.column : place.column + block.size]
                continue
            table = sample.matrix
            if place.file != "matrix":
                kind, number = place.file.rstrip("0123456789"), place.file.lstrip("celortx")
                table = (sample.cells if kind == "cell" else sample.cortices)[int(number) - 1]
            width = block.size // len(table)
            values = table[:, place.column : place.column + width].ravel()
            unit = {"pN": PN, "pN ": C_CORTEX * UM}.get(block.unit, 1.0)
            piece[:] = place.sign * unit * values


def _foreign(files: RecordedFiles, first: Sample) -> _ReadPlan:
    """The plan of files that another program wrote."""
    states, auxiliaries, places, weights = [], [], {}, []
    for i, table in enumerate(first.cells):
        name, shape = f"cell{i + 1}", (len(table), 3)
        states.append(Block(f"{name}.position", shape, "um"))
        for block, file, column, sign in (
            ("lamellipodium", "cell", CELL_COLUMNS["F_L"], 1.0),
            ("membrane_elasticity", "cell", CELL_COLUMNS["F_E"], 1.0),
            ("focal_adhesion", "cell", CELL_COLUMNS["F_tract"], 1.0),
            ("cortical_tension", "cortex", CORTEX_COLUMNS["F_T"], -1.0),
            # C_cort v_cort, pN: a velocity in the file
            ("cortex", "cortex", CORTEX_COLUMNS["v_cort"], C_CORTEX * UM / PN),
        ):
            auxiliaries.append(Block(f"{name}.{block}", shape, "pN", kind="rate"))
            places[f"{name}.{block}"] = Place(f"{file}{i + 1}", column, sign)
            weights.append((f"{name}.position", 1.0 / (C_CELL + C_CORTEX)))
    shape = (len(first.matrix), 3)
    states.append(Block("matrix.displacement", shape, "um", role="field"))
    for block, quantity in (("matrix_elasticity", "F_E"), ("focal_adhesion", "F_tract")):
        auxiliaries.append(Block(f"matrix.{block}", shape, "pN", role="field", kind="rate"))
        places[f"matrix.{block}"] = Place("matrix", MATRIX_COLUMNS[quantity], 1.0)
        weights.append(("matrix.displacement", 1.0 / C_MATRIX))
    x, eta = Layout(states), Layout(auxiliaries)
    rows = np.concatenate([np.arange(x.size)[x.slice(name)] for name, _ in weights])
    values = np.concatenate([np.full(x[name].size, w) for name, w in weights])
    W = sp.csr_array((values, (rows, np.arange(eta.size))), shape=(x.size, eta.size))
    plan = _ReadPlan(x, eta, places, W)
    plan.rest = first.matrix[:, :3] * UM
    plan.geometry = {"matrix.rest": plan.rest}
    plan.source["rest"] = "places of the matrix at the first sample"
    return plan


def _sidecar(folder: Path) -> dict | None:
    if not (folder / SIDECAR).exists():
        return None
    try:
        with open_regular(folder / SIDECAR, 5e8) as file:
            told = json.loads(file.read())
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{SIDECAR} of {folder.name!r} is damaged: {error}") from error
    if not isinstance(told, dict) or (told.get("kind"), told.get("schema")) != (KIND, SCHEMA):
        raise FileFormatError(
            f"{SIDECAR} of {folder.name!r} is not that of a recorded run, schema {SCHEMA}; remove "
            "it to read the files as those of another program"
        )
    return told


def _own(told: dict, files: RecordedFiles, first: Sample) -> _ReadPlan:
    """The plan of files that `cs.write_recorded` wrote."""
    try:
        states = layout_of(told["states"], "the states")
        auxiliaries = layout_of(told["auxiliaries"], "the auxiliaries")
        places = {k: Place(str(f), int(c), float(s)) for k, (f, c, s) in told["places"].items()}
        W = sp.lil_array((states.size, auxiliaries.size))
        for name, entries in told["W_eta"].items():
            start = auxiliaries.slice(name).start
            for i, j, value in entries:
                W[int(i), start + int(j)] = float(value)
        plan = _ReadPlan(states, auxiliaries, places, sp.csr_array(W))
        plan.t = np.array(told["t"], dtype=float)
        plan.geometry = {k: np.asarray(v) for k, v in told["geometry"].items()}
        plan.rest = np.asarray(plan.geometry["matrix.rest"], dtype=float)
        plan.events = tuple(Event(float(t), str(n), str(d)) for t, n, d in told["events"])
        plan.observed = {k: tuple(int(n) for n in s) for k, s in told["observed"].items()}
        plan.label, plan.source = str(told["label"]), dict(told["source"])
        plan.headings = {k: bool(v) for k, v in told["headings"].items()}
        if told["eta_start"]:
            start_of = told["eta_start"]
            plan.eta_start = np.concatenate([np.array(start_of[b.name]) for b in auxiliaries])
        plan.inputs = tuple(str(name) for name in told["inputs"])
        driven = sum(states[name].size for name in plan.inputs)
        more = sum(int(np.prod(s)) for s in plan.observed.values())
        if len(first.blocks) != plan.first_input + driven + more + 1 or len(plan.t) != len(
            files.stamps
        ):
            raise DataError("samples or blocks are missing")
        for i, table in enumerate(first.cells):
            if states[f"cell{i + 1}.position"].shape != (len(table), 3):
                raise DataError(f"cell{i + 1} has another number of nodes")
        if plan.rest.shape != (len(first.matrix), 3):
            raise DataError("the matrix has another number of nodes")
        return plan
    except (LookupError, TypeError, ValueError, AttributeError, CellsysError) as error:
        raise FileFormatError(
            f"{SIDECAR} of {files.folder.name!r} does not fit its files: {error}; write the run "
            "again, or remove it to read the files as those of another program"
        ) from error


def _read(files: RecordedFiles, plan: _ReadPlan, folder: Path) -> Trajectory:
    t = files.t if plan.t is None else plan.t
    if len(t) < 3:
        raise DataError(f"{folder.name!r} has {len(t)} samples; a run needs at least three")
    n, n_eta, T = plan.states.size, plan.auxiliaries.size, len(t)
    size = 8.0 * T * (2 * n + n_eta)
    p, d, bonds, observed = [], [], [], []
    share = np.zeros(2)
    with array_folder(folder.name, size) as place:
        if place is None:
            check_memory(size, f"the recorded run {folder.name!r} needs", "leave samples out")
        x = RowFile(place, "x", (T, n))
        eta = RowFile(place, "eta", (T - 1, n_eta + n))
        u = RowFile(place, "u", (T - 1, n)) if plan.inputs else None
        now, before, loads, push = np.zeros(n), np.zeros(n), np.zeros(n_eta + n), np.zeros(n)
        for k in range(T):
            sample = files.sample(k)
            plan.state(sample, now)
            if k > 0:
                rate = (now - before) / (t[k] - t[k - 1])
                loads[n_eta:] = rate - plan.W_eta @ loads[:n_eta] - push
                share += np.sum(loads[n_eta:] ** 2), np.sum(rate**2)
                eta.add(loads)
                if u is not None:
                    u.add(push)
            x.add(now)
            before[:] = now
            plan.load(sample, loads)
            plan.drive(sample, push)
            p.append(sample.polarity)
            d.append(sample.direction)
            bonds.append(_bonds(sample))
            more = sum(int(np.prod(s)) for s in plan.observed.values())
            observed.append(sample.blocks[len(sample.blocks) - 1 - more : -1])
        seen, start = {}, 0
        for name, shape in plan.observed.items():
            width = int(np.prod(shape))
            seen[name] = np.array(observed)[:, start : start + width].reshape(T, *shape)
            start += width
        residual = Block("step_residual", (n,), "state/s", kind="rate")
        eta_start = plan.eta_start
        run = Trajectory(
            t=t, x=x.whole(), eta=eta.whole(), states=plan.states,
            auxiliaries=plan.auxiliaries + Layout([residual]),
            W_x=sp.csr_array((n, n)), u=None if u is None else u.whole(),
            W_eta=sp.csr_array(sp.hstack([plan.W_eta, sp.eye_array(n)])),
            p=np.array(p) if plan.headings["p"] else None,
            d=np.array(d) if plan.headings["d"] else None,
            amplitude=seen.get("amplitude"), virial=seen.get("virial"),
            stiffness=seen.get("stiffness"),
            eta_start=None if eta_start is None else np.append(eta_start, np.zeros(n)),
            events=plan.events, label=plan.label or folder.name,
            geometry=plan.geometry | _bond_table(bonds),
            source={**plan.source, "file": folder.name, "closure_share": _share(share)},
        )  # fmt: skip
    return run


def _share(squares: np.ndarray) -> float:
    """Rms of the closure over rms of the rates."""
    return float(np.sqrt(squares[0] / squares[1])) if squares[1] > 0 else 0.0


def _bonds(sample: Sample) -> list[np.ndarray]:
    """Matrix node of every membrane node with bonds, -1 of the others, by cell [thesis A.1]."""
    force = sample.matrix[:, MATRIX_COLUMNS["F_tract"] :][:, :3]
    loaded = np.flatnonzero(np.any(np.nan_to_num(force) != 0.0, axis=1))
    found = []
    for table in sample.cells:
        nodes = np.full(len(table), -1)
        bound = np.flatnonzero(table[:, CELL_COLUMNS["n_b"]] > 0)
        if loaded.size and bound.size:
            tree = cKDTree(sample.matrix[loaded, :3])
            nodes[bound] = loaded[tree.query(table[bound, :3])[1]]
        found.append(nodes)
    return found


def _bond_table(bonds: list[list[np.ndarray]]) -> dict[str, np.ndarray]:
    return {
        f"cell{i + 1}.bond_node": np.array([row[i] for row in bonds]) for i in range(len(bonds[0]))
    }
