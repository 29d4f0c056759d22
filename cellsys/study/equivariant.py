"""The equivariant model of a study: learned, closed into the polarity loop, saved beside PCR."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cellsys.cell import Equivariant, EquivariantModel, with_matrix
from cellsys.cell.records import read_records
from cellsys.errors import CellsysError, FileFormatError, LostRunError, RankError, SceneError
from cellsys.field import GalerkinField
from cellsys.loop import PolarityLaw, ScheduledLoop, closed_loop
from cellsys.mechanics.effects.steering import Polarity
from cellsys.model import LatentModel
from cellsys.model.card import card_of
from cellsys.observe import heading_error_deg
from cellsys.response import margins
from cellsys.samples import Snapshots, snapshots
from cellsys.samples.provenance import data_hash
from cellsys.scene import Scene, build
from cellsys.store.hashing import fingerprint
from cellsys.study.measure import OrderRow, margin_table
from cellsys.trajectory import Trajectory
from cellsys.version import __version__

ORDER = 50


@dataclass(frozen=True, eq=False, kw_only=True)
class EquivariantStudy:
    """What a study says of its equivariant model.

    Parameters
    ----------
    model : EquivariantModel or None
        None with the reason in `why_not`.
    run : Trajectory or None
        The polarity loop on it.
    heading_error : dict
        Degrees, against the full-order loop: rms and at the end.
    table : dict
        For ``summary.json``.
    """

    model: EquivariantModel | None
    run: Trajectory | None
    heading_error: dict[str, float]
    table: dict[str, Any]
    why_not: str | None = None

    def with_floors(self, floors: dict[str, float]) -> EquivariantStudy:
        """The same with floors on the model's card."""
        if self.model is None:
            return self
        card = replace(card_of(self.model), floors=floors)
        model = replace(self.model, card=card)
        return replace(self, model=model, table=self.table | {"card": card.table()})

    def lines(self) -> list[str]:
        """For a terminal."""
        if self.model is None:
            return [f"no equivariant model: {self.why_not}"]
        out = [f"equivariant model: {card_of(self.model).verdict}"]
        slow = [p for p in self.model.labelled_poles() if p.value.real > -0.02][:6]
        out += [f"  charge {p.charge}: {p.value.real: .3e} {p.value.imag:+.3e}j 1/s" for p in slow]
        out += [f"  warning: {text}" for text in card_of(self.model).warnings]
        if self.heading_error:
            out.append(
                f"  its polarity loop: heading {self.heading_error['rms']:.1f} deg rms from the "
                "full-order loop"
            )
        return out


def study_equivariant(
    scene: Scene, data: Snapshots, test: Snapshots, main: Trajectory, kept: Path
) -> EquivariantStudy:
    """Learn the model (or read it from `kept`) and run its loop; without one, say why."""
    try:
        model = _learned(scene, data, test, kept)
    except LostRunError:
        raise  # no property of the data: the runs were removed meanwhile
    except CellsysError as error:
        return EquivariantStudy(
            model=None,
            run=None,
            heading_error={},
            table={"why_not": str(error)},
            why_not=str(error),
        )
    run, gap, loop_table = _loop(scene, model, main)
    table = {
        "why_not": None,
        "card": card_of(model).table(),
        "poles": [
            {"real": p.value.real, "imag": p.value.imag, "charge": p.charge}
            for p in model.labelled_poles()
        ],
        "fit_seconds": model.notes["fit_seconds"],
        "loop": loop_table,
    }
    return EquivariantStudy(model=model, run=run, heading_error=gap, table=table)


def _learned(scene: Scene, data: Snapshots, test: Snapshots, kept: Path) -> EquivariantModel:
    """The model of these runs; kept in a file, whose key is the data, the method and us."""
    method, order = Equivariant(), min(ORDER, max(5, data.n_samples // 10))
    key = fingerprint([data_hash(data), data_hash(test), repr(method), order], __version__)
    if kept.exists():
        try:
            known = LatentModel.load(kept)
        except FileFormatError:
            known = None  # written by another version, or damaged: learn it again
        if isinstance(known, EquivariantModel) and known.notes.get("key") == key:
            return known
    model = method.fit(data, order, test=test)
    try:
        model = with_matrix(model, GalerkinField(system=build(scene)), test, data)
    except (SceneError, RankError) as error:
        card = card_of(model)
        warned = (*card.warnings, f"matrix not measured: {error}")
        model = replace(model, card=replace(card, warnings=warned))
    model = replace(model, notes={**model.notes, "key": key})
    model.save(kept)
    return model


def sweep_row(model: EquivariantModel, steps: int) -> OrderRow:
    """The model as a row of the sweep; its price is the least of three roll-outs of the charges."""
    times = []
    for _ in range(4):
        began = time.perf_counter()
        model.simulate_commands(model.z_start, np.ones(steps), np.zeros(steps))
        times.append(time.perf_counter() - began)
    card = card_of(model)
    row = card.held_out["cells"]
    return OrderRow(
        method="Equivariant",
        order=model.order,
        error={"cells": row["model"]},
        floor={"cells": row["floor"]},
        baselines={"cells": {k: row[k] for k in ("nothing moves", "mean velocity", "mean motion")}},
        abscissa=card.spectral_abscissa,
        roll_out_ms=1e3 * min(times[1:]),
        verdict=card.verdict,
    )


def _loop(
    scene: Scene, model: EquivariantModel, main: Trajectory
) -> tuple[Trajectory | None, dict[str, float], dict[str, Any]]:
    polarity = scene.find(Polarity)
    if polarity is None:
        return None, {}, {"why_not": "the scene has no polarity effect"}
    try:
        port = model.representation.port
        record = read_records(snapshots([main]), model.dt, port, model.sites)[0]
        loop = closed_loop(
            model,
            controller=PolarityLaw(kappa=polarity.kappa),
            z0=model.encode_cell(record.nodes[:1], record.loads[:1])[0],
            p0=np.asarray(main.polarities[0, 0]),
        )
        t = model.dt * np.arange(record.steps + 1)
        run = loop.simulate(t)
    except CellsysError as error:
        return None, {}, {"why_not": str(error)}
    every = main.stride(model.dt)
    true = np.asarray(main.polarities)[: len(t) * every : every, 0][: len(t)]
    angle = heading_error_deg(run.polarities[:, 0], true)
    gap = {"rms": float(np.sqrt(np.mean(angle**2))), "end": float(angle[-1])}
    return run, gap, {"heading_error_deg": gap, **_margins(loop)}


def _margins(loop: ScheduledLoop) -> dict[str, Any]:
    try:
        point = loop.linearize(slower_than=1.0 / loop.model.horizon)
        found = margins(loop.open_loop(point))
    except CellsysError as error:
        return {"margins": None, "why_no_margins": str(error)}
    return {"margins": margin_table(found), "why_no_margins": None}
