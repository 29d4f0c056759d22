"""Scenes without a model of their own: several cells, none, none that is steered."""

import dataclasses
import json
import tomllib

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

import cellsys as cs
from cellsys.errors import ParameterError
from cellsys.observe import alone_scenes, observe_neighbours
from cellsys.scene import Scene, run_scene
from cellsys.store import load_archive
from cellsys.study.leave_one_out import leave_one_out
from tests.reduction.equivariant.runs import model as trained
from tests.study.scenes import TINY, tiny

PAIR = (
    '[[cells]]\nposition = ["-6 um", "0 um"]\npolarity = "60 deg"\nradius = "4 um"\n'
    '[[cells]]\nposition = ["6 um", "0 um"]\npolarity = "-90 deg"\nradius = "4 um"\n[effects]'
)
ONE = '[[cells]]\nposition = ["0 um", "0 um"]\npolarity = "60 deg"\nradius = "5 um"\n'


def scene(text):
    return Scene.parse(tomllib.loads(text))


def pair(**more):
    return scene(tiny(replace={ONE: "", "[effects]": PAIR, **more}))


def test_several_cells_are_run_beside_each_alone(tmp_path):
    result = cs.study(pair(), tmp_path / "out")
    files = {p.name for p in (tmp_path / "out").iterdir()}
    assert files == {"run.npz", "summary.json", "figures", "report.html", "runs"}
    table = json.loads((tmp_path / "out" / "summary.json").read_text())
    # by hand, from the same functions on the same scenes
    run, *alone = (run_scene(s) for s in (pair(), *alone_scenes(pair())))
    wanted = observe_neighbours(run, alone, cs.build(pair()).matrix.position)
    assert list(table["pairs"]) == ["1-2"]
    assert table["pairs"]["1-2"]["gap_speed_nm_s"] == pytest.approx(
        wanted[0, 1].means()["gap_speed_nm_s"]
    )
    assert set(table["cells"]) == {"cell1", "cell2"}
    assert table["cells"]["cell1"] != table["cells"]["cell2"]
    assert "one of them alone" in str(result)
    assert "--model" in str(result)
    arrays, _ = load_archive(tmp_path / "out" / "run.npz", "run", 1)
    assert np.array_equal(arrays["x"], run.x)
    text = result.report()
    for words in ("cell2:", "crawl, um", "cells 1 and 2: edge gap", "integrator's error"):
        assert words in text
    assert {p.stem for p in (tmp_path / "out" / "figures").iterdir()} == {
        "cells", "centres", "displacement_field", "gaps",
    }  # fmt: skip


def test_a_model_of_one_cell_runs_beside_them(tmp_path):
    given = trained()
    apart = pair(**{'sample = "5 s"\nseed': 'sample = "10 s"\nseed'})
    file = given.save(tmp_path / "model.npz")
    result = cs.study(apart, tmp_path / "out", model=file)
    found = result.reduced
    assert found.steered
    small = found.run
    assert np.array_equal(small.t, result.run.t)
    u, v = (r.block("matrix.displacement") for r in (result.run, small))
    assert found.matrix == pytest.approx(np.linalg.norm(v - u) / np.linalg.norm(u))
    assert 0 < found.cells < 1
    assert 0 < found.superposed < found.matrix  # of full-order cells: nothing reduced in it
    table = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert table["reduced"]["error_on_matrix"] == pytest.approx(found.matrix)
    assert "two steps of the field" in result.report()
    odd = pair(**{'sample = "5 s"\nseed': 'sample = "4 s"\nseed'})
    with pytest.raises(ParameterError, match=r"sampled every 4 s, .* set sample = '10 s'"):
        cs.study(odd, tmp_path / "b", model=given)
    with pytest.raises(ParameterError, match="learns its own"):
        cs.study(scene(TINY), tmp_path / "c", model=given)
    plain = cs.LatentModel(-np.eye(2))
    with pytest.raises(ParameterError, match="got LatentModel"):
        cs.study(pair(), tmp_path / "d", model=plain)
    # refused before anything is run or written
    assert not any((tmp_path / name).exists() for name in "bcd")


