"""Effects of other packages and of scripts, presets, inheritance, sweeps, the schema, mutations."""

import copy
import dataclasses
import json
import string
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cellsys as cs
from cellsys.effects import Effect, Element, Port, parameter
from cellsys.errors import CellsysError, ParameterError, SceneError
from cellsys.scene import Scene, build, load_scene, preset_names, scene_schema
from cellsys.scene.inherit import PRESETS
from cellsys.scene.load import scene_from_plain
from cellsys.scene.parts import Training
from cellsys.scene.registry import EFFECTS, LISTED, Registry
from cellsys.scene.variants import read_setting, split_values, variants, with_value, without
from tests.mechanics.small_scenes import tiny

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@dataclasses.dataclass(frozen=True)
class Wind(Effect):
    """A constant force on every node of a cell."""

    name = "wind"
    force: float = parameter("2 pN", "pN", least=0.0, source="test", about="force of a node")

    def elements(self, site):
        return (_WindElement(self, site.cell),)


class _WindElement(Element):
    def __init__(self, effect, cell):
        self.force_of_node, self.name = effect.force, f"{cell.name}.wind"
        self.ports = (Port(cell.name, self.name),)

    def efforts(self, s, out):
        out[0][:, 0] = self.force_of_node


def blown(**parameters):
    table = tiny("membrane_elasticity", cells=1, matrix=False)
    table["effects"]["wind"] = parameters
    return table


# Registry


def test_a_scripts_own_effect_is_named_like_any_other():
    scene = Scene.parse(blown(force="4 pN"), effects=[Wind])
    assert scene.effects["wind"] == Wind(4.0)
    system = build(scene)
    assert system.auxiliaries["cell1.wind"].shape == (189, 3)
    run = cs.run_scene(scene)
    x = run.block("cell1.position").mean(axis=1)[:, 0]
    # 4 pN against C_c + C_cort = 2000 pN s/um for 20 s.
    assert x[-1] - x[0] == pytest.approx(4.0 / 2000.0 * 20.0, rel=1e-9)
    with pytest.raises(SceneError, match=r"unknown key 'effects.wind'"):
        Scene.parse(blown())
    with pytest.raises(SceneError, match="did you mean 'force'"):
        Scene.parse(blown(farce="4 pN"), effects=[Wind])
    with pytest.raises(SceneError, match=r"wind.force must be >= 0"):
        Scene.parse(blown(force="-4 pN"), effects=[Wind])
    # Without a file: an effect is an object.
    by_hand = dataclasses.replace(
        scene, effects={n: e for n, e in scene.effects.items() if n != "wind"}
    )
    by_hand = dataclasses.replace(by_hand, effects={**by_hand.effects, "wind": Wind(4.0)})
    assert by_hand.fingerprint() == scene.fingerprint()


def test_a_scene_with_an_own_effect_survives_its_run_folder(tmp_path):
    scene = Scene.parse(blown(), effects=[Wind])
    cs.run_scene(scene, tmp_path)
    plain = json.loads(json.dumps(scene.canonical()))
    assert "Wind" in plain["effects"]["wind"]["origin"]
    assert scene_from_plain(plain, effects=[Wind]) == scene
    with pytest.raises(KeyError):
        scene_from_plain(plain)
    assert "origin" not in plain["effects"]["drag"]


class FakePoint:
    """An entry point as importlib.metadata gives it."""

    def __init__(self, name, value, effect):
        self.name, self.value, self._effect = name, value, effect

    def load(self):
        if isinstance(self._effect, Exception):
            raise self._effect
        return self._effect

    def __lt__(self, other):
        return self.name < other.name


def test_an_installed_package_adds_an_effect(tmp_path, monkeypatch):
    """A real distribution on the path: metadata with an entry point, a module with the class."""
    (tmp_path / "windy.py").write_text(
        "from dataclasses import dataclass\n"
        "from cellsys.effects import Effect, parameter\n"
        "@dataclass(frozen=True)\n"
        "class Breeze(Effect):\n"
        "    '''A breeze.'''\n"
        "    name = 'breeze'\n"
        "    force: float = parameter('1 pN', 'pN', source='test', about='force')\n"
    )
    info = tmp_path / "windy-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: windy\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[cellsys.effects]\nbreeze = windy:Breeze\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    table = blown()
    table["effects"]["breeze"] = table["effects"].pop("wind")
    scene = Scene.parse(table)
    assert type(scene.effects["breeze"]).__name__ == "Breeze"
    assert list(Registry())[-1] == "breeze"
    assert '"breeze"' in json.dumps(scene_schema())


