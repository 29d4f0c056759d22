"""Runs on disk: a file gives back every bit, names, units and where the run comes from."""

import dataclasses
import json
import tomllib

import numpy as np
import pytest

import cellsys as cs
from cellsys.store import save_archive
from tests.good_arguments import run
from tests.study.scenes import TINY


def test_a_saved_run_is_the_run(tmp_path):
    made = run()
    back = cs.read_run(made.save(tmp_path / "a"))
    for name in ("t", "x", "eta", "u", "p", "d", "amplitude", "eta_start", "virial", "stiffness"):
        ours, theirs = getattr(made, name), getattr(back, name)
        assert (ours is None and theirs is None) or np.array_equal(ours, theirs), name
    assert (back.states, back.auxiliaries) == (made.states, made.auxiliaries)
    assert [b.unit for b in back.states] == [b.unit for b in made.states]
    assert (back.W_eta != made.W_eta).nnz == 0
    assert back.events == made.events
    assert set(back.geometry) == set(made.geometry)
    assert back.source["cellsys"] == cs.__version__
    assert back.source["scene"]["name"] == "tiny"
    again = [cs.reduce(cs.snapshots([r]), order=1, method=cs.PCR()).A for r in (made, back)]
    assert np.array_equal(*again)


def test_the_error_that_was_found_goes_with_the_run(tmp_path):
    made = dataclasses.replace(run())  # nobody has asked this one yet
    assert cs.Trajectory.load(made.save(tmp_path / "a.npz")).error.absolute is None
    found = made.error
    back = cs.Trajectory.load(made.save(tmp_path / "b.npz"))
    assert np.array_equal(back.error.absolute, found.absolute)
    assert back.error_of("cell1.position") == made.error_of("cell1.position")


def test_states_alone_take_a_part_of_the_bytes(tmp_path):
    small = run().save(tmp_path / "small.npz", loads=False)
    assert small.stat().st_size < 0.5 * run().save(tmp_path / "all.npz").stat().st_size
    back = cs.read_run(small)
    assert back.eta is None
    assert np.array_equal(back.x, run().x)
    with pytest.raises(cs.DataError, match="auxiliaries"):
        cs.snapshots([back])


def test_a_run_folder_keeps_the_scene_as_it_was_given(tmp_path):
    (tmp_path / "tiny.toml").write_text(TINY.replace("40 s", "10 s"))
    scene = cs.load_scene(tmp_path / "tiny.toml")
    made = cs.run_scene(scene, tmp_path / "runs")
    folder = next(p for p in (tmp_path / "runs").iterdir() if p.is_dir())
    back = cs.read_run(folder)
    assert np.array_equal(back.x, made.x)
    assert tomllib.loads(back.source["toml"])["name"] == "tiny"
    assert made.source == back.source
    told = json.loads((folder / "run.json").read_text())["metadata"]
    assert ["cell1.position", [189, 3], "um", "component", "position"] in told["states"]
    assert any(row[2] == "pN" for row in told["auxiliaries"])


@pytest.mark.parametrize("break_it", ["cut", "kind", "states", "shape", "schema"])
def test_damaged_files_are_refused(tmp_path, break_it):
    path = tmp_path / "a.npz"
    arrays = {"t": np.arange(3.0), "x": np.ones((3, 1))}
    told = {"states": [["x", [1], "um", "component", "position"]], "events": [],
            "statistics": {}, "label": ""}  # fmt: skip
    save_archive(path, "run", 1, arrays, told)
    assert cs.read_run(path).states.names == ["x[0]"]  # as version 0.2.0 wrote them
    if break_it == "cut":
        path.write_bytes(path.read_bytes()[:200])
    elif break_it == "kind":
        save_archive(path, "model", 1, arrays, told)
    elif break_it == "schema":
        save_archive(path, "run", 9, arrays, told)
    elif break_it == "states":
        save_archive(path, "run", 1, arrays, {**told, "states": [["x"]]})
    else:
        save_archive(path, "run", 1, {**arrays, "x": np.ones((3, 2))}, told)
    with pytest.raises(cs.FileFormatError, match=r"a\.npz|damaged"):
        cs.read_run(path)


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        cs.read_run(tmp_path / "nothing")
    with pytest.raises(cs.FileFormatError, match="neither"):
        cs.read_run(tmp_path)
