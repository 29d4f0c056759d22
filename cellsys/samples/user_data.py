"""Snapshots from a user's own simulator: arrays, npz or csv files."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from cellsys.errors import DataError, DimensionError, FileFormatError, ParameterError
from cellsys.samples.snapshots import RunData, Snapshots
from cellsys.store.archive import READ_ERRORS, check_growth
from cellsys.system import Block, Layout
from cellsys.units import real_array, real_number

_NPZ_KEYS = ("x", "eta", "u", "commands", "W_x", "W_eta", "dt", "t")


def from_user(
    runs: list[Any],
    scale: str,
    dt: float | None,
    blocks: Mapping[str, Sequence[int]] | None,
) -> Snapshots:
    """See `cellsys.snapshots`: arrays (T, n), `RunData`, ``.npz`` and ``.csv`` files."""
    data: list[RunData] = []
    names: list[str] | None = None
    W_x = W_eta = None
    for i, run in enumerate(runs):
        if isinstance(run, RunData):
            data.append(run)
            continue
        if isinstance(run, (str, Path)):
            path = Path(run)
            if path.suffix == ".csv":
                array, step, names = _read_csv(path)
                data.append(RunData(array, label=path.name))
            elif path.suffix == ".npz":
                arrays = _read_npz(path)
                data.append(
                    RunData(
                        arrays["x"],
                        arrays.get("eta"),
                        arrays.get("u"),
                        arrays.get("commands"),
                        label=path.name,
                    )
                )
                W_x, W_eta = arrays.get("W_x", W_x), arrays.get("W_eta", W_eta)
                step = float(arrays["dt"].item()) if "dt" in arrays else _interval(arrays, path)
            else:
                raise ParameterError(f"run {i}: {path.name!r} is neither .npz nor .csv")
            if dt is None:
                dt = step
            elif step is not None and abs(step - dt) > 1e-9 * dt:
                raise DataError(f"{path.name} is sampled every {step:g} s, others every {dt:g} s")
            continue
        try:
            array = real_array(run, f"run {i}")
        except DataError as error:
            raise ParameterError(f"run {i} is not an array of numbers: {error}") from error
        data.append(RunData(array, label=f"run {i}"))
    if dt is None:
        raise ParameterError("dt is missing: give the sampling interval in s, dt=...")
    if np.ndim(data[0].x) != 2:
        raise DimensionError(f"a run must be (samples, states), got shape {np.shape(data[0].x)}")
    n = data[0].x.shape[1]
    n_eta = 0 if data[0].eta is None else data[0].eta.shape[1]
    states, order = _blocks(n, blocks, names)
    if order is not None:
        data = [_permuted(r, order) for r in data]
        W_x = None if W_x is None else W_x[np.ix_(order, order)]
        W_eta = None if W_eta is None else W_eta[order]
    n_commands = 0 if data[0].commands is None else data[0].commands.shape[1]
    return Snapshots(
        tuple(data),
        states,
        Layout([Block("eta", (n_eta,), "1", "component", "rate")] if n_eta else []),
        real_number(dt, "dt"),
        sp.csr_array((n, n)) if W_x is None else sp.csr_array(np.asarray(W_x, float)),
        sp.csr_array((n, n_eta)) if W_eta is None else sp.csr_array(np.asarray(W_eta, float)),
        tuple(f"command[{k}]" for k in range(n_commands)),
        scale,
        {"runs": [r.label for r in data]},
    )


def _blocks(
    n: int, blocks: Mapping[str, Sequence[int]] | None, names: list[str] | None
) -> tuple[Layout, np.ndarray | None]:
    if blocks is None:
        if names is not None and len(names) == n:
            return Layout([Block(name) for name in names]), None
        return Layout([Block("x", (n,))]), None
    order = np.concatenate([np.asarray(list(rows), dtype=int) for rows in blocks.values()])
    if sorted(order.tolist()) != list(range(n)):
        raise DimensionError(
            f"blocks must name each of the {n} columns of x exactly once, got {len(order)} indices"
        )
    layout = Layout(
        [
            Block(name, (len(list(rows)),), "1", "field" if name == "field" else "component")
            for name, rows in blocks.items()
        ]
    )
    return layout, order


def _permuted(run: RunData, order: np.ndarray) -> RunData:
    u = None if run.u is None else np.asarray(run.u)[:, order]
    return dataclasses.replace(run, x=np.asarray(run.x)[:, order], u=u)


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    if not path.exists():
        raise FileNotFoundError(f"no file {str(path)!r}")
    try:
        # Opened here: np.load leaves the file open when it is not a zip archive after all.
        with path.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            if not hasattr(archive, "files"):
                raise FileFormatError(f"{path.name} holds one bare array, not named ones")
            check_growth(archive, path)
            with archive:
                read = {k: archive[k] for k in archive.files if k in _NPZ_KEYS}
            for name, array in read.items():
                if np.iscomplexobj(array):
                    raise FileFormatError(f"{path.name}: array {name!r} is complex; give reals")
            arrays = {k: np.asarray(v, dtype=float) for k, v in read.items()}
    except FileFormatError:
        raise
    except READ_ERRORS as error:
        raise FileFormatError(f"{path.name} is not a readable npz file: {error}") from error
    if "x" not in arrays:
        raise FileFormatError(f"{path.name} has no array 'x' (samples, states)")
    if "dt" in arrays and arrays["dt"].size != 1:
        raise DimensionError(f"{path.name}: dt must be one number, got {arrays['dt'].shape}")
    return arrays


def _interval(arrays: dict[str, np.ndarray], path: Path) -> float | None:
    if "t" not in arrays:
        return None
    steps = np.diff(arrays["t"])
    if not steps.size or np.ptp(steps) > 1e-6 * steps[0]:
        raise DataError(f"{path.name}: times must be equally spaced")
    return float(steps[0])


def _read_csv(path: Path) -> tuple[np.ndarray, float, list[str]]:
    if not path.exists():
        raise FileNotFoundError(f"no file {str(path)!r}")
    try:
        # utf-8-sig: spreadsheets write a byte order mark.
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
        table = np.array([[float(v) for v in row] for row in rows[1:]])
    except (ValueError, csv.Error) as error:
        raise FileFormatError(f"{path.name}: a header and then numbers are needed: {error}") from (
            error
        )
    if table.ndim != 2 or table.shape[0] < 3 or table.shape[1] < 2:
        raise FileFormatError(f"{path.name}: needs time, at least one column, and three rows")
    step = _interval({"t": table[:, 0]}, path)
    return table[:, 1:], float(step or 0.0), [h.strip() for h in rows[0][1:]]