def test_entry_points_that_do_not_fit_are_refused_by_name(monkeypatch):
    from cellsys.scene import registry

    def points(*found):
        monkeypatch.setattr(registry, "entry_points", lambda group: list(found))
        return Registry()

    with pytest.raises(ParameterError, match="there is an effect of that name already"):
        list(points(FakePoint("volume", "pkg:Volume", Wind)))
    with pytest.raises(ParameterError, match="does not load: no such module"):
        points(FakePoint("wind", "pkg:Wind", ImportError("no such module")))["wind"]
    with pytest.raises(ParameterError, match="is not a class derived from Effect"):
        points(FakePoint("wind", "pkg:wind", 3))["wind"]
    with pytest.raises(ParameterError, match="two names must agree"):
        points(FakePoint("storm", "pkg:Wind", Wind))["storm"]
    assert points(FakePoint("wind", "pkg:Wind", Wind))["wind"] is Wind
    # Scenes of shipped effects do not look at other packages at all.
    monkeypatch.setattr(registry, "entry_points", None)
    Scene.parse(tiny("volume"), effects=[])


def test_names_are_taken_once():
    with pytest.raises(ParameterError, match="there is an effect 'wind' already"):
        Registry([Wind, Wind])
    with pytest.raises(ParameterError, match="must be a class of Effect, got 3"):
        Scene.parse(blown(), effects=[3])
    taken = type("Taken", (Effect,), {"name": "volume"})
    with pytest.raises(SceneError, match="give yours another name"):
        Scene.parse(blown(), effects=[taken])


def test_every_effect_says_what_it_is():
    assert len(LISTED) == len(EFFECTS) == 23
    for name, effect in EFFECTS.items():
        assert effect.name == name
        assert effect.__doc__
        assert effect.not_on["chain"]
        for other in (n for need in effect.needs for n in need.split("|")):
            assert other in EFFECTS
        assert set(effect.excludes) <= set(EFFECTS)


# Presets and inheritance


def test_presets_build_and_those_with_an_example_equal_it():
    assert {"spreading", "two_cells", "ten_cells", "crawler", "passive_matrix",
            "isolated_membrane"} <= set(preset_names())  # fmt: skip
    for name in preset_names():
        scene = load_scene(name)
        if (EXAMPLES / f"{name}.toml").exists():
            assert load_scene(EXAMPLES / f"{name}.toml") == scene
        if name != "ten_cells":
            assert build(scene).states.size > 0
    with pytest.raises(FileNotFoundError, match="did you mean 'spreading'"):
        load_scene("spreadin")


def test_presets_are_part_of_the_package():
    """Hatchling ships every file of the package; nothing may leave them out."""
    project = tomllib.loads((EXAMPLES.parent / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel == {"packages": ["cellsys"]}
    assert PRESETS.is_relative_to(EXAMPLES.parent / "cellsys")


def test_a_scene_may_extend_a_preset_or_a_file(tmp_path):
    (tmp_path / "base.toml").write_text(
        'extends = "spreading"\nduration = "100 s"\n[effects.lamellipodium]\nheight = "2 um"\n'
    )
    (tmp_path / "new.toml").write_text(
        'extends = "base.toml"\nname = "new"\n[effects]\ncortical_tension = false\n'
        'nucleus = {}\n[effects.lamellipodium]\nforce = "300 pN"\n'
        '[[cells]]\nposition = ["0 um", "0 um"]\n'
    )
    scene, old = load_scene(tmp_path / "new.toml"), load_scene("spreading")
    assert (scene.name, scene.duration, scene.sample) == ("new", 100.0, old.sample)
    assert scene.matrix == old.matrix
    assert set(old.effects) - set(scene.effects) == {"cortical_tension"}
    assert set(scene.effects) - set(old.effects) == {"nucleus"}
    push = scene.effects["lamellipodium"]
    assert (push.force, push.height) == (300.0, 2.0)
    assert len(scene.cells) == 1
    assert scene.cells[0].position == (0.0, 0.0)
    assert load_scene("stochastic_spreading").step == 0.25
    (tmp_path / "base.toml").write_text('extends = "new.toml"\n')
    with pytest.raises(SceneError, match=r"leads back to itself: base.toml -> new.toml -> base"):
        load_scene(tmp_path / "new.toml")


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("spredding", "did you mean 'spreading'"),
        (3, "extends must be a preset or a scene file, got 3"),
        ("", "extends must be a preset or a scene file"),
        ("a\0b", "extends ="),
        (["spreading"], "extends must be"),
    ],
)
def test_what_cannot_be_extended_is_refused(value, words):
    with pytest.raises(SceneError, match=words):
        Scene.parse({"extends": value})


