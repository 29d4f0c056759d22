"""Commands that make or take a model: reduce, poles, bode, stability."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cellsys.cli.console import Json, ModelFile, app, dump
from cellsys.cli.output import show

if TYPE_CHECKING:
    from cellsys.model.affine import AffineModel


@app.command()
def reduce(
    runs: Annotated[list[Path], typer.Argument(help="Run folders, .npz or .csv files.")],
    order: Annotated[int, typer.Option(help="Order m of the model.")],
    method: Annotated[
        str, typer.Option(help="PCR, LeastSquares, Contractive or Equivariant.")
    ] = "PCR",
    dt: Annotated[float | None, typer.Option(help="Sampling interval in s.")] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Model file to write.")] = Path(
        "model.npz"
    ),
    as_json: Json = False,
) -> None:
    """Learn a reduced model from runs."""
    from cellsys.cell import Equivariant
    from cellsys.errors import ParameterError
    from cellsys.model.affine import AffineModel
    from cellsys.model.card import card_of
    from cellsys.reduction import PCR, Contractive, LeastSquares
    from cellsys.reduction import reduce as learn
    from cellsys.samples import snapshots
    from cellsys.scene.ensemble import read_run

    known = (PCR, LeastSquares, Contractive, Equivariant)
    methods = {kind.__name__: kind() for kind in known}
    if method not in methods:
        raise ParameterError(f"--method must be one of {', '.join(methods)}, got {method!r}")
    data = snapshots([read_run(r) if r.is_dir() else r for r in runs], dt=dt)
    model = learn(data, order=order, method=methods[method])
    if not isinstance(model, AffineModel):
        raise ParameterError(f"a {type(model).__name__} has no file format")
    path = model.save(out)
    if as_json:
        dump(card_of(model).table())
        return
    show(model)
    show(f"written: {path}")


def load_model(path: Path) -> AffineModel:
    """The model in a file that cellsys wrote."""
    from cellsys.model import LatentModel

    return LatentModel.load(path)


@app.command()
def poles(model: ModelFile, as_json: Json = False) -> None:
    """Poles of a model: frequency, damping, time constant."""
    from cellsys.cell.model import EquivariantModel
    from cellsys.spectra import damping

    loaded = load_model(model)
    plant = loaded.realization()
    table = damping(plant, certainty=loaded.certainty(discrete=plant.dt > 0))
    labelled = loaded.labelled_poles() if isinstance(loaded, EquivariantModel) else ()
    if as_json:
        result: dict[str, object] = {
            "poles": [[p.real, p.imag] for p in table.poles],
            "error_bounds": table.error_bound.tolist(),
            "bounds": table.poles.note or "rounding",
            "verdict": verdict_line(loaded),
        }
        if isinstance(loaded, EquivariantModel):
            result["charges"] = [[p.value.real, p.value.imag, p.charge] for p in labelled]
        dump(result)
        return
    show(table)
    for pole in labelled[:12]:
        value = pole.value
        show(
            f"charge {pole.charge}: {value.real: .4g} {value.imag:+.4g}j 1/s, "
            f"{'single' if pole.multiplicity == 1 else 'double by symmetry'}"
        )
    show(verdict_line(loaded))


def verdict_line(model: AffineModel) -> str:
    """What the model is worth, by its card, in one line."""
    return f"verdict: {model.card.verdict if model.card else 'no card: never measured on data.'}"


@app.command()
def bode(
    model: ModelFile,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="PNG to write.")] = None,
    at: Annotated[
        str | None, typer.Option(help='Times of a scheduled model, s: "100,500,1500".')
    ] = None,
    as_json: Json = False,
) -> None:
    """Bode plot and margins of the polarity loop on a model, at the end of a run.

    Modes slower than the training runs were long are set apart: they cannot be told from
    integrators of absolute position.
    """
    from cellsys.loop import closed_loop
    from cellsys.response import margins

    loaded = load_model(model)
    horizon = float(loaded.notes.get("horizon_s", 1500.0))
    if at is not None:
        _bode_along(loaded, at, horizon, out, as_json)
        return
    point = closed_loop(loaded).linearize(horizon, slower_than=1.0 / horizon)
    result = margins(point.return_ratio())
    if out is not None:
        from cellsys.figures import bode as draw
        from cellsys.figures import save_png, sheet

        figure, axes = sheet((7.5, 6), 2, sharex=True)
        draw(result, axes)
        save_png(figure, out)
    if as_json:
        dump({**result.table(), "set_apart": len(point.slow)})
        return
    show(f"{point}\n{result}")
    show(verdict_line(loaded))


def _bode_along(
    model: AffineModel, at: str, horizon: float, out: Path | None, as_json: bool
) -> None:
    """Margins and Bode plot of a scheduled loop frozen at several times."""
    import numpy as np

    from cellsys.cell.model import EquivariantModel
    from cellsys.errors import ParameterError
    from cellsys.loop import closed_loop

    if not isinstance(model, EquivariantModel):
        raise ParameterError("--at is for a scheduled model; this one is the same at all times")
    try:
        times = np.array([float(t) for t in at.split(",")])
    except ValueError:
        raise ParameterError(f"--at takes times in s such as 100,500,1500, got {at!r}") from None
    found = closed_loop(model).margins_along(times, slower_than=1.0 / horizon)
    if out is not None:
        from cellsys.figures import bode_family, save_png, sheet

        figure, axes = sheet((7.5, 6), 2, sharex=True)
        bode_family(found, axes)
        save_png(figure, out)
    if as_json:
        dump({f"{t:g}": m.table() for t, m in found.items()})
        return
    for t, m in found.items():
        show(
            f"t = {t:6g} s: gain margin {m.gain_margin:.4g} on kappa, phase margin "
            f"{m.phase_margin:.4g} deg, delay margin {m.delay_margin:.4g} s"
        )
    show(verdict_line(model))


@app.command()
def stability(model: ModelFile, as_json: Json = False) -> None:
    """Stability of a model's plant and the reason; open where rounding or the data leave it."""
    from cellsys.spectra import stability as judge

    loaded = load_model(model)
    plant = loaded.realization()
    report = judge(plant, certainty=loaded.certainty(discrete=plant.dt > 0))
    if as_json:
        dump(
            {
                "verdict": report.verdict,
                "reason": report.reason,
                "spectral_abscissa": report.spectral_abscissa,
                "abscissa_error": report.abscissa_error,
                "numerical_abscissa": report.numerical_abscissa,
            }
        )
        return
    show(report)
    show(verdict_line(loaded))
