"""Scenes meant to hang, to crash or to write to the terminal: refused at once, in one line."""

import os
import re
import time

import pytest

import cellsys as cs
from cellsys.errors import CellsysError, SceneError, UnitError
from cellsys.scene import load_scene
from cellsys.scene.variants import MOST_SCENES, read_setting, variants, with_value
from tests.study.scenes import TINY

pytestmark = pytest.mark.usefixtures("soon")


@pytest.fixture
def soon():
    """Each is refused within 5 s: tens of times what it takes, a fraction of a hang."""
    start = time.perf_counter()
    yield
    assert time.perf_counter() - start < 5.0


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(TINY)
    return path


posix = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")


@posix
@pytest.mark.parametrize("odd", ["pipe.toml", "/dev/zero", "/dev/tty", "/dev/null", "folder"])
def test_only_regular_files_are_scenes(tmp_path, odd):
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "folder").mkdir()
    path = tmp_path / odd  # an absolute name stays as it is
    for step in range(2):
        with pytest.raises((CellsysError, OSError)) as raised:
            load_scene(path)
        assert "regular" in str(raised.value) or odd == "/dev/tty"
        path = tmp_path / f"extends{step}.toml"
        path.write_text(f'extends = "{odd}"\n{TINY}')


def test_long_files_are_not_read(tmp_path, scene):
    scene.write_text(TINY + "# " + "x" * 1_000_000)
    with pytest.raises(SceneError, match=r"1 MB; at most 1 MB"):
        load_scene(scene)
    (tmp_path / "t.toml").write_text('extends = "s.toml"')
    with pytest.raises(SceneError, match="at most 1 MB"):
        load_scene(tmp_path / "t.toml")


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("x = " + "9" * 5000, "number that cannot be read"),
        ("x = 1e" + "9" * 5000, "unknown key 'x'"),
        ("a." * 20_000 + "b = 1", "more than 16 parts"),
        ('"a".' * 20_000 + "b = 1", "more than 16 parts"),
        ("[" + "a." * 20_000 + "b]", "more than 16 parts"),
        ("x = " + "[" * 20_000, "nested too deeply"),
        ("x = " + "[" * 300 + "]" * 300, "nested too deeply"),
        ("x = " + "{a = " * 300 + "1" + "}" * 300, "nested too deeply"),
        ("x" * 90_000 + " = 1", "unknown key 'xxx"),
    ],
    ids=lambda text: text[:12],
)
def test_texts_that_take_a_parser_long(scene, lines, words):
    scene.write_text(f"{lines}\n{TINY}")
    with pytest.raises(SceneError, match=words) as raised:
        load_scene(scene)
    assert len(str(raised.value)) < 2000


@pytest.mark.parametrize("odd", ["9" * 30_000, "9" * 30_000 + " x", "1 " + "s " * 30_000,
                                 "1 s" + " " * 30_000 + "x", "1/" * 9000, "1 s^9999", "1e308 km^9",
                                 "1 m^-9999", "1e308 km"])  # fmt: skip
def test_long_quantities(scene, odd):
    for unit in ("s", "m"):
        with pytest.raises(UnitError):
            cs.quantity(odd, unit)
    duration = re.search(r'duration = ".*"', TINY)[0]
    scene.write_text(TINY.replace(duration, f'duration = "{odd}"'))
    with pytest.raises(SceneError, match="duration") as raised:
        load_scene(scene)
    assert len(str(raised.value)) < 500


def test_both_letters_mu_are_micro():
    assert cs.quantity("3 \u00b5m", "um") == cs.quantity("3 \u03bcm", "um") == 3.0


def test_a_long_chain_of_scenes(tmp_path):
    (tmp_path / "0.toml").write_text(TINY)
    for k in range(1, 1201):
        (tmp_path / f"{k}.toml").write_text(f'extends = "{k - 1}.toml"')
    assert load_scene(tmp_path / "30.toml").duration > 0
    with pytest.raises(SceneError, match="more than 32 scenes extend each other"):
        load_scene(tmp_path / "1200.toml")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("", "1"), (".", "1"), ("a.", "1"), (".a", "1"), ("a..b", "1"), ("duration.x", "1"),
        ("cells.\u00b2.radius", "1"), ("cells.-1.radius", "1"), ("cells.99.radius", "1"),
        ("cells." + "9" * 5000 + ".radius", "1"), ("cells", "1"), ("[red]x[/blue]", "1"),
        ("\x1b[31mx", "1"), ("__class__", "1"), ("a." * 20_000 + "b", "1"), ("a" * 90_000, "1"),
        ("seed", "9" * 5000), ("seed", "1\nduration = '1 s'"), ("seed", "[" * 5000),
        ("seed", "[/x]"), ("seed", "nan"), ("duration", "'" + "1" * 30_000 + " s'"),
        ("duration", "1 s\x1b[31m"), ("effects", "false"), ("extends", "pair"), ("name", "{a=1}"),
    ],
    ids=lambda text: text[:10].encode("unicode_escape").decode(),
)  # fmt: skip
def test_odd_settings(scene, key, value):
    with pytest.raises(SceneError) as raised:
        variants(scene, [read_setting(f"{key}={value}")])
    assert len(str(raised.value)) < 2000


def test_markup_and_odd_letters_in_a_name_are_a_name(scene):
    ((values, made),) = variants(scene, [read_setting("name='[/red] \u03bc'")])
    assert "[/red]" in made.name
    assert values == {"name": "'[/red] \u03bc'"}


def test_a_sweep_has_a_bound(scene):
    """60 x 60 x 60 values: refused before the first scene is made."""
    many = ",".join(f"{k} s" for k in range(1, 61))
    settings = [read_setting(f"{key}={many}") for key in ("duration", "sample", "step")]
    said = f"216000 combinations, each a run .*[GT]B in all.*at most {MOST_SCENES}"
    with pytest.raises(SceneError, match=said):
        variants(scene, settings)


def test_a_table_is_not_changed_by_a_setting():
    table = {"a": {"b": 1}}
    assert with_value(table, "a.b", 2) == {"a": {"b": 2}}
    assert table == {"a": {"b": 1}}
