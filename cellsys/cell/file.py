"""Files of equivariant models: arrays, names and card in one npz; never pickle."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from cellsys.cell.charged import ChargedModel
from cellsys.cell.dynamics import CellDynamics, ChargeBlock, ReadOut
from cellsys.cell.forecast import KINDS, ErrorBands, ValidityMonitor
from cellsys.cell.port import PolarPort, PortSites
from cellsys.cell.representation import CHARGES, CellRepresentation, ChargeModes
from cellsys.cell.schedule import Clock
from cellsys.cell.shape import ShapeBasis
from cellsys.errors import FileFormatError
from cellsys.model.card import Card
from cellsys.model.file import (
    EQUIVARIANT,
    BlockRow,
    card_from,
    check_real,
    damage_of,
    layout_from,
    layout_table,
)
from cellsys.model.network_sensor import sensor_from
from cellsys.model.sensor import StiffnessSensor
from cellsys.store.archive import load_archive, save_archive
from cellsys.system import Layout

VERSION = 2


class StoredModel(ChargedModel, Protocol):
    """A cell made of charges with all that a file holds of it."""

    @property
    def sites(self) -> PortSites:
        """Matrix nodes that the load acts on."""

    @property
    def states(self) -> Layout:
        """Of the snapshots."""

    @property
    def auxiliaries(self) -> Layout:
        """Of the snapshots."""

    @property
    def cell(self) -> str:
        """Name of the cell the layout is read for."""

    @property
    def bands(self) -> ErrorBands | None:
        """Of a forecast."""

    @property
    def monitor(self) -> ValidityMonitor | None:
        """Ranges seen in training."""

    @property
    def card(self) -> Card | None:
        """What it is worth."""

    @property
    def refits(self) -> np.ndarray | None:
        """A of the models behind the error bands."""

    @property
    def left_out(self) -> str:
        """What each was learned without."""


class Parts(NamedTuple):
    """What a file holds of an `EquivariantModel`: its arguments."""

    dynamics: CellDynamics
    representation: CellRepresentation
    modes: ChargeModes
    sites: PortSites
    states: Layout
    auxiliaries: Layout
    cell: str
    horizon: float
    z_start: np.ndarray | None
    sensor: StiffnessSensor | None
    card: Card | None
    notes: dict[str, object]
    bands: ErrorBands | None
    monitor: ValidityMonitor | None
    refits: np.ndarray | None
    left_out: str


def write_parts(model: StoredModel, path: str | Path) -> Path:
    """Write an `EquivariantModel`, atomically."""
    dynamics, shape = model.dynamics, model.representation.shape
    arrays = {
        "material": shape.material,
        "site nodes": model.sites.nodes,
        "site place": model.sites.place,
        "site area": model.sites.area,
    }
    for q, block in enumerate(dynamics.blocks):
        arrays |= {
            f"A {q}": block.A,
            f"B {q}": block.B,
            f"C {q}": block.C,
            f"gamma {q}": np.array(block.gamma),
            f"decoder {q}": model.modes.decoder[q],
            f"encoder {q}": model.modes.encoder[q],
            f"variance {q}": model.modes.variance[q],
        }
    for name in ("alone", "riding"):
        read = getattr(dynamics, name)
        arrays |= {f"{name} {k}": getattr(read, k) for k in ("R_z", "R_u", "R_y")}
    if model.z_start is not None:
        arrays["z_start"] = model.z_start
    if model.refits is not None:
        arrays["refits"] = model.refits
    if model.bands is not None:
        arrays |= {f"band {k}": v for k, v in model.bands.width.items()}
        arrays["band times"] = model.bands.t
    if model.sensor is not None:
        arrays |= {f"sensor {k}": v for k, v in model.sensor.arrays().items()}
    port = model.representation.port
    metadata = {
        "degree": shape.degree,
        "radius": shape.radius,
        "port": [port.reach, port.spacing, port.orders],
        "start_height": model.representation.start_height,
        "load_weight": model.representation.load_weight,
        "tail": {str(q): v for q, v in model.modes.tail.items()},
        "clock": [dynamics.clock.tau, dynamics.clock.vertices],
        "dt": dynamics.dt,
        "states": layout_table(model.states),
        "auxiliaries": layout_table(model.auxiliaries),
        "cell": model.cell,
        "horizon": model.horizon,
        "card": None if model.card is None else model.card.table(),
        "notes": dict(model.notes),
        "bands": None
        if model.bands is None
        else [list(model.bands.levels), model.bands.folds, model.bands.runs],
        "monitor": None if model.monitor is None else asdict(model.monitor),
        "left_out": model.left_out,
    }
    return save_archive(path, EQUIVARIANT, VERSION, arrays, metadata)


def read_parts(path: str | Path) -> Parts:
    """Arguments of an `EquivariantModel` from a file.

    Raises
    ------
    FileNotFoundError, FileFormatError
    """
    arrays, meta = load_archive(path, EQUIVARIANT, VERSION)
    check_real(arrays, path)
    for name, value in arrays.items():
        if name.startswith("sensor "):
            continue  # its errors are NaN where they were not measured; it checks itself
        if not np.all(np.abs(value) < 1e150):  # squares of larger ones are no doubles
            raise FileFormatError(
                f"{Path(path).name!r} is damaged: {name!r} holds NaN, inf or more than 1e150"
            )
    with damage_of(path):
        blocks = tuple(
            ChargeBlock(
                arrays[f"A {q}"],
                arrays[f"B {q}"],
                float(arrays[f"gamma {q}"]),
                arrays[f"C {q}"],
            )
            for q in CHARGES
        )
        reads = {
            name: ReadOut(*(arrays[f"{name} {k}"] for k in ("R_z", "R_u", "R_y")))
            for name in ("alone", "riding")
        }
        tau, vertices = meta["clock"]
        dynamics = CellDynamics(
            blocks=blocks, clock=Clock(tau, vertices), dt=float(meta["dt"]), **reads
        )
        reach, spacing, orders = meta["port"]
        representation = CellRepresentation(
            ShapeBasis(arrays["material"], meta["radius"], meta["degree"]),
            PolarPort(reach, spacing, orders),
            meta["start_height"],
            meta["load_weight"],
        )
        modes = ChargeModes(
            {q: arrays[f"decoder {q}"] for q in CHARGES},
            {q: arrays[f"encoder {q}"] for q in CHARGES},
            {q: arrays[f"variance {q}"] for q in CHARGES},
            {int(q): v for q, v in meta["tail"].items()},
        )
        sites = PortSites(arrays["site nodes"], arrays["site place"], arrays["site area"])
        sensor = {k[7:]: v for k, v in arrays.items() if k.startswith("sensor ")}
        return Parts(
            dynamics=dynamics,
            representation=representation,
            modes=modes,
            sites=sites,
            states=_layout(meta["states"], path),
            auxiliaries=_layout(meta["auxiliaries"], path),
            cell=meta["cell"],
            horizon=meta["horizon"],
            z_start=arrays.get("z_start"),
            sensor=sensor_from(sensor) if sensor else None,
            card=card_from(meta["card"]),
            notes=meta["notes"],
            bands=_bands(arrays, meta["bands"]),
            monitor=_monitor(meta["monitor"]),
            refits=arrays.get("refits"),
            left_out=str(meta.get("left_out", "run")),
        )


def _layout(table: list[BlockRow] | None, path: str | Path) -> Layout:
    found = layout_from(table)
    if found is None:
        raise FileFormatError(f"{Path(path).name!r} is damaged: it names no states or auxiliaries")
    return found


def _bands(
    arrays: dict[str, np.ndarray], meta: tuple[list[float], int, int] | None
) -> ErrorBands | None:
    if meta is None:
        return None
    levels, folds, runs = meta
    width = {kind: arrays[f"band {kind}"] for kind in KINDS}
    return ErrorBands(
        t=arrays["band times"], levels=tuple(levels), width=width, folds=folds, runs=runs
    )


def _monitor(meta: dict[str, Any] | None) -> ValidityMonitor | None:
    if meta is None:
        return None
    return ValidityMonitor(**(meta | {k: tuple(meta[k]) for k in ("amplitude", "latent")}))
