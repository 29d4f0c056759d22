"""`study` of a scene that no model is learned from: several cells, none, or none that is steered.

The scene is run and read out; several cells on a matrix beside their one-cell controls. With the
model of one cell, its copies are run on the same matrix and compared.
"""

from __future__ import annotations

import dataclasses
import html
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from cellsys.contracts import LinearModel
from cellsys.figures import cells_from_above, pair_gaps, save_png, sheet
from cellsys.figures import trajectory as paths
from cellsys.mechanics.spreading import SpreadingSystem
from cellsys.observe import (
    PairReadout,
    alone_scenes,
    heading_change_deg,
    observe_neighbours,
    summary_of_run,
)
from cellsys.scene import Scene, build, run_ensemble, run_scene
from cellsys.scene.build import spreading
from cellsys.shown import Shown
from cellsys.store import write_json, write_text
from cellsys.store.cache import cache_folder
from cellsys.study.fields import draw_displacement
from cellsys.study.files import plain, save_run
from cellsys.study.html import STYLE, image, table
from cellsys.study.measure import matrix_row, read_out_name, short_number, texts
from cellsys.study.plan import steered
from cellsys.study.reduced_cells import ReducedCells, check_model, reduced_cells
from cellsys.study.summary import CellsSummary, table_of
from cellsys.trajectory import Trajectory, cell_names

Progress = Callable[[str, float], None]
MOST_PATHS = 4  # three lines each


@dataclass(frozen=True, eq=False, kw_only=True)
class CellsStudy(Shown):
    """What `study` computed of a scene without a model of its own.

    Attributes
    ----------
    run : Trajectory
        The scene, full-order.
    pairs : mapping of (int, int) to PairReadout
        Every two neighbours (cells counted from 0) beside their one-cell controls.
    reduced : ReducedCells or None
        Copies of the model that was given, on the same matrix.
    told : CellsSummary
        What ``summary.json`` holds; `summary` is the same as plain tables.
    out : Path
    """

    scene: Scene
    run: Trajectory
    pairs: Mapping[tuple[int, int], PairReadout]
    reduced: ReducedCells | None
    told: CellsSummary
    out: Path

    @property
    def summary(self) -> Mapping[str, object]:
        """What ``summary.json`` holds, as plain tables."""
        return table_of(self.told)

    def __str__(self) -> str:
        return self.told.verdict

    def report(self) -> str:
        """The study in words, for a terminal."""
        lines = [str(self.run), ""]
        for name, row in {**self.told.cells, "matrix": self.told.matrix}.items():
            if row:
                lines.append(f"{name}:")
                lines += [f"  {read_out_name(k):28s} {v}" for k, v in texts(row).items()]
        for (i, j), pair in self.pairs.items():
            lines.append(f"cells {i + 1} and {j + 1}: {pair}")
        if self.reduced is not None:
            lines += ["", str(self.reduced)]
        return "\n".join([*lines, "", str(self)])


def study_cells(
    scene: Scene,
    out: str | Path,
    *,
    workers: int = 2,
    cache: Path | None = None,
    model: LinearModel | None = None,
    progress: Progress | None = None,
) -> CellsStudy:
    """Run a scene, read it out, report on it.

    Writes into `out`: ``run.npz``, ``summary.json``, ``figures/*.png`` and ``report.html``.

    Parameters
    ----------
    workers : int
        Processes for the scene and its one-cell controls.
    cache : path, optional
        Folder of the runs; default the user's.
    model : EquivariantModel, optional
        Of one cell; see `reduced_cells`.
    """
    if model is not None:
        check_model(scene, model)
    began = time.perf_counter()
    say = progress or (lambda stage, share: None)
    folder = Path(out)
    run, alone = _runs(scene, cache_folder() if cache is None else cache, workers, say)
    system = spreading(build(scene))
    rest = None if system.matrix is None else system.matrix.position
    pairs = observe_neighbours(run, alone, rest) if alone and rest is not None else {}
    reduced = None
    if model is not None:
        say("reduced cells", 0.0)
        reduced = reduced_cells(scene, system, model, run, alone)
        say("reduced cells", 1.0)
    told = CellsSummary(
        scene=scene.name,
        fingerprint=scene.fingerprint(),
        cells={name: _cell_row(run, k, name) for k, name in enumerate(cell_names(run.states))},
        matrix=matrix_row(run),
        pairs={f"{i + 1}-{j + 1}": pair.means() for (i, j), pair in pairs.items()},
        events=tuple(e for e in run.events if e.name == "contact"),
        reduced=None if reduced is None else reduced.table(),
        full_order_s=run.statistics["wall_time"],
        step_residual_share=run.residual_share(),
        verdict=_verdict(scene, run, pairs, reduced),
    )
    save_run(run, folder / "run.npz")
    say("report", 0.2)
    result = CellsStudy(scene=scene, run=run, pairs=pairs, reduced=reduced, told=told, out=folder)
    _write_report(result, _figures(result, system, folder / "figures"))
    say("report", 1.0)
    told = dataclasses.replace(told, wall_time_s=time.perf_counter() - began)
    write_json(folder / "summary.json", plain(table_of(told)))
    return dataclasses.replace(result, told=told)


