"""A scene names its stepper: what it gets, what is refused, and runs that log and resume alike."""

import dataclasses
import json

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import SceneError
from cellsys.integrate import BDF2, RKC, LinearlyImplicit, simulate
from cellsys.integrate.record import record_shapes
from cellsys.scene import Scene, build, run_scene, scene_schema
from cellsys.scene.load import scene_from_plain
from cellsys.scene.steppers import AUTO
from cellsys.store import RunWriter
from tests.mechanics.scenes import table

CLUSTERS = {"focal_adhesion": {"kinetics": "switching", "bind_rate": "1 1/s"}}


def scene(run=None, effects=None, **changes):
    return Scene.parse({**table(**(effects or {})), **({"run": run} if run else {}), **changes})


def method(of):
    """What a run of the scene is made with."""
    found = of.matrix_kind.method(of)
    return found.of(build(of)) if hasattr(found, "of") else found


@pytest.mark.parametrize(
    ("run", "effects", "want"),
    [
        (None, None, BDF2(step=1.25)),
        ({"stepper": "LinearlyImplicit"}, None, LinearlyImplicit(step=0.5)),
        ({"step": "0.2 s"}, None, LinearlyImplicit(step=0.2)),
        ({"stepper": "BDF2"}, None, BDF2(step=1.25)),
        (
            {"stepper": "BDF2", "step": "1 s", "tolerance": "0.02"},
            None,
            BDF2(step=1, tolerance=0.02),
        ),
        ({"stepper": "RKC"}, None, RKC(rtol=0.01, atol=0.01, largest_step=100.0)),
        (
            {"stepper": "RKC", "tolerance": "0.001", "step": "2 s"},
            None,
            RKC(rtol=1e-3, atol=1e-3, largest_step=2.0),
        ),
        ({"stepper": "RKC"}, CLUSTERS, RKC(rtol=0.01, atol=0.01, largest_step=0.5)),
        ({"stepper": "auto"}, None, BDF2(step=1.25)),
        ({"stepper": "auto"}, CLUSTERS, LinearlyImplicit(step=0.25)),
        ({"stepper": "auto"}, {"noise": {}}, LinearlyImplicit(step=0.25)),
    ],
)
def test_what_a_scene_names_it_gets(run, effects, want):
    assert method(scene(run, effects)) == want


MISTAKES = [
    ({"stepper": "RK4"}, "run.stepper must be one of auto, BDF2, RKC, LinearlyImplicit, got 'RK4'"),
    ({"stepper": "BFD2"}, "did you mean 'BDF2'"),
    ({"stepper": 2}, "run.stepper"),
    ({"steper": "RKC"}, "unknown key 'run.steper'; did you mean 'stepper'"),
    ({"step": "0 s"}, "step must be > 0 s, got 0.0"),
    ({"step": "1 um"}, "wrong dimension"),
    ({"tolerance": "0.1"}, "run.tolerance = 0.1 needs a stepper that keeps it; add run.stepper"),
    (
        {"stepper": "BDF2", "tolerance": "1.5"},
        "run.tolerance must be > 0 and < 1, a share, got 1.5",
    ),
    ({"stepper": "RKC", "tolerance": "0"}, "run.tolerance must be > 0 and < 1, a share, got 0.0"),
    ({"stepper": "auto", "step": "1 s"}, 'run.step = 1 s is given and stepper = "auto" chooses'),
    ({"stepper": "auto", "tolerance": "0.1"}, 'run.tolerance = 0.1 is given and stepper = "auto"'),
]


@pytest.mark.parametrize(("run", "words"), MISTAKES)
def test_settings_that_it_does_not_take_are_refused(run, words):
    with pytest.raises(SceneError) as caught:
        scene(run)
    assert words in str(caught.value)


def test_one_number_is_not_said_twice():
    with pytest.raises(SceneError, match=r"step = 0.5 s and run.step = 1 s say the same thing"):
        scene({"step": "1 s"}, step="0.5 s")
    with pytest.raises(SceneError, match="crawlers are run by LSODA"):
        dataclasses.replace(cs.load_scene("crawler"), stepper="BDF2")