def test_only_false_takes_an_effect_out():
    for value in (True, "off", 0, 1):
        with pytest.raises(SceneError, match=r"effects.volume"):
            Scene.parse({"extends": "spreading", "effects": {"volume": value}})
    scene = Scene.parse({"extends": "spreading", "effects": {"volume": False}})
    assert "volume" not in scene.effects


def test_false_takes_out_an_inherited_table_that_may_be_left_out():
    old = load_scene("spreading")
    assert old.learn
    assert old.matrix.inclusion is not None
    new = Scene.parse(
        {
            "extends": "spreading",
            "training": False,
            "matrix": {"inclusion": False, "gradient": False},
        }
    )
    assert new.matrix == dataclasses.replace(old.matrix, inclusion=None)
    assert not new.learn
    assert new.training == Training()
    for table in ({"matrix": {"diameter": False}}, {"seed": False}, {"matrix": {"x": False}}):
        with pytest.raises(SceneError):
            Scene.parse({"extends": "spreading", **table})
    tables = scene_schema()["$defs"]
    assert {"const": False} in tables["DiscTable"]["properties"]["inclusion"]["anyOf"]
    assert {"const": False} in tables["DiscSceneTable"]["properties"]["training"]["anyOf"]
    assert "const" not in json.dumps(tables["DiscTable"]["properties"]["diameter"])


# Variants


def test_values_are_split_where_they_should_be():
    assert split_values("100 pN, 200 pN") == ["100 pN", "200 pN"]
    assert split_values('[1, 2],{a = "x,y"},"p,q"') == ["[1, 2]", '{a = "x,y"}', '"p,q"']
    assert read_setting("a.b = 1,2") == ("a.b", ["1", "2"])
    for wrong in ("a.b", "=1", "a=", "a=1,,2"):
        with pytest.raises(SceneError, match="must read key=value"):
            read_setting(wrong)


def test_variants_are_all_combinations_and_wrong_ones_stop_before_any_run():
    made = variants(
        "isolated_membrane",
        [read_setting("effects.volume.modulus=100 Pa,200 Pa"), read_setting("seed=1,2,3"),
         read_setting('cells.0.position=["1 um", "2 um"]')],
    )  # fmt: skip
    assert len(made) == 6
    assert {(s.effects["volume"].modulus, s.seed) for _, s in made} == {
        (m, k) for m in (100.0, 200.0) for k in (1, 2, 3)
    }
    assert all(s.cells[0].position == (1.0, 2.0) for _, s in made)
    assert made[0][0]["seed"] == "1"
    assert variants("spreading", [("effects.polarity", ["false"])])[0][1].cells
    for setting, words in (
        ("effects.volume.modulos=1 Pa", "did you mean 'modulus'"),
        ("effects.volume.modulus=1", "has no unit"),
        ("cells.1.radius=1 um", "entries 0 to 0"),
        ("name.x=1", "is a value, not a table"),
        ("effects.polarity=1", r"with effects.polarity = 1: effects.polarity"),
    ):
        with pytest.raises(SceneError, match=words):
            variants("isolated_membrane", [read_setting(setting)])
    with pytest.raises(SceneError, match="set twice"):
        variants("isolated_membrane", [("seed", ["1"]), ("seed", ["2"])])
    table = {"a": [{"b": 1}]}
    assert with_value(table, "a.0.b", 2) == {"a": [{"b": 2}]}
    assert table == {"a": [{"b": 1}]}


def test_leaving_out_takes_along_what_needs_it():
    scene = load_scene("spreading")
    rest, also = without(scene, "matrix_elasticity")
    assert also == ("focal_adhesion", "lamellipodium", "polarity", "stiffness_sensing")
    assert set(scene.effects) - set(rest.effects) == {"matrix_elasticity", *also}
    # the reaction of the push goes through the clutches, in this scene and not in the literal one
    assert without(scene, "focal_adhesion")[1] == ("lamellipodium",)
    literal = load_scene(EXAMPLES / "spreading_literal.toml")
    assert without(literal, "focal_adhesion")[1] == ()
    for name in scene.effects:
        if name != "drag":
            assert build(without(scene, name)[0]).states.size > 0
    with pytest.raises(SceneError, match="drag is missing"):
        without(scene, "drag")
    with pytest.raises(SceneError, match="has no effect 'nucleus'"):
        without(scene, "nucleus")


# Schema


