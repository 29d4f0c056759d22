"""Every example and analysis script runs in its quick form, in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# The others take some seconds or more even in their quick form: CI runs them with the slow tests.
FAST = {"delay_and_data.py", "bring_your_own_model.py", "bond_graph.py", "python_control.py"}
SCRIPTS = sorted(
    [
        *(ROOT / "examples").glob("*.py"),
        *(ROOT / "analysis").glob("*.py"),
        *(ROOT / "analysis" / "thesis").glob("fig*.py"),
        ROOT / "analysis" / "thesis" / "smooth_case.py",
        ROOT / "analysis" / "thesis" / "appendix.py",
    ],
    key=lambda p: p.name,
)


def run(script, folder, *arguments):
    path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH", "")) if p)
    return subprocess.run(
        [sys.executable, "-W", "error::UserWarning", str(script), *arguments],
        cwd=folder, env={**os.environ, "PYTHONPATH": path, "MPLBACKEND": "Agg"},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    "script",
    [
        pytest.param(p, id=p.name, marks=[] if p.name in FAST else [pytest.mark.slow])
        for p in SCRIPTS
    ],
)
def test_script_runs_in_its_quick_form(script, tmp_path, tmp_path_factory, monkeypatch):
    # They share one cache, as they do for a user.
    monkeypatch.setenv("CELLSYS_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))
    done = run(script, tmp_path, "--quick")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert "Traceback" not in done.stderr
    # nothing is left behind where it was called
    assert not list(tmp_path.iterdir())


def test_examples_are_short():
    for script in (ROOT / "examples").glob("*.py"):
        assert len(script.read_text().splitlines()) < 60, script.name
