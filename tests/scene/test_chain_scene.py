"""Scenes on a chain: the same system as from Python, refusals with the reason, runs and study."""

import copy
import dataclasses
import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import cellsys as cs
from cellsys.effects.commands import Commands, History
from cellsys.errors import IntegrationError, MemoryBudgetError, SceneError
from cellsys.geometry.chain import Chain
from cellsys.integrate import LSODA, Radau
from cellsys.mechanics.crawler import Crawler, build_crawlers
from cellsys.samples import snapshots
from cellsys.scene import CellScene, ChainScene, Scene, build, run_ensemble, run_scene
from cellsys.scene.ensemble import read_run
from cellsys.scene.listing import scene_table
from cellsys.scene.load import scene_from_plain
from cellsys.scene.registry import EFFECTS
from tests.mechanics.scenes import TABLE as DISC

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "crawler.toml"
TABLE = tomllib.loads(EXAMPLE.read_text("utf-8"))
PAIR = (Crawler(), Crawler(heading=-1, trail_node=37, lead_node=33))


def changed(path, value, spec=TABLE):
    """The example with one entry set."""
    out = copy.deepcopy(spec)
    place, keys = out, path.split(".")
    for key in keys[:-1]:
        place = place[int(key)] if isinstance(place, list) else place.setdefault(key, {})
    place[keys[-1]] = value
    return out


def short(**cell):
    """One cell for 2 s."""
    return Scene.parse(
        {"name": "short", "duration": "2 s", "matrix": {"kind": "chain"}, "cells": [cell]}
    )


def test_the_example_is_the_system_of_the_python_interface():
    scene = cs.load_scene(EXAMPLE)
    system, same = cs.build(scene), build_crawlers(PAIR, Chain())
    assert scene.cells == PAIR
    assert system.states == same.states
    assert np.array_equal(system.x0, same.x0)
    rng = np.random.default_rng(1)
    for _ in range(20):
        x = same.x0.copy()
        x[:-4] += 0.2 * rng.standard_normal(x.size - 4)
        assert np.array_equal(system.rhs(0.0, x), same.rhs(0.0, x))


def test_every_parameter_of_chain_and_crawler_can_be_written_in_any_unit():
    chain = Chain(nodes=50, spacing=2.0, stiffness=90.0, stiffening=10.0, drag=0.25)
    cell = Crawler(
        mass=0.1, drag=2.0, drag2=0.1, stiffness=3.0, stiffness3=0.25, damping=0.75, length=5.0,
        adhesion_trail=4.0, adhesion_lead=5.0, grab=0.2, rupture=0.4, heading=-1, trail_node=20,
        lead_node=15, trail=39.5, lead=30.5, trail_velocity=-0.5, lead_velocity=-0.25,
    )  # fmt: skip
    # Powers of two of the internal unit, or the unit itself: the same floats.
    scene = Scene.parse(
        {
            "name": "x",
            "duration": "1 s",
            "matrix": {
                "kind": "chain", "nodes": 50, "spacing": "2 um", "stiffness": "90 pN",
                "stiffening": 10, "drag": "0.25 pN s/um",
            },
            "cells": [{
                "polarity": "-180 deg", "mass": "0.1 pN s^2/um", "drag": "2 pN s/um",
                "drag2": "0.1 pN s^2/um^2", "stiffness": "3 pN/um", "stiffness3": "0.25 pN/um^3",
                "damping": "0.75 pN s/um", "length": "5 um", "adhesion_trail": "4 pN/um",
                "adhesion_lead": "5 pN/um", "grab": "0.2 um", "rupture": "0.4 um",
                "trail_node": 20, "lead_node": 15, "trail": "39.5 um", "lead": "30.5 um",
                "trail_velocity": "-0.5 um/s", "lead_velocity": "-0.25 um/s",
            }],
        }
    )  # fmt: skip
    assert scene.cells == (cell,)
    assert scene.matrix == ChainScene(**dataclasses.asdict(chain))
    named = {f.name for f in dataclasses.fields(Crawler)} - {"heading"} | {"polarity"}
    schema = json.dumps(cs.scene_schema())
    assert all(f'"{name}"' in schema for name in named | {"stiffening"})


