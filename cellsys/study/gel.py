"""`study` of a scene in a gel: compaction beside its one-cell controls, pictures, a report."""

from __future__ import annotations

import html
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from cellsys.figures import gel_course, gel_section, gel_side, gel_thickness, save_png, sheet
from cellsys.observe import GelContraction, alone_scenes, gel_contraction, gel_read_outs
from cellsys.scene import Scene, run_ensemble
from cellsys.shown import Shown
from cellsys.store import write_json, write_text
from cellsys.store.cache import cache_folder
from cellsys.study.files import plain, save_run
from cellsys.study.html import STYLE, image, table
from cellsys.study.measure import short_number
from cellsys.trajectory import Trajectory

Progress = Callable[[str, float], None]
MOST_CONTROLS = 4  # of one cell each; of more cells the first alone is run


@dataclass(frozen=True, eq=False, kw_only=True)
class GelStudy(Shown):
    """What `study` computed of a scene in a gel.

    Attributes
    ----------
    run : Trajectory
        The scene, full-order.
    alone : tuple of Trajectory
        Its cells one by one in the same gel, the other cavities empty; of more than
        `MOST_CONTROLS` cells the first.
    contraction, controls : GelContraction
        Thickness along the axis, of the scene and of `alone`.
    read_outs : mapping
        `gel_read_outs` of the scene and of every control.
    """

    scene: Scene
    run: Trajectory
    alone: tuple[Trajectory, ...]
    contraction: GelContraction
    controls: tuple[GelContraction, ...]
    read_outs: Mapping[str, Mapping[str, float]]
    out: Path

    @property
    def summary(self) -> Mapping[str, object]:
        """What ``summary.json`` holds."""
        return {
            "scene": self.scene.name,
            "fingerprint": self.scene.fingerprint(),
            "matrix": self.scene.matrix_kind.title,
            "read_outs": self.read_outs,
            "full_order_s": self.run.statistics["wall_time"],
            "step_residual_share": self.run.residual_share(),
            "verdict": str(self),
        }

    def __str__(self) -> str:
        count = len(self.scene.cells)
        text = (
            f"{count} cell{'s' * (count != 1)} in {self.scene.matrix_kind.title}, "
            f"{self.run.t[-1]:g} s, full-order: {self.contraction}"
        )
        if self.controls:
            one = self.controls[0]
            text += (
                f"; the first cell alone: {one}. Ratio of greatest contractions "
                f"{self.contraction.greatest_contraction / one.greatest_contraction:.2f}, of "
                f"integrals {self.contraction.integral_um / one.integral_um:.2f}"
            )
        return text

    def report(self) -> str:
        """The study in words, for a terminal."""
        lines = [str(self.run), ""]
        for name, row in self.read_outs.items():
            lines.append(f"{name}:")
            lines += [f"  {key:28s} {short_number(value)}" for key, value in row.items()]
        return "\n".join([*lines, "", str(self)])


def study_gel(
    scene: Scene,
    out: str | Path,
    *,
    workers: int = 2,
    cache: Path | None = None,
    progress: Progress | None = None,
) -> GelStudy:
    """Run a scene in a gel and its one-cell controls, read them out, report.

    Writes into `out`: ``run.npz``, ``summary.json``, ``figures/*.png`` and ``report.html``.
    """
    began = time.perf_counter()
    say = progress or (lambda stage, share: None)
    folder = Path(out)
    runs = run_ensemble(
        [scene, *gel_controls(scene)],
        cache_folder() if cache is None else cache,
        workers=workers,
        progress=lambda done, total: say("full-order runs", done / total),
    )
    run, *alone = runs
    names = [f"cell {k + 1} alone" for k in range(len(alone))]
    result = GelStudy(
        scene=scene,
        run=run,
        alone=tuple(alone),
        contraction=gel_contraction(run),
        controls=tuple(gel_contraction(r) for r in alone),
        read_outs={
            "all cells": gel_read_outs(run),
            **{n: gel_read_outs(r) for n, r in zip(names, alone, strict=True)},
        },
        out=folder,
    )
    save_run(run, folder / "run.npz")
    say("report", 0.2)
    _write_report(result, _figures(result, folder / "figures"))
    say("report", 1.0)
    told = {**result.summary, "wall_time_s": time.perf_counter() - began}
    write_json(folder / "summary.json", plain(told))
    return result


def gel_controls(scene: Scene) -> list[Scene]:
    """The one-cell controls that a study runs beside a scene in a gel."""
    if len(scene.cells) < 2:
        return []
    alone = alone_scenes(scene)
    return alone if len(alone) <= MOST_CONTROLS else alone[:1]


def _figures(result: GelStudy, folder: Path) -> dict[str, Path]:
    run, drawn = result.run, {}
    figure, axes = sheet((9, 8), 2, 1)
    for ax, k in zip(axes, (0, -1), strict=True):
        gel_side(run, ax, k=k)
    drawn["side"] = save_png(figure, folder / "side.png")
    figure, ax = sheet((10, 4.6))
    gel_section(run, -1, ax)
    drawn["section"] = save_png(figure, folder / "section.png")
    controls = {"cell 1 alone": result.controls[0]} if result.controls else {}
    figure, axes = sheet((11, 4.4), 1, 2)
    gel_thickness(result.contraction, axes[0], controls=controls)
    gel_course({"all cells": result.contraction, **controls}, axes[1])
    drawn["thickness"] = save_png(figure, folder / "thickness.png")
    return drawn


def _write_report(result: GelStudy, figures: Mapping[str, Path]) -> None:
    alt = {"side": "cells and gel from the side, before and after",
           "section": "displacement over local volume in a section",
           "thickness": "thickness along the axis, contraction over time"}  # fmt: skip
    rows = list(dict.fromkeys(key for row in result.read_outs.values() for key in row))
    body = [
        (key, *(short_number(row[key]) if key in row else "" for row in result.read_outs.values()))
        for key in rows
    ]
    found = result.contraction
    slices = [(f"{x:g}", f"{v:.3f}") for x, v in zip(found.x, found.volume_ratio[-1], strict=True)]
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>{html.escape(result.scene.name)}</title><style>{STYLE}</style></head><body>",
        f"<h1>{html.escape(result.scene.name)}</h1>",
        f"<p class='trust'><b>{html.escape(str(result))}</b></p>",
        *(image(path, alt[key]) for key, path in figures.items()),
        "<h2>Read-outs</h2>",
        table(("read-out", *result.read_outs), body),
        f"<h2>Slices of {found.width:g} um at the end</h2>",
        table(("x at rest (um)", "volume / volume at rest"), slices),
        f"<p class='note'>Full-order run: {result.run.statistics['wall_time']:.3g} s.</p>",
        "</body></html>",
    ]
    write_text(result.out / "report.html", "\n".join(parts))
