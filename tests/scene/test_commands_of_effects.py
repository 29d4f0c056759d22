"""``cellsys effects``, ``cellsys sweep`` and ``cellsys schema`` on tiny scenes."""

import csv
import json

import numpy as np
import pytest

from cellsys.scene import Scene, build, step_cost
from cellsys.scene.listing import effect_list, scene_effects
from cellsys.scene.registry import LISTED
from cellsys.study.leave_one_out import Worth, leave_one_out
from tests.mechanics.small_scenes import tiny
from tests.test_cli import refused

SMALL = (
    'extends = "isolated_membrane"\nduration = "10 s"\n[[cells]]\nposition = ["0 um", "0 um"]\n'
    'radius = "4 um"\n'
)


@pytest.fixture
def scene_file(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def test_all_effects_are_listed_with_needs_units_and_sources(call):
    code, out, _ = call("effects")
    assert code == 0
    for name in LISTED:
        assert name in out
    assert "focal_adhesion or stochastic_adhesion" in out
    rows = {r["effect"]: r for r in effect_list()}
    assert rows["cortex"]["excludes"] == "cortical_tension"
    assert rows["cell_contact"]["acts on"] == "cells"
    assert all(r["what it is"] for r in rows.values())
    _, out, _ = call("effects", "--json")
    assert {r["effect"] for r in json.loads(out)} == set(LISTED)


def test_a_scene_is_listed_with_what_it_builds_and_its_shares(call, tmp_path):
    import tomllib

    text = 'extends = "isolated_membrane"\n[effects]\nnucleus = {}\n'
    (tmp_path / "s.toml").write_text(text)
    code, out, err = call("effects", "s.toml", "--json")
    assert (code, err) == (0, "")
    rows = {r["effect"]: r for r in json.loads(out)}
    system = build(Scene.parse(tomllib.loads(text)))
    assert sum(r["auxiliaries"] for r in rows.values()) == system.auxiliaries.size
    assert sum(r["states"] for r in rows.values()) == system.states.size - 3 * 189
    assert rows["nucleus"]["states"] == 180
    assert rows["volume"]["columns of W_eta"] == 567
    shares = np.array([r["share of time"] for r in rows.values()])
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.all(shares >= 0)
    assert rows["drag"]["share of time"] == 0.0
    code, out, _ = call("effects", "isolated_membrane")
    assert code == 0
    assert "%" in out


def test_clamped_columns_do_not_act():
    rows = {r["effect"]: r for r in scene_effects("passive_matrix", seconds=2.0)}
    assert 0 < rows["foundation"]["columns of W_eta"] < rows["foundation"]["auxiliaries"]


def test_leave_one_out_tells_what_each_effect_changes(call, scene_file):
    code, out, err = call("effects", "small.toml", "--measure", "--json")
    assert (code, err) == (0, "")
    result = json.loads(out)
    assert result["duration_s"] == 10.0
    worth = {w["effect"]: w for w in result["effects"]}
    assert set(worth) == {"drag", "membrane_elasticity", "volume", "cortical_tension"}
    assert "cannot be left out" in worth["drag"]["note"]
    assert worth["cortical_tension"]["motion"] > 0.1
    code, out, _ = call("effects", "small.toml", "--measure", "--duration", 5)
    assert "cortical tension: " in out
    assert "% of the time, changes" in out
    assert "5 s, without each effect in turn" in out


def test_leave_one_out_compares_the_right_runs():
    """Without cortical tension a membrane at rest stays there: nothing moves, 100 % is missing."""
    scene = Scene.parse(tiny("membrane_elasticity", "cortical_tension", cells=1, matrix=False))
    stages = []
    result = {w.effect: w for w in leave_one_out(scene, progress=lambda *a: stages.append(a))}
    assert result["cortical_tension"].motion == pytest.approx(1.0, abs=1e-3)
    assert stages[-1][1] == pytest.approx(1.0)
    assert stages == sorted(stages, key=lambda s: s[1])
    text = str(
        Worth(
            effect="cortical_tension",
            with_it=(),
            share=0.12,
            saved=0.1,
            motion=0.3,
            changes={"contact_radius_end_um": -0.18},
        )
    )
    assert text.startswith("cortical tension: 12 % of the time, changes spreading by 18 %")


def test_bad_input_of_effects_is_one_line(call, scene_file):
    refused(call("effects", "--measure"), "needs a scene")
    refused(call("effects", "small.toml", "--measure", "--duration", -1), "must be >= 0")
    refused(call("effects", "smal"), "no scene file 'smal' and no preset")
    refused(call("effects", "crawler", "--measure"), "has no effects to leave out")


def test_sweep_runs_once_and_writes_a_table(call, scene_file, tmp_path):
    arguments = (
        "sweep", "small.toml", "--set", "effects.cortical_tension.tension=0 pN/um, 200 pN/um",
        "--set", "seed=1", "--json",
    )  # fmt: skip
    code, out, err = call(*arguments)
    assert (code, err) == (0, "")
    rows = json.loads(out)
    assert [r["effects.cortical_tension.tension"] for r in rows] == ["0 pN/um", "200 pN/um"]
    assert rows[0]["height_end_um"] > rows[1]["height_end_um"]
    folder = tmp_path / "out" / "small sweep"
    table = list(csv.DictReader((folder / "sweep.csv").read_text().splitlines()))
    assert float(table[1]["height_end_um"]) == rows[1]["height_end_um"]
    stamps = {p: p.stat().st_mtime_ns for p in folder.rglob("run.json")}
    assert len(stamps) == 2
    assert all((folder / r["run"] / "run.json").exists() for r in rows)
    assert json.loads(call(*arguments)[1]) == rows
    assert {p: p.stat().st_mtime_ns for p in folder.rglob("run.json")} == stamps
    code, out, _ = call(*arguments[:-1], "-o", "elsewhere")
    assert code == 0
    assert "table: elsewhere" in out
    assert "below" in out  # the crawl of a membrane that is not pulled


def test_a_wrong_sweep_runs_nothing(call, scene_file, tmp_path):
    for setting, words in (
        ("effects.volume.modulos=1 Pa", "did you mean 'modulus'"),
        ("effects.volume.modulus", "must read key=value"),
        ("effects.volume.modulus=300 Pa,300", "has no unit"),
    ):
        refused(call("sweep", "small.toml", "--set", setting), words)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_sweep_by_two_processes_gives_the_same_table(call, scene_file):
    one, two = (
        call("sweep", "small.toml", "--set", "effects.volume.modulus=100 Pa,300 Pa",
             "--jobs", jobs, "-o", f"by{jobs}", "--json")
        for jobs in (1, 2)
    )  # fmt: skip
    assert json.loads(one[1]) == json.loads(two[1])


def test_the_parts_of_a_step_add_up():
    system = build(Scene.parse(tiny("membrane_elasticity", "volume")))
    cost = step_cost(system, 0.5, 5.0, repeats=5)
    # Whole and parts are timed in different runs: on a busy machine the rest may fall below zero.
    assert cost.rest > -0.5 * cost.whole
    assert min(cost.whole, cost.solve, *cost.laws.values()) > 0
    assert set(cost.laws) == {"membrane_elasticity", "volume"}
    # The system is as it was: nothing is watched any more.
    assert not any(callable(value) for e in system.elements for value in vars(e).values())
