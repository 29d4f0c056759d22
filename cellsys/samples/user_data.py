"""Snapshots from a user's own simulator: arrays, npz or csv files."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import scipy.sparse as sp

from cellsys.errors import (
    DataError,
    DimensionError,
    FileFormatError,
    ParameterError,
    TransposedDataWarning,
    UnusedDataWarning,
)
from cellsys.samples.csv_file import EQUAL, interval, read_csv
from cellsys.samples.measured import delayed, looks_transposed, resampled, without_missing
from cellsys.samples.snapshots import RunData, Snapshots
from cellsys.store.archive import READ_ERRORS, check_members
from cellsys.store.regular import open_regular
from cellsys.system import Block, Layout
from cellsys.units import real_array, real_number, shaped_array

_Said = TypeVar("_Said", float, np.ndarray, tuple[str, ...])  # what a file says of all runs


def from_user(
    runs: Sequence[object],
    scale: str,
    dt: float | None,
    blocks: Mapping[str, Sequence[int]] | None,
    resample: float | None = None,
    missing: str = "refuse",
    delays: int = 0,
) -> Snapshots:
    """See `cellsys.snapshots`: arrays (T, n), `RunData`, ``.npz`` and ``.csv`` files."""
    data: list[RunData] = []
    told: dict[str, float] = {}
    names: tuple[str, ...] | None = None
    steps: dict[str, tuple[float, str]] = {}
    columns: dict[str, tuple[tuple[str, ...], str]] = {}
    matrices: dict[str, tuple[np.ndarray, str]] = {}
    if dt is not None:
        steps["dt"] = real_number(dt, "dt"), "dt"
    for i, run in enumerate(runs):
        if isinstance(run, RunData):
            data.append(run)
            continue
        if not isinstance(run, (str, Path)):
            try:
                array = real_array(run, f"run {i}")
            except DataError as error:
                raise ParameterError(f"run {i} is not an array of numbers: {error}") from error
            data.append(RunData(x=array, label=f"run {i}"))
            continue
        path = Path(run)
        kind = path.suffix.lower()
        if kind == ".csv":
            table = read_csv(path, resample=resample, gaps=missing != "refuse")
            if table.resampling_error is not None:
                told[path.name] = table.resampling_error
            data.append(RunData(x=table.x, label=path.name))
            step = table.step
            if table.names is not None:
                _agree(columns, "names of columns", table.names, path.name)
            names = table.names or names
        elif kind == ".npz":
            arrays = _read_npz(path)
            data.append(
                RunData(
                    x=arrays["x"],
                    eta=arrays.get("eta"),
                    u=arrays.get("u"),
                    commands=arrays.get("commands"),
                    label=path.name,
                )
            )
            if resample is not None:
                data[-1], told[path.name] = _evenly(data[-1], arrays, resample, path)
                arrays = {"dt": np.asarray(resample)}
            step = _step(arrays, path)
            for what in ("W_x", "W_eta"):
                if what in arrays:
                    _agree(matrices, what, arrays[what], path.name)
        else:
            raise ParameterError(f"run {i}: {path.name!r} is neither .npz nor .csv")
        if step is not None:
            _agree(steps, "dt", step, path.name)
    if "dt" not in steps:
        raise ParameterError(_no_interval(data, names))
    W_x, W_eta = (matrices[k][0] if k in matrices else None for k in ("W_x", "W_eta"))
    for i, each in enumerate(data):
        for name in _OF_RUNS:
            value = getattr(each, name)
            if value is not None and np.ndim(value) != 2:
                raise DimensionError(
                    f"{name} of run {i} must be a matrix, one row for a sample or an interval, got "
                    f"shape {np.shape(value)}; a single column is {name}[:, None]"
                )
    gone = 0
    if missing != "refuse":
        found = [without_missing(run, missing) for run in data]
        data, gone = [run for runs, _ in found for run in runs], sum(lost for _, lost in found)
        if not data:
            raise DataError("no run has three samples in a row; fill them (missing='fill')")
    for each in data:
        if looks_transposed(np.asarray(each.x)):
            warnings.warn(
                f"{each.label}: {each.x.shape[0]} samples of {each.x.shape[1]} states that jump "
                "from sample to sample and run smoothly from state to state: is the array "
                "transposed? Rows are samples; give x.T otherwise",
                TransposedDataWarning,
                stacklevel=3,
            )
    n = data[0].x.shape[1]
    n_eta = 0 if data[0].eta is None else data[0].eta.shape[1]
    states, order = _blocks(n, blocks, names)
    if order is not None:
        data = [_permuted(r, order) for r in data]
        W_x = None if W_x is None else W_x[np.ix_(order, order)]
        W_eta = None if W_eta is None else W_eta[order]
    if delays:
        if W_x is not None or W_eta is not None:
            raise ParameterError("delays are for runs of states alone; leave W_x and W_eta out")
        data, states = delayed(data, states, delays)
        n = states.size
    n_commands = 0 if data[0].commands is None else data[0].commands.shape[1]
    return Snapshots(
        runs=tuple(data),
        states=states,
        auxiliaries=Layout(
            [Block("eta", (n_eta,), "1", role="component", kind="rate")] if n_eta else []
        ),
        dt=steps["dt"][0],
        W_x=sp.csr_array((n, n)) if W_x is None else sp.csr_array(np.asarray(W_x, float)),
        W_eta=sp.csr_array((n, n_eta)) if W_eta is None else sp.csr_array(np.asarray(W_eta, float)),
        command_names=tuple(f"command[{k}]" for k in range(n_commands)),
        scale=scale,
        source={
            "runs": [r.label for r in data],
            **({"resampling_error": told} if told else {}),
            **({"missing_samples": gone, "missing": missing} if gone else {}),
            **({"delays": delays} if delays else {}),
        },
    )


def _evenly(
    run: RunData, arrays: Mapping[str, np.ndarray], resample: float, path: Path
) -> tuple[RunData, float]:
    """A run of an npz file on even times, and the error that this adds."""
    if "t" not in arrays:
        raise DataError(f"{path.name} has no times t to resample by")
    if run.eta is not None or run.u is not None or run.commands is not None:
        raise ParameterError(
            f"resample is for runs of states alone; {path.name} has loads or commands"
        )
    x = real_array(run.x, f"{path.name}: x")
    if not np.isfinite(x).all():
        raise DataError(f"{path.name}: leave out samples with NaN before resampling")
    made, error = resampled(real_array(arrays["t"], "t"), x, resample, path.name)
    return dataclasses.replace(run, x=made), error


def _blocks(
    n: int, blocks: Mapping[str, Sequence[int]] | None, names: tuple[str, ...] | None
) -> tuple[Layout, np.ndarray | None]:
    if blocks is None:
        if names is not None and len(names) == n:
            return Layout([Block(name) for name in names]), None
        return Layout([Block("x", (n,))]), None
    order = np.array([k for rows in blocks.values() for k in rows], dtype=int)
    if sorted(order.tolist()) != list(range(n)):
        raise DimensionError(
            f"blocks must name each of the {n} columns of x exactly once, got {len(order)} indices"
        )
    layout = Layout(
        [
            Block(name, (len(list(rows)),), "1", role="field" if name == "field" else "component")
            for name, rows in blocks.items()
        ]
    )
    return layout, order


def _permuted(run: RunData, order: np.ndarray) -> RunData:
    u = None if run.u is None else np.asarray(run.u)[:, order]
    return dataclasses.replace(run, x=np.asarray(run.x)[:, order], u=u)


def _agree(said: dict[str, tuple[_Said, str]], what: str, value: _Said, where: str) -> None:
    """Keep what one file says of all runs; DataError where another said something else."""
    if what not in said:
        said[what] = value, where
        return
    before, there = said[what]
    if isinstance(value, float) and isinstance(before, float):
        if abs(value - before) > EQUAL * before:
            other = "dt=" if there == "dt" else there
            raise DataError(
                f"{where} is sampled every {value:.9g} s, but {other} says {before:.9g} s; give "
                "the runs of one interval, and dt= in s"
            )
    elif not np.array_equal(value, before):
        raise DataError(f"{where} and {there} have different {what}; one set has the same in all")


def _no_interval(data: list[RunData], names: tuple[str, ...] | None) -> str:
    text = "dt is missing: give the sampling interval in s, dt=... (--dt)"
    if names is None:
        return text
    listed = ", ".join(repr(name) for name in names[:6]) + ", ..." * (len(names) > 6)
    return (
        f"{text}. No column is called t or time with its unit, such as 't [ms]': with dt= all of "
        f"{listed} are states, so leave out those that only count"
    )


_SHAPES = {"x": 2, "eta": 2, "u": 2, "commands": 2, "W_x": 2, "W_eta": 2, "t": 1}
_OF_RUNS = ("x", "eta", "u", "commands")


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    try:
        # Opened here: np.load leaves the file open when it is not a zip archive after all.
        with open_regular(path) as file:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise FileFormatError(f"{path.name} holds one bare array, not named ones")
            check_members(archive, path)
            with archive:
                read = {k: archive[k] for k in archive.files if k in ("dt", *_SHAPES)}
                unknown = sorted(set(archive.files) - set(read))
    except (FileFormatError, FileNotFoundError):
        raise
    except READ_ERRORS as error:
        raise FileFormatError(f"{path.name} is not a readable npz file: {error}") from error
    if "x" not in read:
        raise FileFormatError(f"{path.name} has no array 'x' (samples, states)")
    for name, array in read.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
            found = array.dtype.name if isinstance(array, np.ndarray) else "bytes"
            raise FileFormatError(
                f"{path.name}: array {name!r} holds {found}; give real numbers, times in s"
            )
        if name in _SHAPES and array.ndim != _SHAPES[name]:
            raise DimensionError(
                f"{path.name}: array {name!r} must have {_SHAPES[name]} dimensions, got shape "
                f"{array.shape}"
            )
    arrays = {k: np.asarray(v, dtype=float) for k, v in read.items()}
    if "dt" in arrays and arrays["dt"].size != 1:
        raise DimensionError(f"{path.name}: dt must be one number, got {arrays['dt'].shape}")
    if "t" in arrays and len(arrays["t"]) != len(arrays["x"]):
        raise DimensionError(
            f"{path.name}: t has {len(arrays['t'])} times for {len(arrays['x'])} samples of x"
        )
    if unknown:
        warnings.warn(
            f"{path.name}: not used: {', '.join(map(repr, unknown))}; known names are "
            f"dt, {', '.join(_SHAPES)}",
            UnusedDataWarning,
            stacklevel=4,
        )
    return arrays


def _step(arrays: Mapping[str, np.ndarray], path: Path) -> float | None:
    """Sampling interval of an npz file, s; None where it says none."""
    said: dict[str, tuple[float, str]] = {}
    step = None
    if "dt" in arrays:
        step = real_number(arrays["dt"].item(), f"{path.name}: dt")
        _agree(said, "dt", step, f"{path.name}: dt")
    if "t" in arrays:
        times = shaped_array(arrays["t"], f"{path.name}: t", (None,))
        if len(times) < 3:
            raise DataError(f"{path.name}: {len(times)} samples; a run needs at least three")
        spacing = interval(times, path.name)
        _agree(said, "dt", spacing, f"{path.name}: t")
        step = spacing if step is None else step
    return step
