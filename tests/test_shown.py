"""What a notebook shows: `repr` is the first line of `str`, `_repr_html_` its table."""

import ast
import importlib
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import cellsys as cs
from cellsys.shown import Shown, table_html
from tests.population.systems import model
from tests.reduction.systems import one_step_data

PACKAGE = Path(cs.__file__).parent


def results():
    """Every class of the package that says in `str` what it is, errors apart."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.ClassDef) and any(
                isinstance(f, ast.FunctionDef) and f.name == "__str__" for f in node.body
            ):
                parts = ("cellsys", *path.relative_to(PACKAGE).with_suffix("").parts)
                found = getattr(importlib.import_module(".".join(parts)), node.name)
                if not issubclass(found, Exception):
                    yield found


@pytest.mark.parametrize("kind", list(results()), ids=lambda c: c.__name__)
def test_every_result_is_shown(kind):
    assert issubclass(kind, Shown)
    assert kind.__repr__ in (Shown.__repr__, cs.RootSet.__repr__)


class Cells(HTMLParser):
    """The cells of all tables, by row."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.open = [], []
        self.feed(text)
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data


def shown():
    train, test = one_step_data(runs=3, T=30), one_step_data(seed=4, runs=2, T=30)
    fitted = cs.reduce(train, order=2, method=cs.LeastSquares(), test=test)
    loop = cs.closed_loop(model(steered=True))
    run = loop.simulate(np.arange(0.0, 20.0, 1.0), cs.DOP853(rtol=1e-6, atol=1e-8))
    return [
        fitted, fitted.card, run, cs.poles(fitted.plant()), cs.damping(fitted.plant()),
        cs.margins(loop.open_loop()), cs.stability(fitted.plant()),
        cs.compare_reductors(train, test, [2], [cs.LeastSquares(), cs.PCR()]),
        cs.couple(model(), 3).stability(),
    ]  # fmt: skip


def test_first_line_and_table():
    tables = 0
    for result in shown():
        if not isinstance(result, np.ndarray):
            assert repr(result) == str(result).splitlines()[0]
        page = result._repr_html_()
        found = Cells(page).rows
        tables += bool(found)
        assert len({len(row) for row in found}) <= 1
        # naive: the text as it stands would be read as markup
        assert "<" not in page.replace("<", "", 0).split("<p>")[1].split("</p>")[0]
    assert tables >= 4


def test_roots_show_their_bounds():
    roots = cs.poles(model().plant())
    assert str(roots.error_bound[0])[:3] in repr(roots).splitlines()[1]
    assert "+-" in repr(roots)
    rows = Cells(roots._repr_html_()).rows
    assert rows[0][:2] == ["pole", "error bound"]
    assert len(rows) == 1 + len(roots)
    assert complex(rows[1][0]) == pytest.approx(roots[0], rel=1e-3)


@pytest.mark.parametrize("name", ["spreading", "crawler", "ten_cells", "two_cells"])
def test_scenes_fit_on_ten_lines(name):
    scene = cs.load_scene(PACKAGE.parent / "examples" / f"{name}.toml")
    assert len(repr(scene).splitlines()) <= 10
    assert max(map(len, repr(scene).splitlines())) <= 100
    assert scene.name in repr(scene)


def test_tables_hold_any_text():
    rows = [["<b>", 1.23456789], ["a & b", 2]] + [["x", 0]] * 100
    found = Cells(table_html(["name", "value"], rows)).rows
    assert found[1] == ["<b>", "1.235"]
    assert found[-1] == ["... and 42 more"]
