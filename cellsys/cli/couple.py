"""Command that puts K cells on one matrix: couple."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cellsys.cli.console import Json, ModelFile, app, dump
from cellsys.cli.models import load_model, verdict_line
from cellsys.cli.output import show

if TYPE_CHECKING:
    from cellsys.model.affine import AffineModel
    from cellsys.population import CoupledCells
    from cellsys.population.poleset import PoleSet
    from cellsys.population.request import Coupling
    from cellsys.population.verdict import CoupledStability

_FORMS = ("superposition", "mapped", "feedback")


@app.command()
def couple(
    model: ModelFile,
    cells: Annotated[int, typer.Option("--cells", "-K", help="Number of cells.")],
    form: Annotated[
        str, typer.Option("--form", help="superposition [36], mapped [93] or feedback [57].")
    ] = "superposition",
    map_file: Annotated[
        str | None, typer.Option("--map", help="P_map of --form mapped: .npy file, m x m.")
    ] = None,
    rank_tol: Annotated[
        float | None, typer.Option(help="Absolute tolerance on the singular values of V_alpha.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Poles and stability of K identical cells on one matrix."""
    loaded = load_model(model)
    together = _couple(loaded, cells, form, map_file, rank_tol)
    report, poles = together.stability(), together.pole_set()
    if as_json:
        dump(_table(together, report, poles) | {"model": verdict_line(loaded)})
        return
    show(f"{together}\n{report}\n{poles}\n{verdict_line(loaded)}")


def _couple(
    model: AffineModel, n_cells: int, form: str, map_file: str | None, rank_tol: float | None
) -> CoupledCells:
    import numpy as np

    from cellsys import population
    from cellsys.errors import FileFormatError, ParameterError
    from cellsys.store.archive import READ_ERRORS
    from cellsys.store.regular import open_regular

    if form not in _FORMS:
        raise ParameterError(f"--form must be one of {', '.join(_FORMS)}, got {form!r}")
    if (form == "mapped") != (map_file is not None):
        raise ParameterError("--form mapped needs --map FILE.npy, and the others take none")
    coupling: Coupling
    if map_file is not None:
        try:
            with open_regular(Path(map_file)) as file:
                P_map = np.load(file, allow_pickle=False)
        except (OSError, FileFormatError):
            raise
        except READ_ERRORS as error:
            raise FileFormatError(f"{map_file!r} is no .npy array: {error}") from error
        coupling = population.MappedSuperposition(P_map=P_map, rank_tol=rank_tol)
    elif form == "feedback":
        coupling = population.Feedback(rank_tol=rank_tol)
    else:
        coupling = population.Superposition(rank_tol=rank_tol)
    together = population.couple(model, n_cells, coupling)
    if not isinstance(together, population.CoupledCells):
        raise ParameterError(f"--form {form} is not for a {type(model).__name__}")
    return together


def _rows(poles: PoleSet) -> list[dict[str, object]]:
    spread = [None] * len(poles.values) if poles.spread is None else poles.spread.tolist()
    return [
        {"pole": [v.real, v.imag], "multiplicity": int(n), "spread": s}
        for v, n, s in zip(poles.values, poles.multiplicity, spread, strict=True)
    ]


def _table(cells: CoupledCells, report: CoupledStability, poles: PoleSet) -> dict[str, object]:
    other = poles.alternative
    return {
        "cells": cells.n_cells,
        "order": cells.order,
        "form": cells.coupling.name,
        "route": cells.route,
        "verdict": report.verdict,
        "reason": report.reason,
        "spectral_abscissa": report.spectral_abscissa,
        "abscissa_error": report.abscissa_error,
        "numerical_abscissa": report.numerical_abscissa,
        "integrators": report.integrators,
        "purely_matrix_directions": cells.rank.purely_field,
        "one_minus_lambda": cells.rank.gap.tolist(),
        "determined": poles.determined,
        "poles": _rows(poles),
        "alternative_poles": None if other is None else _rows(other),
    }
