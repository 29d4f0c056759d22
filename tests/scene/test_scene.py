"""Scene files: what is accepted builds; every mistake is one SceneError that names the cure."""

import copy
import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellsys.effects.protocol import Element
from cellsys.errors import CellsysError, MemoryBudgetError, SceneError
from cellsys.scene import Scene, build, load_scene, run_scene, scene_schema, training_scenes
from cellsys.scene.load import scene_from_plain
from cellsys.scene.registry import EFFECTS
from tests.mechanics.scenes import TABLE, table


def changed(path, value):
    """The small table with one entry set (or removed, for None); path like "matrix.modulus"."""
    out = copy.deepcopy(TABLE)
    place, keys = out, path.split(".")
    for key in keys[:-1]:
        place = place[int(key)] if isinstance(place, list) else place.setdefault(key, {})
    if value is None:
        place.pop(keys[-1])
    else:
        place[keys[-1]] = value
    return out


MISTAKES = [
    # unknown names, with the nearest known one
    (
        "effects.focal_adhesoin",
        {},
        "unknown key 'effects.focal_adhesoin'; did you mean 'focal_adhesion'",
    ),
    ("durations", "5 s", "unknown key 'durations'; did you mean 'duration'"),
    ("effects.lamellipodium.forse", "600 pN", "did you mean 'force'"),
    ("matrix.modulos", "5 kPa", "did you mean 'modulus'"),
    ("cells.0.polarty", "0 deg", "did you mean 'polarity'"),
    ("commands.headings", {}, "did you mean 'heading'"),
    ("training.run", 3, "did you mean 'runs'"),
    ("zzz", 1, "unknown key 'zzz'; known: "),
    # units
    ("effects.lamellipodium.force", "600", "has no unit"),
    ("matrix.modulus", 5000.0, "has no unit"),
    ("matrix.modulus", "5 kN", "wrong dimension"),
    ("matrix.modulus", "5 kPaa", "did you mean 'kPa'"),
    ("duration", "20 um", "wrong dimension"),
    ("cells.0.position", ["1 um", "2"], "has no unit"),
    ("effects.polarity.kappa", "1/0 1/s", "divides by zero"),
    # values
    ("effects.volume.modulus", "-300 Pa", "volume.modulus must be >= 0"),
    ("effects.foundation.spring", "-1 pN/um", "foundation.spring must be >= 0"),
    ("effects.membrane_elasticity.line", "-1 pN/um", "membrane_elasticity.line must be >= 0"),
    ("effects.matrix_elasticity.buckling_ratio", "1.5", "must be <= 1"),
    ("matrix.modulus", "-5 kPa", "matrix.modulus must be > 0"),
    ("matrix.diameter", "0 um", "matrix.diameter must be > 0"),
    ("duration", "0 s", "duration must be > 0"),
    ("duration", "-5 s", "duration must be > 0"),
    ("sample", "0 s", "sample must be > 0"),
    ("sample", "30 s", "longer than duration"),
    ("step", "0 s", "step must be > 0"),
    ("seed", -1, "seed must be >= 0"),
    ("seed", "seven", "seed"),
    ("seed", True, "seed"),
    ("name", "", "name"),
    ("name", None, "name is missing"),
    ("duration", None, "duration is missing"),
    ("cells.0.radius", "0 um", "radius must be > 0"),
    ("cells.0.radius", "nan um", "radius"),
    ("matrix.modulus", float("nan"), "finite"),
    ("matrix.modulus", "1e999 Pa", "finite"),
    (
        "matrix.inclusion",
        {"center": ["0 um", "0 um"], "radius": "-1 um", "factor": 2},
        "radius > 0",
    ),
    ("matrix.gradient", {"direction": "0 deg", "per_um": 1}, "stiffness zero"),
    ("matrix.kind", "cube", "matrix.kind"),
    ("effects.focal_adhesion.kinetics", "klutch", "kinetics"),
    ("effects.lamellipodium.full", 0.05, "lamellipodium.full must be > "),
    ("training.runs", 0, "training.runs must be >= 1"),
    ("duration", "1e300 s", "sample less often"),
    ("sample", "1e-9 s", "sample less often"),
    # places and contradictions
    ("cells", [{"position": ["0 um", "0 um"]}, {"position": ["5 um", "0 um"]}], "overlap"),
    ("cells.0.position", ["12 um", "0 um"], "outside the disc"),
    ("effects.drag", None, "drag is missing"),
    ("effects.matrix_elasticity", None, "needs matrix_elasticity"),
    ("effects.stiffness_sensing", None, "polarity needs stiffness_sensing"),
    ("matrix", None, "there is no [matrix]"),
    ("cells", [], "no [[cells]]"),
    ("cells.0.effects", {"foundation": {}}, "move it to [effects]"),
    ("commands.heading", {"times": ["0 s", "0 s"], "values": ["0 deg", "1 deg"]}, "must increase"),
    (
        "commands.heading",
        {"times": ["0 s"], "values": ["0 deg", "1 deg"]},
        "as many values as times",
    ),
    ("commands.heading", {"times": [], "values": []}, "times"),
    ("commands.amplitude", {"times": ["0 s"], "values": [float("nan")]}, "finite"),
    ("commands.amplitude", {"times": ["0 s", "nan s"], "values": [1, 1]}, "times"),
    ("effects.external_load", {"history": {"times": ["0 s"], "values": [float("inf")]}}, "finite"),
    ("effects", "all", "effects"),
    ("cells", {"position": 1}, "cells"),
]


