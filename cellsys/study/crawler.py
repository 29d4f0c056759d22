"""`study` of a scene on a chain: the run, how it ended, how fast the cells crawled."""

from __future__ import annotations

import html
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellsys.errors import DataError, ParameterError
from cellsys.figures import crawler_run, save_png, sheet
from cellsys.mechanics.crawler import CrawlerSystem
from cellsys.mechanics.crawler_run import CrawlRun, judge
from cellsys.scene import Scene, build, run_scene
from cellsys.shown import Shown
from cellsys.store import write_json, write_text
from cellsys.study.files import plain, save_run
from cellsys.study.html import STYLE, image, table
from cellsys.study.measure import read_out_name, short_number
from cellsys.study.summary import CrawlerSummary, table_of


@dataclass(frozen=True, eq=False)
class CrawlerStudy(Shown):
    """What `study` computed of a scene on a chain.

    Attributes
    ----------
    crawl : CrawlRun
        The full-order run and its outcome; no reduced model is learned here.
    told : CrawlerSummary
        What ``summary.json`` holds; `summary` is the same as plain tables.
    out : Path
    """

    scene: Scene
    crawl: CrawlRun
    told: CrawlerSummary
    out: Path

    @property
    def summary(self) -> Mapping[str, object]:
        """What ``summary.json`` holds, as plain tables."""
        return table_of(self.told)

    def __str__(self) -> str:
        return str(self.crawl)

    def report(self) -> str:
        """The study in words, for a terminal."""
        lines = [str(self.crawl.trajectory), ""]
        for name, row in self.told.cells.items():
            lines.append(f"{name}:")
            lines += [f"  {read_out_name(k):28s} {v:.4g}" for k, v in row.items()]
        return "\n".join([*lines, "", str(self)])


def study_crawler(
    scene: Scene, out: str | Path, progress: Callable[[str, float], None] | None = None
) -> CrawlerStudy:
    """Run a scene on a chain and report on it.

    Writes into `out`: ``run.npz``, ``summary.json``, ``figures/*.png``, ``report.html``.

    Raises
    ------
    IntegrationError
        When the run fails or the switches chatter; nothing is written then.
    """
    began = time.perf_counter()
    say = progress or (lambda stage, share: None)
    folder = Path(out)
    say("full-order run", 0.0)
    system = build(scene)
    if not isinstance(system, CrawlerSystem) or scene.matrix is None:
        raise ParameterError("this study is of crawlers, and the scene has none on a chain")
    matrix, run = scene.matrix, run_scene(scene)
    crawl = judge(system, run)
    say("full-order run", 1.0)
    told = CrawlerSummary(
        scene=scene.name,
        fingerprint=scene.fingerprint(),
        outcome=crawl.outcome,
        reason=crawl.reason,
        switches=len(crawl.switches()),
        chatter=crawl.chatter,
        cells=cell_table(crawl),
        integrator=run.statistics["integrator"],
        full_order_s=run.statistics["wall_time"],
    )
    save_run(run, folder / "run.npz", {"switch_times": crawl.switches()})
    say("report", 0.2)
    figures = {}
    for name in ("crawler_run", "chain_displacement"):
        figure, ax = sheet((9, 5))
        if name == "crawler_run":
            crawler_run(crawl, ax)
        else:
            matrix.draw(run, ax)
        figures[name] = save_png(figure, folder / "figures" / f"{name}.png")
    result = CrawlerStudy(scene, crawl, told, folder)
    _write_report(result, figures)
    say("report", 1.0)
    told = replace(told, wall_time_s=time.perf_counter() - began)
    write_json(folder / "summary.json", plain(table_of(told)))
    return replace(result, told=told)


def cell_table(crawl: CrawlRun) -> dict[str, dict[str, float]]:
    """Per cell: switches, time of the last one (NaN without any), speed, nodes at the end.

    Speed and displacement are those of the middle between lead and trail, along the heading. The
    crawl speed is taken from the start to the first sample after the cell's last switch, so that
    standing still afterwards does not count; without a switch over the whole run. um/s.
    """
    run = crawl.trajectory
    if run is None:
        raise DataError(f"the run was stopped: {crawl.reason}")
    values = {}
    for k, cell in enumerate(crawl.system.cells):
        name = f"cell{k + 1}"
        middle = 0.5 * (run.block(f"{name}.lead") + run.block(f"{name}.trail"))
        moved = cell.heading * (middle - middle[0])
        times = crawl.switches(f"{name} ")
        until = int(np.searchsorted(run.t, times[-1])) if times.size else len(run) - 1
        until = max(until, 1)
        values[name] = {
            "switches": len(times),
            "switches_of_lead": len(crawl.switches(f"{name} lead")),
            "switches_of_trail": len(crawl.switches(f"{name} trail")),
            "last_switch_s": float(times[-1]) if times.size else float("nan"),
            "displacement_end_um": float(moved[-1]),
            "crawl_speed_um_per_s": float(moved[until] / (run.t[until] - run.t[0])),
            "lead_node_at_end": int(run.block(f"{name}.i_lead")[-1]),
            "trail_node_at_end": int(run.block(f"{name}.i_trail")[-1]),
        }
    return values


def _write_report(result: CrawlerStudy, figures: Mapping[str, Path]) -> None:
    name, cells = html.escape(result.scene.name), result.told.cells
    rows = list(next(iter(cells.values())))
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>{name}</title><style>{STYLE}</style></head><body>",
        f"<h1>{name}</h1>",
        f"<p class='trust'><b>{html.escape(str(result))}</b></p>",
        image(figures["crawler_run"], "lead and trail against time, a tick at every switch"),
        table(
            ("read-out", *cells),
            [(read_out_name(r), *(short_number(cells[c][r], 4) for c in cells)) for r in rows],
        ),
        "<h2>The chain</h2>",
        image(figures["chain_displacement"], "displacement of the chain against time"),
        "<p class='note'>Crawl speed: from the start to the cell's last switch. "
        f"{html.escape(result.told.integrator)}, {result.told.full_order_s:.3g} s. "
        "The full-order run only: the default parameters are a working set without dimensions; "
        "reduced models of it are compared in analysis/thesis/fig07_08_crawler.py.</p>",
        "</body></html>",
    ]
    write_text(result.out / "report.html", "\n".join(parts))
