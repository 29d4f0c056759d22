"""Every result draws itself, into given axes or its own, and nothing heavy loads early."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import control as ct
import matplotlib
import numpy as np
import pytest

import cellsys.response as response
from cellsys import figures
from tests.response import gallery

matplotlib.use("Agg")
import matplotlib.pyplot as plt


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    plt.close("all")


def reduced(system: tuple) -> response.Realization:
    return response.balanced_truncation(system, order=2).system


def results() -> dict[str, object]:
    s = ct.tf("s")
    L = ct.ss(2 * (s + 0.5) / (s * (s + 1) * (s**2 + 0.4 * s + 4)))
    stable = gallery.random_stable(6, 2, 2, 0)
    step = (np.diag([0.5, 0.9]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), 0.1)
    square = gallery.random_stable(4, 2, 2, 3)
    return {
        "poles": response.poles(L),
        "zeros": response.zeros(L),
        "discrete poles": response.poles(step),
        "damping": response.damping(L),
        "frequency": response.frequency_response(stable),
        "margins": response.margins(L),
        "matrix margins": response.margins(square),
        "delayed margins": response.margins(L, delay=0.5),
        "samples": response.margins(response.frequency_response(L)),
        "stability": response.stability(gallery.bidiagonal(20)),
        "discrete stability": response.stability(step),
        "no states": response.stability(np.zeros((0, 0))),
        "pseudospectra": response.pseudospectra(gallery.grcar(10), points=12),
        "locus": response.root_locus(L),
        "step": response.step_response(stable),
        "impulse": response.impulse_response(step),
        "forced": response.forced_response(L, np.linspace(0, 1, 9), np.ones(9)),
        "sensitivity": response.sensitivity(gallery.lag_chain(3, 0.5)),
        "truncation": response.balanced_truncation(stable, order=2),
        "gramian": response.controllability_gramian(stable),
        "error": response.error_system(stable, reduced(stable)),
        "participation": response.participation(stable),
    }


def test_plot_with_and_without_axes() -> None:
    for name, result in results().items():
        before = len(plt.get_fignums())
        assert result.plot() is not None, name
        assert len(plt.get_fignums()) == before + 1, name
        ax = plt.figure().add_subplot()
        drawn = result.plot(ax)
        assert drawn is ax, name
        assert ax.has_data() or name == "no states", name
        plt.gcf().canvas.draw()  # a warning while drawing is an error here
        assert len(str(result)) > 3
        plt.close("all")


def test_bode_in_two_axes_and_singular_values() -> None:
    found = response.frequency_response(gallery.random_stable(6, 2, 2, 0))
    _, axes = plt.subplots(2, 1)
    assert figures.bode(found, ax=axes) == tuple(axes)
    assert len(axes[0].lines) == len(axes[1].lines) == 4
    assert len(figures.singular_values(found).lines) == 2
    margins = response.margins(gallery.lag_chain(100, 0.5))
    upper, _ = figures.bode(margins)
    assert "2.101" in upper.get_title()
    # Stems from 0 dB and from -180 deg to where the margins are read.
    tall = [line for line in upper.lines if len(line.get_xdata()) == 2 and line.get_color() == "C3"]
    assert tall[0].get_ydata() == pytest.approx([0.0, -20 * np.log10(margins.gain_margin)])
    _, lower = figures.bode(response.margins(ct.tf([4], [1, 2, 1])))
    (stem,) = [v for v in lower.lines if len(v.get_xdata()) == 2 and v.get_color() == "C3"]
    assert stem.get_ydata()[0] == pytest.approx(-180.0)
    unstable = response.margins(ct.tf([10], [1, 3, 3, 1]))
    assert "NOT stable" in figures.bode(unstable)[0].get_title()
    pair = figures.bode(found, label="a")
    figures.bode(found, pair, label="b", color="k")
    assert len(pair[0].get_legend().get_texts()) == 8
    # Four channels are told apart by a legend; one needs none.
    assert len(figures.nyquist(found).get_legend().get_texts()) == 4
    assert figures.nyquist(margins).get_legend() is None


def test_importing_the_room_loads_nothing_heavy() -> None:
    code = (
        "import sys, cellsys.response; "
        "bad = {'control', 'matplotlib', 'casadi', 'numba', 'slycot'} & set(sys.modules); "
        "sys.exit(f'loaded {bad}' if bad else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_cost_script_runs_in_its_quick_form() -> None:
    done = subprocess.run(
        [sys.executable, "analysis/response_cost.py", "--quick"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert "fastest other" in done.stdout


@pytest.mark.parametrize("norm", [response.h2_norm, response.hinf_norm])
def test_norms_draw_the_singular_values(norm):
    system = ct.ss([[-0.1, 1.0], [-1.0, -0.1]], [[0.0], [1.0]], [[1.0, 0.0]], 0, 0)
    ax = norm(system).plot()
    heights = np.concatenate([line.get_ydata() for line in ax.lines])
    # No drawn singular value lies above the H-infinity norm, and its peak is on the grid.
    assert heights.max() <= 20 * np.log10(float(response.hinf_norm(system))) + 1e-6
    assert len(ax.lines) == (2 if norm is response.hinf_norm else 1)


def test_the_stub_lists_what_the_package_hands_out():
    """Type checkers read the stub, Python the list of lazy_loader."""
    stub = ast.parse(Path(figures.__file__).with_suffix(".pyi").read_text("utf-8"))
    listed = [a.name for n in stub.body if isinstance(n, ast.ImportFrom) for a in n.names]
    assert sorted(listed) == sorted(figures.__all__)
