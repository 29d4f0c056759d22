"""A sample that does not divide the duration is refused, wherever the two stand."""

import dataclasses
import json
import re
import tomllib
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cellsys as cs
from cellsys.errors import DataError, FileFormatError, SceneError
from cellsys.scene import training_scenes
from cellsys.scene.ensemble import read_run
from cellsys.scene.load import scene_from_plain
from cellsys.study.leave_one_out import leave_one_out
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory
from tests.study.scenes import TINY, tiny

FREE = """
name = "free"
duration = "{duration}"
sample = "{sample}"
[[cells]]
[effects]
drag = {{}}
"""


def free(duration, sample):
    return cs.Scene.parse(tomllib.loads(FREE.format(duration=duration, sample=sample)))


@pytest.mark.parametrize(
    ("duration", "sample", "naive", "samples", "durations"),
    [
        ("60 s", "7 s", 63.0, ("6.666666667 s", "7.5 s"), ("56 s", "63 s")),
        ("60 s", "25 s", 50.0, ("20 s", "30 s"), ("50 s", "75 s")),
        ("1 min", "0.7 s", 60.2, ("0.6976744186 s", "0.7058823529 s"), ("59.5 s", "60.2 s")),
    ],
)
def test_the_examples(duration, sample, naive, samples, durations):
    long, short = (float(v.split()[0]) * (60 if "min" in v else 1) for v in (duration, sample))
    # what was done before: the nearest whole number of samples, and another duration
    assert round(long / short) * short == pytest.approx(naive)
    assert naive != long
    with pytest.raises(SceneError, match=r"sample = .* s does not divide duration") as caught:
        free(duration, sample)
    for value in (*samples, *durations):
        assert f"'{value}'" in str(caught.value)
    for value in samples:
        assert free(duration, value).times[-1] == long
    for value in durations:
        assert np.diff(free(value, sample).times) == pytest.approx(short)


@settings(max_examples=150, deadline=None)
@given(
    st.decimals("0.001", "5000", places=3).filter(lambda d: d > 0),
    st.decimals("0.001", "500", places=3).filter(lambda d: d > 0),
)
def test_a_run_is_as_long_as_it_says_or_refused(duration, sample):
    """Exact arithmetic on the decimals as they are written."""
    ratio = Fraction(duration) / Fraction(sample)
    if ratio.denominator == 1:
        t = free(f"{duration} s", f"{sample} s").times
        assert len(t) == int(ratio) + 1
        assert t[0] == 0.0
        assert t[-1] == float(duration)
        # 1e-9: two neighbouring doubles of the duration, over a sample a millionth of it
        assert np.abs(np.diff(t) - float(sample)).max() <= 1e-9 * float(sample)
        return
    with pytest.raises(SceneError) as caught:
        free(f"{duration} s", f"{sample} s")
    text = str(caught.value)
    offered = re.search(r"take sample = (.*?),? or duration = (.*)$", text)
    samples, durations = (re.findall(r"'(.+?)'", part) for part in offered.groups())
    assert len(samples) == len(durations) == (1 if ratio < 1 else 2)
    # every cure that is offered is one, and none lies between them
    for value in samples:
        assert free(f"{duration} s", value).times[-1] == float(duration)
    for value in durations:
        assert free(value, f"{sample} s").times[-1] == pytest.approx(float(value.split()[0]))
    if ratio > 1:
        near = [float(v.split()[0]) for v in durations]
        assert near[0] < duration < near[1]
        assert near[1] - near[0] == pytest.approx(float(sample), rel=1e-6)


def test_everywhere_a_scene_comes_from():
    table = tomllib.loads(TINY)
    scene = cs.Scene.parse(table)
    words = "does not divide"
    for wrong in (
        lambda: dataclasses.replace(scene, sample=7.0),
        lambda: dataclasses.replace(scene, duration=41.0),
        lambda: dataclasses.replace(scene.training, sample=7.0),
        lambda: cs.Scene.parse({**table, "training": {"duration": "40 s", "sample": "15 s"}}),
        lambda: cs.Scene.parse({**table, "training": {"duration": "12 s"}}),
        lambda: scene_from_plain({**scene.canonical(), "sample": 7.0}),
        lambda: leave_one_out(scene, duration=12.0),
    ):
        with pytest.raises(SceneError, match=words):
            wrong()
    with pytest.raises(SceneError, match=r"training\.sample = 15 s does not divide training\.dur"):
        cs.Scene.parse({**table, "training": {"duration": "40 s", "sample": "15 s"}})
    with pytest.raises(SceneError, match=r"training\.sample = 50 s is longer than training\.dur"):
        cs.Scene.parse({**table, "training": {"duration": "40 s", "sample": "50 s"}})
    with pytest.raises(SceneError, match=r"training\.duration must be > 0 s"):
        dataclasses.replace(scene.training, duration=0.0)
    assert all(s.times[-1] == 40.0 for group in training_scenes(scene) for s in group)


def test_the_commands_say_it_in_one_line(call, tmp_path):
    odd = {'duration = "40 s"\nsample = "5 s"\nseed': 'duration = "60 s"\nsample = "7 s"\nseed'}
    (tmp_path / "odd.toml").write_text(tiny(replace=odd))
    for command in (
        ("run", "odd.toml"),
        ("effects", "odd.toml"),
        ("cost", "odd.toml"),
        ("sweep", "spreading", "--set", "sample=5 s,7 s"),
        ("effects", "isolated_membrane", "--measure", "--duration", 12),
    ):
        code, out, err = call(*command)
        assert (code, out) == (2, "")
        assert "does not divide duration" in err
        assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_what_was_stored_with_another_duration_is_refused(tmp_path):
    """A run cached by a version that changed it."""
    scene = free("10 s", "5 s")
    cs.run_scene(scene, tmp_path)
    folder = tmp_path / scene.fingerprint()[:20]
    for name in ("header.json", "run.json"):
        told = json.loads((folder / name).read_text())
        told["header"]["scene"]["sample"] = 4.0
        (folder / name).write_text(json.dumps(told))
    with pytest.raises(FileFormatError, match="does not divide"):
        read_run(folder)


def test_samples_of_a_model_are_samples_of_the_run():
    states = Layout([Block("x", (1,), "1")])
    run = Trajectory(t=5.0 * np.arange(7), x=np.zeros((7, 1)), states=states)
    assert [run.stride(s) for s in (5.0, 10.0, 30.0)] == [1, 2, 6]
    for step in (2.5, 7.0, 12.5, 0.0, np.nan):
        with pytest.raises(DataError, match="no multiple of the samples' 5 s"):
            run.stride(step)
    uneven = Trajectory(t=np.array([0.0, 5.0, 11.0]), x=np.zeros((3, 1)), states=states)
    with pytest.raises(DataError, match="5 to 6 s apart"):
        uneven.stride(5.0)