def test_commanded_cells_follow_their_commands(tmp_path):
    told = {
        "[effects]": PAIR.replace(
            "[effects]",
            '[commands]\nheading = { times = ["0 s", "40 s"], values = ["0 deg", "90 deg"] }\n'
            "[effects]",
        ),
        'polarity = { kappa = "1/60 1/s" }\n': "",
        'sample = "5 s"\nseed': 'sample = "10 s"\nseed',
    }
    commanded = scene(tiny(replace={ONE: "", **told}))
    found = cs.study(commanded, tmp_path / "out", model=trained()).reduced
    assert not found.steered
    angle = np.degrees(np.arctan2(found.run.p[1:, 0, 1], found.run.p[1:, 0, 0]))
    np.testing.assert_allclose(angle, [11.25, 33.75, 56.25, 78.75], atol=1e-9)  # step means


def test_it_ends_at_contact_and_controls_are_as_long(tmp_path):
    close = PAIR.replace("-6 um", "-4.2 um").replace('"6 um"', '"4.2 um"')
    close = close.replace('"60 deg"', '"0 deg"').replace('"-90 deg"', '"180 deg"')
    text = tiny(replace={ONE: "", "[effects]": close})
    text = text.replace('duration = "40 s"\nsample = "5 s"\nseed',
                        'until = "contact"\nduration = "400 s"\nsample = "2 s"\nseed')  # fmt: skip
    result = cs.study(scene(text), tmp_path / "out")
    touch = result.run.events[-1]
    assert touch.name == "contact"
    assert result.run.t[-1] < touch.time < 400
    assert f"touch at {touch.time:.0f} s, the run ends there" in str(result)
    assert len(result.pairs[0, 1].gap) == len(result.run)


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("passive_matrix", {"displacement_field"}),
        ("isolated_membrane", {"cells", "centres"}),
    ],
)
def test_presets_without_a_steered_cell(name, files, tmp_path):
    short = dataclasses.replace(cs.load_scene(name), duration=10.0, sample=5.0)
    result = cs.study(short, tmp_path / "out")
    assert {p.stem for p in (tmp_path / "out" / "figures").iterdir()} == files
    assert "exactly one steered cell on a matrix" in str(result)
    table = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert table["pairs"] == {}
    assert bool(table["matrix"]) == (name == "passive_matrix")


def test_a_cell_without_a_lamellipodium_is_run_too(tmp_path):
    text = tiny(replace={'lamellipodium = { force = "600 pN" }\n': ""})
    result = cs.study(scene(text), tmp_path / "out")
    assert set(result.summary["cells"]) == {"cell1"}
    assert result.summary["cells"]["cell1"]["contact_radius_end_um"] > 0


def test_the_command_takes_a_model(call, tmp_path):
    slower = {'sample = "5 s"\nseed': 'sample = "10 s"\nseed'}
    text = tiny(replace={ONE: "", "[effects]": PAIR, **slower})
    (tmp_path / "pair.toml").write_text(text)
    trained().save(tmp_path / "model.npz")
    code, out, _ = call("run", "pair.toml", "--model", "model.npz")
    assert code == 0
    assert "reduced cells miss" in out
    assert (tmp_path / "out" / "pair" / "report.html").exists()
    code, _, err = call("run", "pair.toml", "--model", "absent.npz")
    assert code == 2
    assert "absent.npz" in err


def test_an_error_is_kept_without_a_matrix_too(call, tmp_path):
    (tmp_path / "free.toml").write_text(
        'extends = "isolated_membrane"\nduration = "10 s"\nsample = "5 s"\n'
    )
    code, out, err = call("run", "free.toml", "--error", "0.05")
    assert code == 0, err
    assert "1 cell, 10 s" in out


def test_leaving_out_compares_at_one_time():
    """The whole scene would end at 14 s; without what moves the cells they never touch."""
    close = PAIR.replace("-6 um", "-4.02 um").replace('"6 um"', '"4.02 um"')
    close = close.replace('"60 deg"', '"0 deg"').replace('"-90 deg"', '"180 deg"')
    whole = dataclasses.replace(scene(tiny(replace={ONE: "", "[effects]": close})), sample=2.0)
    ending = dataclasses.replace(whole, until="contact")
    assert run_scene(ending).t[-1] < 20 < whole.duration
    first, second = ({w.effect: w.motion for w in leave_one_out(s)} for s in (whole, ending))
    for name, motion in first.items():
        assert second[name] == pytest.approx(motion, nan_ok=True)