MISTAKES = [
    ("matrix.diameter", "60 um", "belongs to matrix.kind = 'disc', not to 'chain'; known: "),
    ("matrix.modulus", "5 kPa", "belongs to matrix.kind = 'disc', not to 'chain'; did you mean"),
    ("matrix.stifness", "5 pN", "unknown key 'matrix.stifness'; did you mean 'stiffness'"),
    ("matrix.drag", "0 pN s/um", "drag must be > 0"),
    ("matrix.drag", "1 pN", "wrong dimension"),
    ("matrix.nodes", 1, "nodes must be a whole number >= 2"),
    ("matrix.nodes", True, "matrix.nodes"),
    ("matrix.nodes", 10**400, "matrix.nodes"),
    ("step", "0.5 s", "belongs to matrix.kind = 'disc'"),
    ("commands", {}, "belongs to matrix.kind = 'disc'"),
    ("training", {}, "belongs to matrix.kind = 'disc'"),
    ("cells.0.position", ["1 um", "0 um"], "belongs to matrix.kind = 'disc'"),
    ("cells.1.effects", {}, "belongs to matrix.kind = 'disc'"),
    ("cells.1.lead_nod", 3, "did you mean 'lead_node'"),
    ("cells.1.polarity", "90 deg", "cells[1].polarity must be '0 deg' (right) or '180 deg' (left)"),
    ("cells.1.polarity", "0 deg", "cells[1]: Crawler.lead_node = 33 must lie ahead"),
    ("cells.0.mass", "0 pN s^2/um", "cells[0]: Crawler.mass must be > 0"),
    ("cells.0.grab", "nan um", "grab"),
    ("cells.1.trail_node", 41, "must be one of the chain's nodes 1..40"),
    ("cells.0.lead_node", 33, "cell1 and cell2 overlap on nodes 33..33"),
    ("cells", [], "at least one cell"),
    ("effects.draag", {}, "did you mean 'drag'"),
    ("duration", "0 s", "duration must be > 0"),
    ("sample", "13 s", "longer than duration"),
]


@pytest.mark.parametrize(
    ("path", "value", "words"), MISTAKES, ids=[f"{m[0]}-{m[2][:18]}" for m in MISTAKES]
)
def test_mistakes_are_refused_in_one_line(path, value, words):
    with pytest.raises(SceneError) as caught:
        Scene.parse(changed(path, value))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("path", "value"),
    [("matrix.spacing", "1 um"), ("matrix.drag", "1 pN s/um"), ("cells.0.lead_node", 8)],
)
def test_keys_of_a_chain_are_refused_on_a_disc(path, value):
    with pytest.raises(SceneError, match=r"belongs to matrix.kind = 'chain', not to 'disc'; "):
        Scene.parse(changed(path, value, DISC))


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_is_refused_with_both_names_and_its_own_reason(name):
    with pytest.raises(SceneError) as caught:
        Scene.parse(changed(f"effects.{name}", {}))
    text = str(caught.value)
    assert text.startswith(f"effects.{name} has no meaning with matrix.kind = 'chain': ")
    assert "laws are fixed" not in text, "an effect without a reason of its own"


def test_parts_of_the_other_kind_are_refused_in_python_too():
    scene, disc = short(), Scene.parse(DISC)
    with pytest.raises(SceneError, match="must be a Crawler"):
        dataclasses.replace(scene, cells=(CellScene(),))
    with pytest.raises(SceneError, match="must be a ChainScene"):
        dataclasses.replace(disc, cells=(Crawler(),))
    with pytest.raises(SceneError, match="commands have no meaning"):
        dataclasses.replace(scene, commands=Commands(History((0.0,), (0.0,)), None))
    with pytest.raises(SceneError, match="no headings to train on"):
        cs.training_scenes(scene)
    with pytest.raises(MemoryBudgetError, match=r"chain of 10+ nodes needs about .* GB .* free"):
        build(dataclasses.replace(scene, matrix=ChainScene(nodes=10**12)))


def test_canonical_values_give_the_scene_back_and_the_fingerprint_sees_every_change():
    scene = Scene.parse(TABLE)
    plain = json.loads(json.dumps(scene.canonical()))
    assert scene_from_plain(plain) == scene
    assert scene_from_plain(plain).fingerprint() == scene.fingerprint()
    assert dataclasses.replace(scene, name="other").fingerprint() == scene.fingerprint()
    seen = {scene.fingerprint(), Scene.parse(DISC).fingerprint()}
    for path, value in (
        ("matrix.stiffness", "101 pN"), ("matrix.nodes", 41), ("cells.0.mass", "0.3 pN s^2/um"),
        ("cells.1.lead", "32.9 um"), ("duration", "13 s"), ("sample", "0.2 s"),
    ):  # fmt: skip
        found = Scene.parse(changed(path, value)).fingerprint()
        assert found not in seen
        seen.add(found)


