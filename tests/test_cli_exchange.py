"""export, import and observe on the command line."""

import json

import pytest
from typer.testing import CliRunner

import cellsys as cs
from cellsys.cli import app
from tests.good_arguments import run


def call(*words):
    return CliRunner().invoke(app, [str(w) for w in words])


def test_round_trip_of_a_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run().save("run.npz")
    for to, name in (("vtk", "run-vtk/run.pvd"), ("csv", "run.csv"), ("recorded", "run-recorded")):
        done = call("export", "run.npz", "--to", to)
        assert done.exit_code == 0, done.output
        assert (tmp_path / name).exists()
    done = call("import", "run-recorded", "--as", "recorded", "-o", "back.npz")
    assert done.exit_code == 0, done.output
    back = cs.read_run("back.npz")
    assert abs(back.block("cell1.position") - run().block("cell1.position")).max() < 1e-7
    told = call("observe", "back.npz", "--json")
    assert json.loads(told.output)["cells"]["cell"] == ["cell1"] * 4


def test_tracks(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("track,t,x,y\n1,0,1,2\n1,1,2,3\n2,0,5,5\n2,1,5,6\n")
    done = call("observe", path, "--pixel-size", 0.5, "--frame-interval", 30, "-o",
                tmp_path / "o.csv", "--pairs", tmp_path / "p.csv")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "speed [um/s]" in (tmp_path / "o.csv").read_text()
    assert "centroid_distance [um]" in (tmp_path / "p.csv").read_text()
    done = call("import", path, "--as", "tracks", "-o", tmp_path / "t.csv")
    assert done.exit_code == 0, done.output
    assert len(cs.read_tracks(tmp_path / "t.csv")) == 4


@pytest.mark.parametrize(
    "words", [("export", "x.npz", "--to", "pdf"), ("import", "x", "--as", "y")]
)
def test_unknown_forms_are_refused(words):
    done = call(*words)
    assert isinstance(done.exception, cs.ParameterError)
    assert "must be one of" in str(done.exception)
