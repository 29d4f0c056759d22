"""Commands for somebody who starts: new, doctor; tables and progress as they are read."""

import dataclasses
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from cellsys.accuracy import budget
from cellsys.cli import console, doctor
from cellsys.errors import ParameterError, SceneError
from cellsys.scene import Scene, load_scene
from cellsys.scene.listing import effect_table, setting_text
from cellsys.scene.outlines import OUTLINES, outline
from cellsys.scene.registry import EFFECTS
from tests.loop.systems import make
from tests.test_cli import refused

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.parametrize("kind", OUTLINES)
def test_an_outline_is_its_preset_with_words(kind):
    text = outline(kind, "my scene")
    scene = Scene.parse(tomllib.loads(text))
    assert scene.name == "my scene"
    preset = load_scene(OUTLINES[kind])
    assert scene.fingerprint() == preset.fingerprint()
    assert scene.learn == preset.learn
    assert max(map(len, text.splitlines())) <= 100
    for name in scene.effects:  # a line of words above each, its other parameters below
        assert EFFECTS[name].__doc__.split()[0] in text


def test_every_setting_of_the_list_is_one_that_a_file_takes():
    """Parameters as they are shown, put into a scene: the defaults, so the same scene."""
    lines = {}
    for row in effect_table():
        lines.setdefault(row["effect"], []).append(setting_text(row)[0])
    for name, settings in lines.items():
        text = f"[effects.{name}]\n" + "\n".join(settings)
        table = tomllib.loads(text)["effects"]
        effect = EFFECTS[name]
        given = {p.name: p.default for p in dataclasses.fields(effect) if "unit" in p.metadata}
        base = {"name": "x", "duration": "1 s", "matrix": {}, "effects": {"drag": {}} | table}
        fault = ""
        try:
            made = Scene.parse(base).effects[name]
        except SceneError as error:  # what it needs is missing; its own values are taken
            fault = str(error)
        else:
            assert {k: getattr(made, k) for k in given} == given
        assert f"effects.{name}." not in fault


def test_new_writes_a_scene_and_never_over_one(call, tmp_path):
    code, out, _ = call("new", "mine", "--kind", "pair")
    assert code == 0
    assert "cellsys run mine.toml" in out
    before = (tmp_path / "mine.toml").read_text()
    assert load_scene(tmp_path / "mine.toml").name == "mine"
    refused(call("new", "mine"), "exists")
    assert (tmp_path / "mine.toml").read_text() == before
    refused(call("new", "other", "--kind", "gell"), "cell, pair, ten")
    assert not (tmp_path / "other.toml").exists()
    with pytest.raises(ParameterError, match="no quotes"):
        outline("cell", 'a"b')


def test_doctor_names_every_library_and_extra_of_the_project(call):
    code, out, _ = call("doctor")
    assert code == 0
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = {re.split(r"[\[>=<]", text)[0] for text in project["dependencies"]}
    assert names == set(doctor.LIBRARIES)
    assert set(project["optional-dependencies"]) == set(doctor.EXTRAS)
    for name in (*names, *doctor.EXTRAS, "BLAS threads", "free memory"):
        assert name in out
    assert doctor.version_of("no such distribution") is None


def test_names_are_never_cut_in_tables(monkeypatch, capsys):
    name = "a_very_long_name_of_an_effect_that_somebody_wrote"
    for columns in ("40", None):
        if columns is None:
            monkeypatch.delenv("COLUMNS", raising=False)
        else:
            monkeypatch.setenv("COLUMNS", columns)
        console.print_table("title", ["name", "value"], [[name, "1.5"], ["b", "[x]"]])
        out = capsys.readouterr().out
        assert "…" not in out
        assert all(part in out for part in (name[:20], name[-12:]))
        assert "[x]" in out


def test_a_log_gets_a_line_a_minute(monkeypatch, capsys):
    now = 0.0
    progress = console._a_line_a_minute(lambda: now)
    for now in range(0, 200, 10):
        progress("runs", now / 200)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "runs: 30 %, about 140 s left", "runs: 60 %, about 80 s left", "runs: 90 %, about 20 s left"
    ]  # fmt: skip


def test_a_budget_says_how_far_it_is():
    stages = {}
    t = np.linspace(0.0, 20.0, 5)
    found = budget(
        make(), error=1e-2, t=t, training=2, held_out=1,
        progress=lambda stage, share: stages.setdefault(stage, []).append(share),
    )  # fmt: skip
    assert found.integrator is not None
    assert list(stages) == ["start 1 of 2", "start 2 of 2", "held-out starts"]
    for shares in stages.values():
        assert shares == sorted(shares)
        assert shares[-1] == 1.0
    assert len(stages["start 1 of 2"]) > 5
