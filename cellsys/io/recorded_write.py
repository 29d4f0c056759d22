"""A run written in the layout of the thesis's recorded runs (`cellsys.io.recorded_layout`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.errors import DataError, ParameterError
from cellsys.io.recorded_layout import (
    C_CELL,
    CELL_COLUMNS,
    CORTEX_COLUMNS,
    KIND,
    MATRIX_COLUMNS,
    PN,
    SCHEMA,
    SIDECAR,
    UM,
    Place,
)
from cellsys.kinds import Count
from cellsys.store.atomic import write_json, write_text
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory, cell_names
from cellsys.trajectory_file import layout_table, plain, provenance

_COLUMN_OF = {  # effect -> quantity of the layout; every other force of a cell is in F_E
    "lamellipodium": "F_L",
    "protrusion": "F_L",
    "focal_adhesion": "F_tract",
    "stochastic_adhesion": "F_tract",
    "adhesion": "F_tract",
    "cortical_tension": "F_T",
}


@checked
def write_recorded(run: Trajectory, folder: str | Path, *, digits: Count = 9) -> Path:
    """Write a run with its loads as recorded files, one per sample and kind [thesis A.1].

    Adhesion is F_tract, the lamellipodium's force F_L, cortical tension -F_T, and the sum of all
    other forces of the cell F_E; what adhesion puts on the matrix is its F_tract, the sum of its
    other forces F_E, with its reaction on a node that is held. The velocity v is that of the
    following interval, and a force its average over it, so that the last sample has none: ``nan``
    stands there. What the layout has no column of its own for (the parts of a sum, bond states,
    amplitudes) goes into ``Blocks_<t>_s.sav``.

    Parameters
    ----------
    run : Trajectory
        With auxiliaries, cells with a membrane and ``matrix.displacement``.
    folder : path
        New or empty.
    digits : int
        Decimals of a number; `cs.read_recorded` gives the run back to these.

    Raises
    ------
    DataError
        A run without loads, cells or a matrix, or with another layout of forces.
    ParameterError
        A folder that holds something, or digits above 17.
    """
    out = Path(folder)
    if not 1 <= digits <= 17:
        raise ParameterError(f"digits must be between 1 and 17, got {digits}")
    if out.exists() and any(out.iterdir()):
        raise ParameterError(f"folder {str(out)!r} is not empty; give a new one")
    names = cell_names(run.states)
    if run.eta is None or run.W_eta is None or run.W_x is None:
        raise DataError("a recorded run needs the loads; simulate with auxiliaries=True")
    if not names or "matrix.displacement" not in run.states or "matrix.rest" not in run.geometry:
        raise DataError("a recorded run needs cells with a membrane on a matrix of nodes")
    if run.W_x.nnz:
        raise DataError("a run with a linear rate W_x x has no place for it among recorded forces")
    stamps = [f"{t:.6f}" for t in run.t]
    if len(set(stamps)) < len(stamps) or run.t[0] < 0:
        raise DataError("recorded files name their sample by t >= 0 s to 1e-6 s; sample less often")
    out.mkdir(parents=True, exist_ok=True)
    plan = _WritePlan(run, names)
    write = _Writer(run, plan, names, digits)
    for k, stamp in enumerate(stamps):
        write.sample(out, k, stamp)
    write_json(out / SIDECAR, _described(run, plan, names, digits))
    return out


class _WritePlan:
    """Where every learned block of a run goes, and which blocks add up to a column."""

    def __init__(self, run: Trajectory, names: list[str]) -> None:
        # What has no column of its own stands in a file of its own, one number a row.
        self.states = [b for b in run.states if b.role != "controller" and b.kind != "label"]
        left_out = {f"{b.name}.rate" for b in run.states if b not in self.states}
        self.auxiliaries = [
            b for b in run.auxiliaries
            if b.name != "step_residual" and b.role != "controller" and b.name not in left_out
        ]  # fmt: skip
        self.sums: dict[tuple[str, int], list[str]] = {}
        for block in self.auxiliaries:
            owner = block.name.partition(".")[0]
            if block.unit != "pN" or block.shape != _nodes(run, owner, names):
                continue
            at = _column(owner, block.name, names)
            self.sums.setdefault(at, []).append(block.name)
        for i, name in enumerate(names):
            bonds = f"{name}.bond_strength"
            if bonds in run.states and run.states[bonds].shape == _nodes(run, name, names)[:1]:
                self.sums[f"cell{i + 1}", CELL_COLUMNS["n_b"]] = [bonds]
        places = [*(f"{name}.position" for name in names), "matrix.displacement"]
        self.places: dict[str, Place] = {}
        self.blocks: list[Block] = []
        self.held = _held(run, self.sums)
        elastic = ("matrix", MATRIX_COLUMNS["F_E"])
        alone = {
            found[0]: place
            for place, found in self.sums.items()
            if len(found) == 1 and not (place == elastic and self.held.any())
        }
        row = 0
        for block in [*self.states, *self.auxiliaries]:
            if block.name in places:
                continue
            if block.name in alone:
                file, column = alone[block.name]
                self.places[block.name] = Place(file, column, _sign(file))
                continue
            self.places[block.name] = Place("blocks", row, 1.0)
            self.blocks.append(block)
            row += block.size
        driven = np.zeros(run.states.size, bool)
        if run.u is not None:
            for start in range(0, len(run.u), 128):
                driven |= np.any(run.u[start : start + 128] != 0, axis=0)
        self.inputs = [b for b in self.states if driven[run.states.slice(b.name)].any()]
        self.drag = {f"{name}.position": _drag(run, name) for name in names}


def _nodes(run: Trajectory, owner: str, names: list[str]) -> tuple[int, ...]:
    """Shape of a force on every node of a cell or the matrix."""
    if owner in names:
        return run.states[f"{owner}.position"].shape
    return run.states["matrix.displacement"].shape if owner == "matrix" else ()


def _held(run: Trajectory, sums: dict[tuple[str, int], list[str]]) -> np.ndarray:
    """Which matrix nodes (N,) no force moves."""
    rows = run.states.slice("matrix.displacement")
    moved = np.zeros(rows.stop - rows.start, bool)
    for (file, _), names in sums.items():
        for name in names if file == "matrix" else ():
            part = _weights(run)[rows, run.auxiliaries.slice(name)]
            moved |= np.diff(part.indptr) > 0
    return np.asarray(~moved.reshape(-1, 3).any(axis=1))


def _column(owner: str, name: str, names: list[str]) -> tuple[str, int]:
    """File and first column (of those that are read) of a force."""
    effect = name.split(".")[1]
    quantity = _COLUMN_OF.get(effect, "F_E")
    if owner == "matrix":
        return "matrix", MATRIX_COLUMNS["F_tract" if quantity == "F_tract" else "F_E"]
    number = names.index(owner) + 1
    if quantity == "F_T":
        return f"cortex{number}", CORTEX_COLUMNS["F_T"]
    return f"cell{number}", CELL_COLUMNS[quantity]


def _sign(file: str) -> float:
    """-1 for F_T, which the thesis subtracts."""
    return -1.0 if file.startswith("cortex") else 1.0


class _Writer:
    """Text of the files of a sample."""

    def __init__(self, run: Trajectory, plan: _WritePlan, names: list[str], digits: int) -> None:
        self.run, self.plan, self.names = run, plan, names
        self.number = f"%.{digits}e"

    def _value(self, name: str, k: int) -> np.ndarray:
        """A state at sample k, or a load over the interval after it (nan after the last)."""
        if name in self.run.states:
            return np.asarray(self.run.states.view(np.asarray(self.run.x[k]), name))
        if self.run.eta is None or k >= len(self.run.eta):
            return np.full(self.run.auxiliaries[name].shape, np.nan)
        return np.asarray(self.run.auxiliaries.view(np.asarray(self.run.eta[k]), name))

    def _input(self, name: str, k: int) -> np.ndarray:
        """The exogenous rate of a state block over the interval after sample k."""
        u = self.run.u
        if u is None or k >= len(u):
            return np.full(self.run.states[name].shape, np.nan)
        return np.asarray(self.run.states.view(np.asarray(u[k]), name))

    def _velocity(self, name: str, k: int) -> np.ndarray:
        if k + 1 >= len(self.run):
            return np.full(self.run.states[name].shape, np.nan)
        moved = self._value(name, k + 1) - self._value(name, k)
        return moved / (self.run.t[k + 1] - self.run.t[k])

    def _rows(self, whole: list[int], table: np.ndarray) -> str:
        """Rows of a table whose columns `whole` hold whole numbers."""
        form = " ".join("%d" if c in whole else self.number for c in range(table.shape[1]))
        return ((form + "\n") * len(table)) % tuple(table.ravel().tolist())

    def _filled(self, table: np.ndarray, file: str, k: int, shift: int) -> None:
        """Add the blocks of every column of a kind of file; `shift`: columns that are not read."""
        for (where, column), names in self.plan.sums.items():
            if where != file:
                continue
            bonds = file.startswith("cell") and column == CELL_COLUMNS["n_b"]
            for name in names:
                value = self._value(name, k).reshape(len(table), -1)
                first = column + shift
                table[:, first : first + value.shape[1]] += (
                    value if bonds else _sign(file) * value / PN
                )

    def sample(self, out: Path, k: int, stamp: str) -> None:
        """Write the files of sample k."""
        run = self.run
        for i, name in enumerate(self.names):
            x = self._value(f"{name}.position", k)
            cell, cortex = np.zeros((len(x), 17)), np.zeros((len(x), 7))
            cell[:, 0] = cortex[:, 0] = np.arange(1, len(x) + 1)
            cell[:, 1:4] = x / UM
            cell[:, 4:7] = self._velocity(f"{name}.position", k) / UM
            # The medium drags C_c + C_cort alike; a cortex that moves on its own is no state here.
            self._filled(cell, f"cell{i + 1}", k, 4)
            self._filled(cortex, f"cortex{i + 1}", k, 1)
            if f"{name}.position" in [b.name for b in self.plan.inputs]:  # a prescribed force
                drag = self.plan.drag[f"{name}.position"]
                cell[:, 7:10] += drag * self._input(f"{name}.position", k) / PN
            head = np.zeros((2, 3))
            for row, values in enumerate((run.p, run.d)):
                if values is not None:
                    head[row] = np.asarray(values[k]).reshape(-1, 3)[i]
            text = self._rows([], head) + self._rows([0], cell)
            write_text(out / f"Cell_{i + 1}_{stamp}_s.sav", text)
            write_text(out / f"Cortical_{i + 1}_{stamp}_s.sav", self._rows([0], cortex))
        u = self._value("matrix.displacement", k)
        matrix = np.zeros((len(u), 17))
        matrix[:, 0] = matrix[:, 1] = np.arange(1, len(u) + 1)
        matrix[:, 2:5] = (run.geometry["matrix.rest"] + u) / UM
        matrix[:, 5:8] = self._velocity("matrix.displacement", k) / UM
        self._filled(matrix, "matrix", k, 5)
        # A node that is held bears its reaction too: nothing is left over there.
        matrix[self.plan.held, 8:11] = -matrix[self.plan.held, 11:14]
        matrix[:, 14:17] = C_CELL * UM / PN * matrix[:, 5:8]
        text = f"{len(u)}\n" + self._rows([0, 1], matrix)
        write_text(out / f"ECM_fiber_{stamp}_s.sav", text)
        rest = [self._value(b.name, k).ravel() for b in self.plan.blocks]
        driven = [self._input(b.name, k).ravel() for b in self.plan.inputs]
        more = [np.asarray(values[k]).ravel() for values in observed(run).values()]
        flat = np.concatenate([*rest, *driven, *more, [0.0]])
        write_text(out / f"Blocks_{stamp}_s.sav", self._rows([], flat[:, None]))


def _described(
    run: Trajectory, plan: _WritePlan, names: list[str], digits: int
) -> dict[str, object]:
    kept = [np.arange(run.states.size)[run.states.slice(b.name)] for b in plan.states]
    where = np.full(run.states.size, -1)
    where[np.concatenate(kept)] = np.arange(sum(len(rows) for rows in kept))
    W = {b.name: _entries(run, b.name, where) for b in plan.auxiliaries}
    return {
        "kind": KIND,
        "schema": SCHEMA,
        "digits": digits,
        "cells": names,
        "label": run.label,
        "states": layout_table(Layout(plan.states)),
        "auxiliaries": layout_table(Layout(plan.auxiliaries)),
        "places": {name: list(place) for name, place in plan.places.items()},
        "W_eta": W,
        "inputs": [b.name for b in plan.inputs],
        "headings": {"p": run.p is not None, "d": run.d is not None},
        "observed": {name: list(np.shape(values)[1:]) for name, values in observed(run).items()},
        "t": [float(t) for t in run.t],
        "eta_start": {
            b.name: run.auxiliaries.view(np.asarray(run.eta_start), b.name).ravel().tolist()
            for b in plan.auxiliaries
            if run.eta_start is not None
        },
        "events": [list(e) for e in run.events],
        "geometry": {k: plain(np.asarray(v)) for k, v in run.geometry.items()},
        "source": provenance(run.source),
    }


def _weights(run: Trajectory) -> sp.csr_array:
    """W_eta of a run that has it."""
    if run.W_eta is None:
        raise DataError("a recorded run needs the loads; simulate with auxiliaries=True")
    return sp.csr_array(run.W_eta)


def _drag(run: Trajectory, name: str) -> float:
    """C_c + C_cort, pN s/um: the inverse of what a force of the cell adds to its rates."""
    rows = run.states.slice(f"{name}.position")
    for block in run.auxiliaries:
        if block.name.startswith(f"{name}.") and block.unit == "pN":
            part = _weights(run)[rows, run.auxiliaries.slice(block.name)]
            if part.nnz:
                return float(1.0 / part.data[0])
    raise DataError(f"no force acts on {name} in this run; nothing can be recorded of it")


def observed(run: Trajectory) -> dict[str, np.ndarray]:
    """What a run holds at its samples beside states and headings."""
    found = {"amplitude": run.amplitude, "virial": run.virial, "stiffness": run.stiffness}
    return {name: np.asarray(v) for name, v in found.items() if v is not None}


def _entries(run: Trajectory, name: str, where: np.ndarray) -> list[list[float]]:
    """[state, entry of the block, value] of a block's part of W_eta, learned states counted."""
    columns = _weights(run)[:, run.auxiliaries.slice(name)].tocoo()
    rows, entries = columns.coords
    return [
        [int(where[i]), int(j), float(v)]
        for i, j, v in zip(rows, entries, columns.data, strict=True)
        if where[i] >= 0
    ]