def test_a_run_is_reproducible_and_cached(tmp_path):
    scene = short()
    first, again = run_scene(scene), run_scene(scene)
    assert [e.name for e in first.events] == [e.name for e in again.events]
    for name in ("x", "eta"):
        assert np.array_equal(getattr(first, name), getattr(again, name))
    stored = run_ensemble([scene], tmp_path)[0]
    back = read_run(next(p for p in tmp_path.iterdir() if p.is_dir()))
    for run in (stored, back):
        assert np.array_equal(run.x, first.x)
        assert run.events == first.events
    assert snapshots([back]).states.size == back.states.size


def test_a_run_without_a_switch_is_cached_too(tmp_path):
    """Its shortest interval is inf, which JSON has no number for."""
    stuck = short(grab="-1 um", rupture="9 um")
    run = run_scene(stuck, tmp_path)
    assert run.events == ()
    assert np.array_equal(run.x, run_scene(stuck, tmp_path).x)


@pytest.mark.slow
@pytest.mark.parametrize("drag", [0.5, 0.0005])
def test_switch_times_within_1e_7_whatever_the_drag_of_the_nodes(drag):
    scene = dataclasses.replace(short(), matrix=ChainScene(drag=drag))
    found = run_scene(scene).events
    # Another method at a hundredth of the tolerance, and no sample in between.
    sharp = cs.simulate(build(scene), Radau(rtol=1e-11, atol=1e-13), np.array([0.0, 2.0])).events
    assert [e.name for e in found] == [e.name for e in sharp]
    assert len(found) > 2
    assert max(abs(a.time - b.time) for a, b in zip(found, sharp, strict=True)) < 1e-7


def test_held_nodes_that_a_method_moves_by_whole_nodes_stay_on_the_chain():
    """Radau's differences do that; without the bound the loops read and write past the chain."""
    system = build_crawlers(PAIR)
    for value in (-3.0, 0.0, 8.0, 33.0, 80.0, 1e6):
        x = system.x0.copy()
        x[-4] = value
        assert np.all(np.isfinite(system.rhs(0.0, x)))


def test_what_a_scene_builds_is_listed(tmp_path):
    rows = {r["element"]: r for r in scene_table(EXAMPLE)}
    system = build(cs.load_scene(EXAMPLE))
    assert list(rows) == ["cell1", "cell2", "chain"]
    assert sum(r["states"] for r in rows.values()) == system.states.size
    assert sum(r["auxiliaries"] for r in rows.values()) == system.auxiliaries.size


def test_study_of_a_chain_writes_run_summary_figures_and_report(tmp_path):
    scene = cs.load_scene(EXAMPLE)
    result = cs.study(scene, out=tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert summary["outcome"] == "stalled"
    assert "cell2 holds the node ahead of its lead" in summary["reason"]
    assert summary["switches"] == 46
    speeds = [cell["crawl_speed_um_per_s"] for cell in summary["cells"].values()]
    # Mirror images to the integrator's tolerance, and 11 or 12 nodes in 8.6 s.
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-8)
    assert speeds[0] == pytest.approx(11.5 / 8.63, rel=0.05)
    with np.load(tmp_path / "run.npz") as stored:
        assert np.array_equal(stored["x"], result.crawl.trajectory.x)
        assert len(stored["switch_times"]) == 46
    report = (tmp_path / "report.html").read_text("utf-8")
    assert report.count("data:image/png;base64,") == len(list((tmp_path / "figures").iterdir()))
    assert 'src="http' not in report
    assert "stalled" in result.report()


def test_a_method_that_gives_up_is_one_error_without_a_warning():
    with pytest.raises(IntegrationError, match="LSODA failed"):
        run_scene(short(damping="1e9 pN s/um", mass="1e-9 pN s^2/um"))


def test_a_study_that_fails_writes_nothing(tmp_path, monkeypatch):
    hasty = LSODA(rtol=1e-10, atol=1e-12, max_steps=5)
    monkeypatch.setattr("cellsys.scene.chain.METHOD", hasty)
    with pytest.raises(IntegrationError, match="spent its 5 steps"):
        cs.study(short(), out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_command_line_runs_and_refuses(tmp_path):
    def cellsys(*words):
        return subprocess.run(
            [sys.executable, "-m", "cellsys", *map(str, words)],
            cwd=EXAMPLE.parents[1], capture_output=True, text=True, check=False,
        )  # fmt: skip

    done = cellsys("run", EXAMPLE, "-o", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["outcome"] == "stalled"
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "figures", "report.html", "run.npz", "summary.json"
    }  # fmt: skip
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(EXAMPLE.read_text("utf-8") + "[effects]\nvolume = {}\n", "utf-8")
    done = cellsys("run", wrong, "-o", tmp_path / "none")
    assert done.returncode == 2
    assert "effects.volume has no meaning with matrix.kind = 'chain'" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "none").exists()