def _runs(
    scene: Scene, cache: Path, workers: int, say: Progress
) -> tuple[Trajectory, list[Trajectory]]:
    """The scene and its one-cell controls, as long as it ran."""
    several = len(scene.cells) > 1 and scene.matrix is not None
    if scene.until is None and several:
        run, *alone = run_ensemble(
            [scene, *alone_scenes(scene)],
            cache,
            workers=workers,
            progress=lambda done, total: say("full-order runs", done / total),
        )
        return run, alone
    run = run_scene(scene, cache, lambda share: say("full-order run", share))
    say("full-order run", 1.0)
    if not several or len(run) < 3:
        return run, []
    short = dataclasses.replace(scene, until=None, duration=float(run.t[-1]))
    alone = run_ensemble(
        alone_scenes(short),
        cache,
        workers=workers,
        progress=lambda done, total: say("one-cell controls", done / total),
    )
    return run, alone


def _cell_row(run: Trajectory, k: int, name: str) -> dict[str, float]:
    row = summary_of_run(run, None, name)
    row["position_error_um"] = run.error_of(f"{name}.position")
    if run.p is not None:
        row["heading_change_deg"] = float(heading_change_deg(run.p)[k])
    return row


def _verdict(scene: Scene, run: Trajectory, pairs: Mapping, reduced: ReducedCells | None) -> str:
    K = len(scene.cells)
    text = f"{K} cell{'s' if K != 1 else ''}, {run.t[-1]:g} s, full-order"
    touch = [e for e in run.events if e.name == "contact"]
    if touch:
        text += f": {touch[-1].detail} touch at {touch[-1].time:.0f} s, the run ends there"
    if pairs:
        (i, j), near = min(pairs.items(), key=lambda item: item[1].gap[0])
        m = near.means()
        text += (
            f"; between cells {i + 1} and {j + 1} the matrix moves at {m['gap_speed_nm_s']:.2f} "
            f"nm/s, {m['gap_speed_one_cell_nm_s']:.2f} with one of them alone"
        )
    if reduced is not None:
        return f"{text}; {reduced.verdict()}"
    if K > 1 and scene.matrix is not None:
        return (
            f"{text}. No model is learned from several cells: learn one from one cell (cellsys run "
            "of a scene with one), and give it here as --model"
        )
    if steered(scene):
        return f"{text}. No model was asked for: add a [training] table to the scene, or --learn"
    return f"{text}. Models are learned from scenes with exactly one steered cell on a matrix"


def _figures(result: CellsStudy, system: SpreadingSystem, folder: Path) -> dict[str, Path]:
    drawn, run, disc = {}, result.run, system.matrix
    names = cell_names(run.states)
    if names:
        figure, axes = sheet((10, 5), 1, 2)
        for ax, k in zip(axes, (0, -1), strict=True):
            shown = [
                (run.block(f"{n}.position")[k], c.body.membrane.triangles)
                for n, c in zip(names, system.cells, strict=True)
            ]
            nodes = None if disc is None else disc.position + run.block("matrix.displacement")[k]
            cells_from_above(shown, nodes, None if disc is None else disc.fibres, ax)
            ax.set_title(f"t = {run.t[k]:g} s")
        drawn["cells"] = save_png(figure, folder / "cells.png")
        if len(names) <= MOST_PATHS:
            figure, ax = sheet((9, 4.5))
            paths(run, ax)
            drawn["centres"] = save_png(figure, folder / "centres.png")
    if result.scene.matrix is not None:
        drawn["displacement_field"] = draw_displacement(
            run, result.scene.matrix, folder / "displacement_field.png"
        )
    if result.pairs:
        figure, axes = sheet((10, 4.4), 1, 2)
        pair_gaps(result.pairs, axes)
        drawn["gaps"] = save_png(figure, folder / "gaps.png")
    return drawn


def _write_report(result: CellsStudy, figures: Mapping[str, Path]) -> None:
    name, cells = html.escape(result.scene.name), result.told.cells
    alt = {"cells": "cells and matrix, before and after", "centres": "centres against time",
           "displacement_field": "displacement of the matrix",
           "gaps": "gaps and speed of the matrix in them"}  # fmt: skip
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>{name}</title><style>{STYLE}</style></head><body>",
        f"<h1>{name}</h1>",
        f"<p class='trust'><b>{html.escape(str(result))}</b></p>",
        *(image(path, alt[key]) for key, path in figures.items()),
    ]
    if cells:
        rows = list(next(iter(cells.values())))
        told = {c: texts(row) for c, row in cells.items()}
        body = [(read_out_name(r), *(told[c][r] for c in cells)) for r in rows]
        parts += ["<h2>Read-outs</h2>", table(("read-out", *cells), body)]
    if result.told.matrix:
        moved = [(read_out_name(k), v) for k, v in texts(result.told.matrix).items()]
        parts.append(table(("matrix", "value"), moved))
    if result.pairs:
        means = result.told.pairs
        rows = list(next(iter(means.values())))
        body = [(read_out_name(r), *(short_number(means[p][r]) for p in means)) for r in rows]
        parts += ["<h2>Between neighbours</h2>", table(("pair", *means), body)]
    if result.reduced is not None:
        parts += ["<h2>Reduced cells</h2>", f"<pre>{html.escape(str(result.reduced))}</pre>"]
    parts += [
        f"<p class='note'>Full-order run: {result.told.full_order_s:.3g} s.</p>",
        "</body></html>",
    ]
    write_text(result.out / "report.html", "\n".join(parts))