def test_the_schema_completes_what_a_file_may_hold():
    schema = scene_schema(effects=[Wind])
    text = json.dumps(schema)
    assert schema["$schema"].startswith("https://json-schema.org/")
    assert '"null"' not in text
    tables = schema["$defs"]
    effects = tables["EffectsTable"]["properties"]
    assert set(effects) == {*LISTED, "wind"}
    assert {"const": False} in effects["volume"]["anyOf"]
    disc = tables["DiscSceneTable"]
    assert disc["properties"]["extends"]["examples"] == preset_names()
    assert {"required": ["extends"]} in disc["anyOf"]
    force = tables["LamellipodiumTable"]["properties"]["force"]
    assert "force of a leading node" in force["description"]
    kinetics = tables["FocalAdhesionTable"]["properties"]["kinetics"]
    assert kinetics["enum"] == ["clutch", "switching"]
    assert "Bell clusters" in json.dumps(tables["StochasticAdhesionTable"])


# Mutations

BASES = [
    tiny("polarity", "focal_adhesion", "stress_fibres", "nucleus", "cell_contact", "noise"),
    tiny("stochastic_adhesion", "cortex", "matrix_creep", "external_strain", "lamellipodium"),
    {"extends": "two_cells", "effects": {"fibre_bending": {}, "matrix_degradation": {}}},
    tomllib.loads((PRESETS / "crawler.toml").read_text()),
]
KEYS = sorted({*LISTED, *(f.name for e in EFFECTS.values() for f in dataclasses.fields(e)),
               "name", "duration", "matrix", "cells", "extends", "effects", "history"})  # fmt: skip
VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-(10**9), 10**9),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from(["5 um", "-1 pN", "0 s", "1e400 Pa", "3", "nan um", "rim", "kelvin", "",
                     "volume", "1/0 1/s", "7 parsec", [], {}, ["1 um"],
                     {"times": ["0 s"], "values": [1]}]),
    st.text(string.printable, max_size=8),
)  # fmt: skip

# What to do, in the words of the messages.
CURES = (
    "take ",
    "must ", "should", "did you mean", "known:", "it belongs to", "add ", "is missing", "needs",
    "leave one of them out", "no meaning", "there is no", "has no [[cells]]", "move", "write for",
    "expected", "keep it", "sample less often", "longer than", "are not", "at least", "at most",
    "or shorten", "presets:", "divides by zero", "required", "such as", "missing", "commands",
)  # fmt: skip


def paths(table, prefix=()):
    for key, value in table.items() if isinstance(table, dict) else enumerate(table):
        yield (*prefix, key)
        if isinstance(value, (dict, list)):
            yield from paths(value, (*prefix, key))


@settings(max_examples=300, deadline=2000, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_mutated_scenes_are_accepted_or_refused_with_key_value_and_cure(data):
    """Up to three changes: a value, a key taken away, a key misspelt or put where it is not known.

    An accepted scene has a fingerprint and survives its own canonical form; a refusal is one
    SceneError, in one line, and names the key that was changed or what is missing.
    """
    table = copy.deepcopy(data.draw(st.sampled_from(BASES)))
    touched = []
    for _ in range(data.draw(st.integers(1, 3))):
        found = list(paths(table))
        if not found:
            break
        path = data.draw(st.sampled_from(found))
        place = table
        for key in path[:-1]:
            place = place[key]
        kind = data.draw(st.sampled_from(["value", "drop", "misspell", "add"]))
        name = str(path[-1])
        if kind == "drop":
            del place[path[-1]]
        elif kind == "misspell" and isinstance(place, dict):
            name = name[:-1] + data.draw(st.sampled_from("xz_"))
            place[name] = place.pop(path[-1])
        elif kind == "add" and isinstance(place, dict):
            name = data.draw(st.sampled_from(KEYS))
            place[name] = copy.deepcopy(data.draw(VALUES))
        else:
            value = copy.deepcopy(data.draw(VALUES))
            if value is None:
                del place[path[-1]]
            else:
                place[path[-1]] = value
        touched.append(name)
    before, refusal, scene = copy.deepcopy(table), None, None
    try:
        scene = Scene.parse(table)
    except CellsysError as error:
        refusal = error
    assert repr(table) == repr(before), "the caller's table was changed"
    if refusal is not None:
        text = str(refusal)
        assert type(refusal) is SceneError
        assert "\n" not in text
        assert any(name in text for name in (*touched, *KEYS)), text
        assert any(word in text for word in CURES), text
        return
    assert np.isfinite(scene.duration)
    plain = json.loads(json.dumps(scene.canonical(), allow_nan=False))
    assert scene_from_plain(plain).fingerprint() == scene.fingerprint()
