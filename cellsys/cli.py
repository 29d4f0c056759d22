"""The command line: the same names as the Python interface.

Exit codes: 0 done, 1 a computation failed, 2 bad input (one line on standard error, no
traceback, nothing half-written).
"""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cellsys.reduction import LatentModel


class _Commands(typer.core.TyperGroup):
    """Ctrl-C in any command is one line and exit code 1."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            print("cellsys: interrupted; finished runs are kept", file=sys.stderr)
            sys.exit(1)


app = typer.Typer(
    cls=_Commands,
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="A cell on its matrix as a control system.",
)

Json = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress.")]
ModelFile = Annotated[Path, typer.Argument(help="A model written by cellsys (npz).")]
SceneFile = Annotated[Path, typer.Argument(help="A scene file (toml).")]


def main() -> None:
    """Entry point of ``cellsys`` and ``python -m cellsys``."""
    from cellsys.errors import CellsysError, IntegrationError

    try:
        app(standalone_mode=True)
    except IntegrationError as error:
        _say_error(error)
        sys.exit(1)
    except (CellsysError, OSError) as error:
        _say_error(error)
        sys.exit(2)
    except KeyboardInterrupt:
        # Outside any command: while starting up.
        sys.exit(1)


def _say_error(error: Exception) -> None:
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.strerror}: {error.filename!r}" if error.filename else error.strerror
    print(f"cellsys: {' '.join(text.split())}", file=sys.stderr)


@contextmanager
def _progress(quiet: bool) -> Iterator[Any]:
    """A callback (stage, share) that draws rich bars on a terminal and is silent elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield lambda stage, share: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:16s}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, Any] = {}

        def show(stage: str, share: float) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=share)

        yield show


def _print_table(title: str, head: list[str], rows: list[list[str]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for k, name in enumerate(head):
        table.add_column(name, justify="left" if k == 0 else "right")
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def _dump(value: Any) -> None:
    from cellsys.study.run import plain

    print(json.dumps(plain(value), indent=2, allow_nan=False))


@app.command()
def run(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Output folder.")] = None,
    order: Annotated[int, typer.Option(help="Order of the plant of the loop.")] = 10,
    workers: Annotated[int, typer.Option(help="Processes for the full-order runs.")] = 2,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue interrupted runs of the same scene.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Scene to report: full-order runs, reduced models, poles, margins, closed loop."""
    from cellsys.study import study

    folder = Path("out") / scene.stem if out is None else out
    with _progress(quiet) as progress:
        try:
            result = study(
                scene, folder, order=order, workers=workers, resume=resume, progress=progress
            )
        except KeyboardInterrupt:
            print("cellsys: interrupted; add --resume to go on from here", file=sys.stderr)
            sys.exit(1)
    if as_json:
        _dump(result.summary)
        return
    print(result.report())
    print(f"\nreport: {folder / 'report.html'}")


@app.command()
def reduce(
    runs: Annotated[list[Path], typer.Argument(help="Run folders, .npz or .csv files.")],
    order: Annotated[int, typer.Option(help="Order m of the model.")],
    method: Annotated[str, typer.Option(help="PCR or LeastSquares.")] = "PCR",
    dt: Annotated[float | None, typer.Option(help="Sampling interval in s.")] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Model file to write.")] = Path(
        "model.npz"
    ),
    as_json: Json = False,
) -> None:
    """Learn a reduced model from runs."""
    from cellsys.errors import ParameterError
    from cellsys.reduction import PCR, LeastSquares, snapshots
    from cellsys.reduction import reduce as learn
    from cellsys.scene.ensemble import read_run

    methods = {"PCR": PCR(), "LeastSquares": LeastSquares()}
    if method not in methods:
        raise ParameterError(f"--method must be one of {', '.join(methods)}, got {method!r}")
    data = snapshots([read_run(r) if r.is_dir() else r for r in runs], dt=dt)
    model = learn(data, order=order, method=methods[method])
    path = model.save(out)
    if as_json:
        _dump(model.card.table())
        return
    print(model)
    print(f"written: {path}")


def _load(path: Path) -> LatentModel:
    from cellsys.reduction import LatentModel

    return LatentModel.load(path)


@app.command()
def poles(model: ModelFile, as_json: Json = False) -> None:
    """Poles of a model: frequency, damping, time constant."""
    from cellsys.response import damping
    from cellsys.study.run import plant_of

    loaded = _load(model)
    table = damping(plant_of(loaded))
    if as_json:
        _dump({"poles": [[p.real, p.imag] for p in table.poles], "verdict": _verdict(loaded)})
        return
    print(table)
    print(_verdict(loaded))


def _verdict(model: LatentModel) -> str:
    return f"verdict: {model.card.verdict if model.card else 'no card: never measured on data.'}"


@app.command()
def bode(
    model: ModelFile,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="PNG to write.")] = None,
    as_json: Json = False,
) -> None:
    """Bode plot and margins of the polarity loop on a model, at the end of a run.

    Modes slower than the training runs were long are set apart: they cannot be told from
    integrators of absolute position.
    """
    from cellsys.loop import closed_loop
    from cellsys.response import margins

    loaded = _load(model)
    horizon = float(loaded.notes.get("horizon_s", 1500.0))
    point = (loop := closed_loop(loaded)).linearize(horizon, slower_than=1.0 / horizon)
    result = margins(loop.open_loop(point))
    if out is not None:
        from cellsys.figures import bode as draw
        from cellsys.figures import save_png, sheet

        figure, axes = sheet((7.5, 6), 2, sharex=True)
        draw(result, axes)
        save_png(figure, out)
    if as_json:
        _dump(
            {
                "gain_margin": result.gain_margin,
                "phase_margin_deg": result.phase_margin,
                "delay_margin_s": result.delay_margin,
                "closed_loop_stable": result.closed_loop_stable,
                "set_apart": len(point.slow),
            }
        )
        return
    print(f"{point}\n{result}")
    print(_verdict(loaded))


@app.command()
def stability(model: ModelFile, as_json: Json = False) -> None:
    """Stability of a model's plant at working precision, with the reason."""
    from cellsys.response import stability as judge
    from cellsys.study.run import plant_of

    loaded = _load(model)
    report = judge(plant_of(loaded))
    if as_json:
        _dump(
            {
                "verdict": report.verdict,
                "reason": report.reason,
                "spectral_abscissa": report.spectral_abscissa,
                "numerical_abscissa": report.numerical_abscissa,
            }
        )
        return
    print(report)
    print(_verdict(loaded))


@app.command()
def effects(
    scene: Annotated[Path | None, typer.Argument(help="A scene file (toml).")] = None,
    as_json: Json = False,
) -> None:
    """List all effects, or what a scene builds."""
    from cellsys.scene.listing import effect_table, scene_table

    rows = effect_table() if scene is None else scene_table(scene)
    if as_json:
        _dump(rows)
        return
    head = list(rows[0])
    title = "effects" if scene is None else f"what {scene.name} builds"
    _print_table(title, head, [[str(r[h]) for h in head] for r in rows])


@app.command()
def schema() -> None:
    """JSON schema of scene files, for editors."""
    from cellsys.scene import scene_schema

    print(json.dumps(scene_schema(), indent=2))


if __name__ == "__main__":
    main()
