"""What a cell closed with its field is worth on the matrix: displacement error beside its floor."""

from __future__ import annotations

import numpy as np

from cellsys.arguments import checked
from cellsys.cell.model import EquivariantModel
from cellsys.cell.on_field import CellsOnField
from cellsys.cell.records import CellRecord, read_records, stride
from cellsys.contracts import SteppedField
from cellsys.errors import DataError, ParameterError
from cellsys.samples.snapshots import Snapshots


def matrix_row(
    model: EquivariantModel, field: SteppedField, test: Snapshots, known: Snapshots
) -> dict[str, float]:
    """Row ``matrix`` of the card: whole roll-outs of the cell on its field, commands only as input.

    Relative errors of the displacement of all matrix nodes over every held-out run, the
    projection floor of the field's modes, and the baselines "nothing moves" and "mean motion"
    (of the training runs).

    Parameters
    ----------
    model : EquivariantModel
    field : GalerkinField or full field
        Of the matrix of the runs.
    test, known : Snapshots
        Held-out and training runs of one cell each.

    Raises
    ------
    DataError
        A field of another matrix.
    """
    if len(field.nodes) != test.states["matrix.displacement"].shape[0]:
        raise DataError(
            f"the field has {len(field.nodes)} nodes, the runs' matrix "
            f"{test.states['matrix.displacement'].shape[0]}; build it from a scene of these runs"
        )
    port = model.representation.port
    records = read_records(test, model.dt, port, model.sites)
    moved = [_displacement(known, r, model.dt)
             for r in read_records(known, model.dt, port, model.sites)]  # fmt: skip
    cells = CellsOnField(model=model, field=field)
    miss: dict[str, list[float]] = {"model": [], "floor": [], "nothing moves": []}
    for record in records:
        truth = _displacement(test, record, model.dt)
        z0 = model.encode_cell(record.nodes[:1], record.loads[:1])
        place = record.centers[0]
        done = cells.simulate(record.amplitude[:, None], record.heading[:, None], place[None], z=z0)
        size = float(np.linalg.norm(truth))
        found = {
            "model": field.displacement(done.block("field.modes")),
            "floor": field.displacement(field.project(truth)),
            "nothing moves": np.zeros_like(truth),
        }
        alike = [u for u in moved if len(u) >= len(truth)]
        if alike:
            found["mean motion"] = np.mean([u[: len(truth)] for u in alike], axis=0)
        for name, u in found.items():
            miss.setdefault(name, []).append(float(np.linalg.norm(u - truth)) / size)
    row = {name: float(np.sqrt(np.mean(np.square(each)))) for name, each in miss.items()}
    return row | {"spread over runs": float(np.std(miss["model"]))}


@checked
def with_matrix(
    model: EquivariantModel, field: SteppedField, test: Snapshots, known: Snapshots
) -> EquivariantModel:
    """The model with `matrix_row` on its card."""
    from dataclasses import replace

    if model.card is None:
        raise ParameterError("the model has no card to write the row on; train it with Equivariant")
    row = matrix_row(model, field, test, known)
    held_out = {**model.card.held_out, "matrix": row}
    facts = {**model.card.facts, "field": f"{type(field).__name__}, order {field.order}"}
    return replace(model, card=replace(model.card, held_out=held_out, facts=facts))


def _displacement(data: Snapshots, record: CellRecord, dt: float) -> np.ndarray:
    """Matrix displacements (K + 1, N, 3) of the record's run on the model's grid, um."""
    grid = stride(data, dt) * np.arange(record.steps + 1)
    run = data.runs[record.run]
    u = data.states.view(np.asarray(run.x), "matrix.displacement")[grid]
    run.release()
    return u