@pytest.mark.parametrize(
    ("path", "value", "words"), MISTAKES, ids=[f"{m[0]}-{m[2][:18]}" for m in MISTAKES]
)
def test_mistakes_are_refused_in_one_line(path, value, words):
    with pytest.raises(SceneError) as caught:
        Scene.parse(changed(path, value))
    text = str(caught.value)
    assert words in text
    assert "\n" not in text
    assert isinstance(caught.value, ValueError)


def test_all_mistakes_are_reported_at_once():
    spec = changed("durations", "5 s")
    spec["matrix"]["modulus"] = "5"
    with pytest.raises(SceneError) as caught:
        Scene.parse(spec)
    assert "durations" in str(caught.value)
    assert "matrix.modulus" in str(caught.value)


def test_a_load_beside_the_disc_is_refused_when_built():
    spec = changed("effects.external_load", {"x": "40 um"})
    with pytest.raises(SceneError, match="covers no free matrix node"):
        build(Scene.parse(spec))


@pytest.mark.parametrize("nodes", [10**9, 10**12])
def test_a_scene_that_does_not_fit_into_memory_is_refused_with_the_estimate(nodes):
    scene = Scene.parse(changed("matrix.nodes", nodes))
    with pytest.raises(MemoryBudgetError, match=r"nodes needs about .* GB .* free"):
        build(scene)
    wide = dataclasses.replace(scene.matrix, diameter=1e6, nodes=None)
    assert wide.node_count > 10**9


def test_a_record_that_does_not_fit_is_refused_before_the_run_starts(tmp_path):
    long = Scene.parse(changed("duration", "4e7 s"))
    with pytest.raises(MemoryBudgetError, match=r"needs .* GB of memory .* sample less often"):
        run_scene(long)
    with pytest.raises(MemoryBudgetError, match=r"GB on disk"):
        run_scene(long, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("nodes", [0, -5, 10])
def test_too_few_nodes_are_refused(nodes):
    with pytest.raises(CellsysError):
        build(Scene.parse(changed("matrix.nodes", nodes)))


def test_files_that_are_no_scenes(tmp_path):
    for name, content, words in (
        ("a.toml", b"name = ", "not a TOML file"),
        ("b.toml", b"\xff\xfe\x00", "not a TOML file"),
        ("c.toml", b"", "is missing"),
        ("d.toml", b'name = "x"\nduration = "0 s"\n', "d.toml"),
        ("e.toml", b"a = " + b"[" * 5000, "e.toml"),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(SceneError, match=words):
            load_scene(path)
    with pytest.raises(FileNotFoundError, match="no scene file"):
        load_scene(tmp_path / "absent.toml")
    with pytest.raises(SceneError, match="cannot be read"):
        load_scene(tmp_path)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=12)
    | st.sampled_from(["5 um", "1 s", "5 kPa", "30 deg", "0 um", "-1 pN"]),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)  # fmt: skip
keys = st.sampled_from(
    ["name", "duration", "sample", "step", "seed", "matrix", "cells", "effects", "commands",
     "training", "matrix.modulus", "matrix.diameter", "matrix.nodes", "matrix.inclusion",
     "cells.0.position", "cells.0.radius", "cells.0.effects", "effects.drag",
     "effects.drag.cell", "effects.volume",
     "effects.focal_adhesion.bonds", "effects.external_load", "commands.heading", "training.runs"]
) | st.text(max_size=10).filter(lambda k: "." not in k)  # fmt: skip


@settings(max_examples=200, deadline=None)
@given(keys, values)
def test_any_change_of_a_scene_parses_or_is_a_scene_error(path, value):
    if value is None:
        return
    try:
        scene = Scene.parse(changed(path, value))
    except SceneError:
        return
    assert np.isfinite(scene.duration)
    assert scene.duration > 0
    json.dumps(scene.canonical(), allow_nan=False)


@settings(max_examples=100, deadline=None)
@given(values)
def test_any_table_parses_or_is_a_scene_error(value):
    with pytest.raises(SceneError):
        Scene.parse({"name": "x", "duration": value})
    if isinstance(value, dict):
        with pytest.raises(SceneError):
            Scene.parse(value)


