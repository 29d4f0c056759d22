"""The equivariant model of a study: learned, closed into the polarity loop, saved beside PCR."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellsys.cell import Equivariant, EquivariantModel, with_matrix
from cellsys.cell.records import read_records
from cellsys.effects.steering import Polarity
from cellsys.errors import (
    CellsysError,
    DataError,
    FileFormatError,
    LostRunError,
    RankError,
    SceneError,
)
from cellsys.field import GalerkinField
from cellsys.loop import PolarityLaw, ScheduledLoop, closed_loop
from cellsys.model import LatentModel
from cellsys.model.card import card_of
from cellsys.observe import heading_error_deg
from cellsys.response import margins
from cellsys.samples import Snapshots, snapshots
from cellsys.samples.provenance import data_hash
from cellsys.scene import Scene, build
from cellsys.scene.build import spreading
from cellsys.store.hashing import fingerprint
from cellsys.study.measure import OrderRow, margin_table
from cellsys.study.summary import (
    ChargedPole,
    ClockedLoop,
    EquivariantSummary,
    HeadingError,
    NotThere,
)
from cellsys.trajectory import Trajectory
from cellsys.units import real_number
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
    told : EquivariantSummary or NotThere
        For ``summary.json``.
    """

    model: EquivariantModel | None
    run: Trajectory | None
    told: EquivariantSummary | NotThere
    why_not: str | None = None

    @property
    def heading_error(self) -> HeadingError | None:
        """Of its polarity loop against the full-order one; None without a loop."""
        told = self.told
        if isinstance(told, EquivariantSummary) and isinstance(told.loop, ClockedLoop):
            return told.loop.heading_error_deg
        return None

    def with_floors(self, floors: dict[str, float]) -> EquivariantStudy:
        """The same with floors on the model's card."""
        if self.model is None:
            return self
        card = replace(card_of(self.model), floors=floors)
        model = replace(self.model, card=card)
        told = self.told
        if isinstance(told, EquivariantSummary):
            told = replace(told, card=card.table())
        return replace(self, model=model, told=told)

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
                f"  its polarity loop: heading {self.heading_error.rms:.1f} deg rms from the "
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
            told=NotThere(str(error)),
            why_not=str(error),
        )
    run, loop = _loop(scene, model, main)
    told = EquivariantSummary(
        card=card_of(model).table(),
        poles=tuple(
            ChargedPole(p.value.real, p.value.imag, p.charge) for p in model.labelled_poles()
        ),
        fit_seconds=real_number(model.notes["fit_seconds"], "fit_seconds"),
        loop=loop,
    )
    return EquivariantStudy(model=model, run=run, told=told)


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
        model = with_matrix(model, GalerkinField(system=spreading(build(scene))), test, data)
    except (SceneError, RankError) as error:
        card = card_of(model)
        warned = (*card.warnings, f"matrix not measured: {error}")
        model = replace(model, card=replace(card, warnings=warned))
    model = replace(model, notes={**model.notes, "key": key})
    model.save(kept)
    return model


def sweep_row(model: EquivariantModel, steps: int) -> OrderRow:
    """The model as a row of the sweep; its price is the least of three roll-outs of the charges."""
    times, start = [], model.z_start
    if start is None:
        raise DataError("this model has no start; cs.reduce keeps one")
    for _ in range(4):
        began = time.perf_counter()
        model.simulate_commands(start, np.ones(steps), np.zeros(steps))
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
) -> tuple[Trajectory | None, ClockedLoop | NotThere]:
    polarity = scene.find(Polarity)
    if polarity is None:
        return None, NotThere("the scene has no polarity effect")
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
        return None, NotThere(str(error))
    every = main.stride(model.dt)
    true = np.asarray(main.polarities)[: len(t) * every : every, 0][: len(t)]
    angle = heading_error_deg(run.polarities[:, 0], true)
    gap = HeadingError(float(np.sqrt(np.mean(angle**2))), float(angle[-1]))
    found, why = _margins(loop)
    return run, ClockedLoop(gap, found, why)


def _margins(loop: ScheduledLoop) -> tuple[dict[str, object] | None, str | None]:
    try:
        point = loop.linearize(slower_than=1.0 / loop.model.horizon)
        found = margins(loop.open_loop(point))
    except CellsysError as error:
        return None, str(error)
    return margin_table(found), None
