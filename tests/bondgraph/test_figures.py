"""Drawings: every bond has its stroke at the end that receives the effort."""

from __future__ import annotations

import runpy
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from cellsys.figures import bond_graph, crawler_predictions, error_against_amplitude
from cellsys.integrate import DOP853
from cellsys.mechanics.crawler import Crawler, build_crawlers
from cellsys.mechanics.crawler_run import crawl
from tests.bondgraph import graphs

mpl.use("Agg")
EXAMPLE = Path(__file__).parents[2] / "examples" / "bond_graph.py"


@pytest.fixture(autouse=True)
def _closed():
    import matplotlib.pyplot as plt

    yield
    plt.close("all")


@pytest.mark.parametrize("case", graphs.ALL, ids=lambda f: f.__name__)
def test_graph_with_strokes(case):
    graph, _, _ = case()
    ax = bond_graph(graph)
    strokes = [line for line in ax.lines if line.get_color() == "C3"]
    assert len(strokes) == len(graph.joined)
    assert graph.plot(ax=ax) is ax
    drawn = {text.get_text().split("\n")[-1] for text in ax.texts}
    assert {e.name for e in graph.elements} <= drawn


def test_crawler_figures():
    run = crawl(build_crawlers([Crawler()]), DOP853(rtol=1e-5, atol=1e-7), np.linspace(0, 3, 31))
    ax = run.plot()
    assert {t.get_text() for t in ax.get_legend().get_texts()} == {"cell1 lead", "cell1 trail"}
    edges = run.trajectory.x[:, :2]
    ax = crawler_predictions(run.trajectory.t, edges, {"bad": np.full_like(edges, np.inf)})
    assert ax.get_ylim()[1] < 30
    ax = error_against_amplitude(np.array([1.0, 2.0]), {"a": np.array([0.1, 0.2])})
    assert ax.get_xscale() == "log"


def test_example_writes_only_where_told(tmp_path, capsys):
    main = runpy.run_path(str(EXAMPLE))["main"]
    main(quick=True, out=str(tmp_path / "figures"))
    assert "steady speed at 12 V: 585.4 rad/s" in capsys.readouterr().out
    assert {p.name for p in (tmp_path / "figures").iterdir()} == {"bode.png", "graph.png"}


def test_crawler_example(tmp_path, capsys):
    main = runpy.run_path(str(EXAMPLE.with_name("crawler.py")))["main"]
    main(quick=True, out=str(tmp_path))
    printed = capsys.readouterr().out
    assert "one cell: crawler finished (18 switches)" in printed
    assert "on a soft chain: crawler stalled" in printed
    assert len(list(tmp_path.iterdir())) == 3