def test_every_effect_of_the_registry_can_be_named_with_every_parameter():
    for name, effect in EFFECTS.items():
        parameters = {}
        for item in dataclasses.fields(effect):
            meta = item.metadata
            if "unit" not in meta:
                continue
            assert meta["source"], f"{name}.{item.name} has no source"
            assert meta["about"], f"{name}.{item.name} has no meaning"
            unit = "" if meta["unit"] == "1" or meta["choices"] else f" {meta['unit']}"
            parameters[item.name] = item.default if meta["flag"] else f"{item.default}{unit}"
        others = dict.fromkeys(effect.excludes) | {
            other: None for other in TABLE["effects"] if name in EFFECTS[other].excludes
        }
        scene = Scene.parse(table(**others, **{name: parameters}))
        assert scene.effects[name] == effect()


def test_a_scene_is_frozen_data_with_a_fingerprint():
    scene = Scene.parse(TABLE)
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.duration = 1.0
    assert scene.fingerprint() == Scene.parse(copy.deepcopy(TABLE)).fingerprint()
    same = dataclasses.replace(scene, name="other")
    assert same.fingerprint() == scene.fingerprint()
    seen = {scene.fingerprint()}
    for path, value in (
        ("seed", 4), ("duration", "25 s"), ("step", "0.25 s"), ("cells.0.polarity", "31 deg"),
        ("effects.volume.modulus", "301 Pa"), ("effects.foundation", None), ("matrix.nodes", 321),
        ("commands.amplitude", {"times": ["0 s"], "values": [0.5]}),
        ("matrix.inclusion", {"center": ["1 um", "0 um"], "radius": "2 um", "factor": 2}),
    ):  # fmt: skip
        print_ = Scene.parse(changed(path, value)).fingerprint()
        assert print_ not in seen
        seen.add(print_)


def test_canonical_values_give_the_scene_back():
    spec = table(external_load={"history": {"times": ["0 s", "1 s"], "values": [0, 1]}})
    spec["matrix"]["inclusion"] = {"center": ["1 um", "0 um"], "radius": "2 um", "factor": 2}
    spec["matrix"]["gradient"] = {"direction": "30 deg", "per_um": 0.01}
    spec["commands"] = {"heading": {"times": ["0 s", "5 s"], "values": ["0 deg", "80 deg"]}}
    spec["cells"][0]["effects"] = {"lamellipodium": {"force": "300 pN"}}
    scene = Scene.parse(spec)
    plain = json.loads(json.dumps(scene.canonical()))
    assert scene_from_plain(plain) == scene
    assert scene_from_plain(plain).fingerprint() == scene.fingerprint()


def test_times_cover_the_duration():
    scene = Scene.parse(TABLE)
    assert scene.times.tolist() == [0.0, 5.0, 10.0, 15.0, 20.0]


def test_a_cell_may_override_parameters():
    spec = table()
    spec["matrix"]["diameter"] = "60 um"
    spec["cells"] = [
        {"position": ["-10 um", "0 um"]},
        {"position": ["10 um", "0 um"], "effects": {"lamellipodium": {"force": "100 pN"}}},
    ]
    system = build(Scene.parse(spec))
    force = {e.array: e.effect.force for e in system.elements if e.name.endswith("lamellipodium")}
    assert force == {"cell1": 600.0, "cell2": 100.0}
    # No element twice, every port once.
    ports = [p.block for e in system.elements for p in e.ports]
    assert len(ports) == len(set(ports))
    assert all(isinstance(e, Element) for e in system.elements)


def test_inclusion_and_gradient_change_the_fibres_where_they_should():
    plain = build(Scene.parse(TABLE)).matrix
    spec = changed("matrix.inclusion", {"center": ["4 um", "0 um"], "radius": "5 um", "factor": 5})
    stiff = build(Scene.parse(spec)).matrix
    middle = plain.position[plain.fibres].mean(axis=1)
    inside = np.hypot(middle[:, 0] - 4.0, middle[:, 1]) < 5.0
    assert np.allclose(stiff.stiffness[inside], 5.0 * plain.stiffness[inside], rtol=1e-14)
    assert np.array_equal(stiff.stiffness[~inside], plain.stiffness[~inside])
    slope = changed("matrix.gradient", {"direction": "90 deg", "per_um": 0.02})
    graded = build(Scene.parse(slope)).matrix
    assert graded.stiffness / plain.stiffness == pytest.approx(1.0 + 0.02 * middle[:, 1], rel=1e-12)


def test_training_scenes_cover_the_circle_and_hold_others_out():
    scene = Scene.parse(TABLE)
    train, test = training_scenes(scene)
    angles = np.array([s.commands.heading(0.0) for s in train])
    assert len(train) == scene.training.runs
    assert np.diff(angles) == pytest.approx(2 * np.pi / len(train))
    for other in (s.commands.heading(0.0) for s in test):
        gap = np.abs((angles - other + np.pi) % (2 * np.pi) - np.pi).min()
        assert gap == pytest.approx(np.pi / len(train))
    assert all("polarity" not in s.effects and "stiffness_sensing" in s.effects for s in train)


def test_the_schema_is_json_and_names_every_effect():
    text = json.dumps(scene_schema())
    for name in EFFECTS:
        assert f'"{name}"' in text