def test_the_stepper_is_part_of_the_fingerprint():
    plain, stepped = scene(), scene({"step": "0.5 s"})
    assert plain == scene({"stepper": "auto"})
    assert not {"stepper", "tolerance"} & set(stepped.canonical())  # as before there were others
    named = [scene({"stepper": s}) for s in ("BDF2", "RKC", "LinearlyImplicit")]
    assert len({s.fingerprint() for s in (plain, stepped, *named)}) == 5
    for each in named:
        back = scene_from_plain(json.loads(json.dumps(each.canonical())))
        assert back == each
        assert back.fingerprint() == each.fingerprint()


@pytest.mark.parametrize(
    ("older", "newer", "want"),
    [
        ({"step": "0.2 s"}, {"run": {"stepper": "BDF2"}}, BDF2(step=1.25)),
        ({"step": "0.2 s"}, {"run": {"step": "0.1 s"}}, LinearlyImplicit(step=0.1)),
        ({"run": {"stepper": "BDF2", "step": "2 s"}}, {}, BDF2(step=2.0)),
        ({"run": {"stepper": "BDF2", "step": "2 s"}}, {"step": "1 s"}, BDF2(step=1.0)),
        (
            {"run": {"stepper": "RKC", "tolerance": "0.1"}},
            {"run": {"stepper": "BDF2"}},
            BDF2(step=1.25),
        ),
        ({"run": {"stepper": "RKC"}}, {"run": False}, AUTO),
    ],
)
def test_what_a_scene_extends_gives_its_stepper_with_its_setting(tmp_path, older, newer, want):
    def toml(values):
        return "".join(
            f"[{k}]\n" + toml(v) if isinstance(v, dict) else f"{k} = {json.dumps(v)}\n"
            for k, v in sorted(values.items(), key=lambda item: isinstance(item[1], dict))
        )

    (tmp_path / "old.toml").write_text('extends = "spreading"\n' + toml(older))
    (tmp_path / "new.toml").write_text('extends = "old.toml"\n' + toml(newer))
    found = cs.load_scene(tmp_path / "new.toml")
    assert found.matrix_kind.method(found) == want


def test_editors_are_offered_the_steppers():
    text = json.dumps(scene_schema())
    assert '"enum": ["auto", "BDF2", "RKC", "LinearlyImplicit"]' in text


@pytest.mark.parametrize("stepper", ["BDF2", "RKC"])
@pytest.mark.parametrize(
    "effects",
    [
        pytest.param(None, id="clutch"),
        pytest.param(CLUSTERS, id="clusters", marks=pytest.mark.slow),
    ],
)
def test_a_run_logs_averages_and_continues_bit_for_bit(tmp_path, stepper, effects):
    told = scene({"stepper": stepper}, effects, duration="24 s", sample="1 s")
    system, integrator = build(told), method(told)

    class Interrupted(RuntimeError):
        pass

    class Stopping(RunWriter):
        def checkpoint(self, arrays, metadata):
            super().checkpoint(arrays, metadata)
            raise Interrupted

    shapes = record_shapes(system, told.times, True)
    whole = simulate(system, integrator, told.times, seed=3)
    with pytest.raises(Interrupted):
        simulate(system, integrator, told.times, seed=3, sink=Stopping(tmp_path / "r", shapes, {}))
    sink = RunWriter(tmp_path / "r", shapes, {})
    assert sink.resumed
    sink.arrays["x"][21:] = np.nan
    again = simulate(build(told), integrator, told.times, seed=3, sink=sink)
    for name in ("x", "eta", "u", "p", "d"):
        assert np.array_equal(getattr(again, name), getattr(whole, name)), name
    assert again.events == whole.events
    assert bool(whole.events) == (effects is not None)
    rate = np.diff(whole.x, axis=0) / np.diff(whole.t)[:, None]
    # The log with its step residual is the rate: forces of 1e3 pN times 1/C, bond numbers of 50.
    assert np.abs(rate - whole.eta @ whole.W_eta.T - whole.u).max() < 1e-11


def test_run_scene_uses_it(tmp_path):
    told = scene({"stepper": "BDF2"}, duration="5 s")
    run = run_scene(told, tmp_path)
    assert run.statistics["integrator"].startswith("BDF2(step=1.25")
    assert run.statistics["order"] == 2
    assert "step residual" in str(run)
