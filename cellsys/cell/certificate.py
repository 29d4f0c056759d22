"""The card of an equivariant model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellsys.cell.model import EquivariantModel
from cellsys.cell.records import CellRecord, stride
from cellsys.cell.worth import (
    Baselines,
    measure,
    representation_error,
)
from cellsys.model.card import Card, verdict
from cellsys.model.network_sensor import fit_local_sensor, nodal_moments
from cellsys.model.poles import fastest_growth
from cellsys.model.sensor import StiffnessSensor, fit_sensor
from cellsys.model.stiffness_map import StiffnessMap
from cellsys.samples.provenance import constant_commands, data_hash, repeated_runs, repeats
from cellsys.samples.snapshots import Snapshots


def card_of(
    model: EquivariantModel,
    data: Snapshots,
    records: Sequence[CellRecord],
    held_out: Sequence[CellRecord] = (),
    test: Snapshots | None = None,
) -> Card:
    """Errors on training and held-out records beside floors and baselines, and what is certain."""
    baselines = Baselines(tuple(records), model)
    training = measure(model, records, baselines)
    repeated = [] if test is None else repeated_runs(test, data)
    counted = [r for r in held_out if r.run not in repeated]
    held = measure(model, counted, baselines) if counted else {}
    abscissa = max(p.value.real for p in model.labelled_poles())
    growth = fastest_growth(model.pole_set())
    norm = model.dynamics.norm()
    index = model.dynamics.passivity_index()
    facts: dict[str, object] = {
        "data hashes": data_hash(data),
        "order per charge": [b.size for b in model.dynamics.blocks] + ["and the centroid"],
        "representation error": representation_error(model, records),
        "contraction norm": f"{norm:.12g} ({_contraction(norm)})",
        "port passivity index": f"{index:.2g} ({_passive(model, index)})",
        "clock": f"{model.dynamics.clock.vertices} vertices, {model.dynamics.clock.tau:g} s",
    }
    sensor = model.sensor
    if sensor is not None:
        told: dict[str, object] = {
            "inputs": getattr(sensor, "inputs", "latent state"),
            f"held out, {sensor.error_unit}": sensor.held_out_error,
            f"constant direction, {sensor.error_unit}": sensor.constant_error,
        }
        facts["sensor"] = told
        if sensor.noise:
            told["cue over the network's noise, |g|/g0"] = sensor.strength
        facts[f"sensor, inputs tried ({sensor.error_unit}, run left out)"] = dict(
            getattr(sensor, "tried", {})
        )
    text = verdict(model.order, growth, training, held)
    return Card(
        order=model.order,
        method="Equivariant",
        scale="block",
        samples=sum(r.steps for r in records),
        columns=data.n_columns,
        runs=tuple(r.label for r in records),
        spectral_abscissa=float(abscissa),
        growth=growth,
        training=training,
        held_out=held,
        verdict=text,
        facts=facts,
        warnings=(*constant_commands(data), *repeats(repeated, test)),
    )


def _contraction(norm: float) -> str:
    if norm < 1.0:
        return "every roll-out is bounded, with bounded commands too"
    return "free motion is bounded" if norm <= 1.0 + 1e-12 else "not contractive"


def _passive(model: EquivariantModel, index: float) -> str:
    if all(b.gamma == 0 for b in model.dynamics.blocks):
        return "a cascade: no port gain is determined by the data"
    return "passive" if index >= -1e-10 else "not passive"


def sensor_of(
    model: EquivariantModel,
    data: Snapshots,
    records: Sequence[CellRecord],
    test: Snapshots | None,
    held_out: Sequence[CellRecord],
) -> StiffnessSensor | None:
    """The sensor of one-cell runs that recorded a direction, on the network's own stiffness.

    None where no direction was recorded or a run has several cells.
    """
    if any(run.d is None or run.d.shape[1] != 1 for run in data.runs):
        return None

    def samples(
        of: Snapshots, rows: Sequence[CellRecord]
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        every = stride(of, model.dt)
        return (
            [model.encode_cell(r.nodes, r.loads) for r in rows],
            [np.asarray(of.runs[r.run].d)[: r.steps * every + 1 : every, 0] for r in rows],
        )

    latent, directions = samples(data, records)
    shown, told = samples(test, held_out) if test is not None and held_out else (None, None)
    noise = float(data.geometry.get("sensing.noise", 0.0))
    if "matrix.stiffness" not in data.geometry:
        return fit_sensor(latent, directions, shown, told, noise=noise)
    at_rest = data.geometry["matrix.fibre_stiffness" if noise else "matrix.stiffness"]
    known = StiffnessMap(data.geometry["matrix.rest"][:, :2], at_rest, contrasts=noise > 0.0)
    moments = moments_of(data, records, model.dt)
    block = model.dynamics.blocks[1].size
    first = model.dynamics.starts()[1] + np.arange(block)
    return fit_local_sensor(
        latent,
        directions,
        known,
        shown,
        told,
        moments=moments,
        charge=(first, first + block),
        noise=noise,
    )


def moments_of(
    data: Snapshots, records: Sequence[CellRecord], step: float
) -> dict[str, list[np.ndarray]]:
    """Moments (K + 1, 2) of the nodal measures that all runs store, about every record's cell."""
    names = set.intersection(*(set(run.nodal) for run in data.runs))
    out: dict[str, list[np.ndarray]] = {name: [] for name in sorted(names)}
    for r in records:
        run = data.runs[r.run]
        grid = stride(data, step) * np.arange(r.steps + 1)
        moved = data.states.view(np.asarray(run.x), "matrix.displacement")[grid]
        nodal = {name: np.asarray(run.nodal[name])[grid] for name in out}
        found = nodal_moments(data.geometry["matrix.rest"], moved, nodal, r.centers)
        for name, q in found.items():
            out[name].append(q)
        run.release()
    return out
