"""A run as an xarray data set: named dimensions, units, provenance."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from cellsys.arguments import checked
from cellsys.io.extras import extra
from cellsys.system import Block
from cellsys.trajectory import Trajectory
from cellsys.trajectory_file import provenance

if TYPE_CHECKING:
    import xarray

_AXES = ("x", "y", "z")


@checked
def to_xarray(run: Trajectory) -> xarray.Dataset:
    """States, loads, headings and constant places of a run, as labelled arrays.

    A block (n, 3) has the dimensions ``time``, ``OWNER_node`` and ``xyz``; a load (T - 1 values,
    the mean over the interval after each sample) ``interval`` instead of ``time``, whose
    coordinate is the start of the interval. Dots in names become underscores, so that every
    program of NetCDF reads them; ``long_name`` keeps the name, ``units`` the unit.
    ``to_netcdf(path)`` and ``to_zarr(path)`` are xarray's own.

    Raises
    ------
    ParameterError
        Without xarray (extra ``data``).
    """
    xr = extra("xarray", "data", "to_xarray")
    t = np.asarray(run.t, dtype=float)
    variables: dict[str, object] = {}
    for block in run.states:
        variables[_name(block.name)] = _variable(block, run.block(block.name), "time")
    if run.eta is not None:
        for block in run.auxiliaries:
            name = _name(f"load_{block.name}")
            variables[name] = _variable(block, run.auxiliary(block.name), "interval")
    for name, values, unit in (
        ("polarity", run.p, "1"), ("direction", run.d, "1"), ("amplitude", run.amplitude, "1"),
        ("virial", run.virial, "pN um"), ("node_stiffness", run.stiffness, "pN/um"),
    ):  # fmt: skip
        if values is not None:
            array = np.asarray(values)
            per = "matrix_node" if name in ("virial", "node_stiffness") else "cell"
            dims = ("time", per, "xyz")[: array.ndim]
            variables[name] = (dims, array, {"units": unit, "long_name": name})
    for name, place in run.geometry.items():
        array = np.asarray(place)
        dims = tuple(f"{_name(name)}_{k}" for k in range(array.ndim))
        variables[f"geometry_{_name(name)}"] = (dims, array, {"long_name": name})
    coordinates: dict[str, object] = {
        "time": ("time", t, {"units": "s"}), "xyz": ("xyz", list(_AXES)),
    }  # fmt: skip
    if run.eta is not None:
        coordinates["interval"] = ("interval", t[:-1], {"units": "s", "long_name": "its start"})
    told = provenance(run.source)
    made: xarray.Dataset = xr.Dataset(
        variables,
        coords=coordinates,
        attrs={
            "title": run.label, "program": f"cellsys {told['cellsys']}",
            "platform": str(told["platform"]), "provenance": json.dumps(told, sort_keys=True),
            "events": json.dumps([list(e) for e in run.events]), "Conventions": "CF-1.11",
        },
    )  # fmt: skip
    return made


def _name(name: str) -> str:
    return name.replace(".", "_")


def _variable(
    block: Block, values: np.ndarray, along: str
) -> tuple[tuple[str, ...], np.ndarray, dict[str, str]]:
    owner = block.name.partition(".")[0]
    dims = [along]
    for k, size in enumerate(block.shape):
        last = k == len(block.shape) - 1
        if last and size == 3 and len(block.shape) <= 2 and (k > 0 or "polarity" in block.name):
            dims.append("xyz")
        elif k == 0 and len(block.shape) > 1 and block.shape[-1] == 3:
            dims.append(f"{owner}_node")
        else:
            dims.append(f"{_name(block.name)}_{k}")
    attributes = {"units": block.unit, "long_name": block.name, "role": block.role}
    return tuple(dims), np.asarray(values), attributes
