"""The notes: every thesis equation has its reading, every parameter its row."""

import dataclasses
import re
from importlib import import_module
from pathlib import Path

import pytest

import cellsys as cs
from cellsys.scene.registry import EFFECTS
from cellsys.scene.tables import DiscSceneTable, DiscTable
from cellsys.units import quantity

ROOT = Path(__file__).resolve().parent.parent
NOTES = ROOT / "analysis" / "notes"
FILES = sorted(NOTES.glob("*.md"))


# Thesis equations


def numbers(text: str) -> set[int]:
    """1-4, 7 -> {1, 2, 3, 4, 7}."""
    found: set[int] = set()
    for first, last in re.findall(r"(\d+)(?:-(\d+))?", text):
        found.update(range(int(first), int(last or first) + 1))
    return found


def read_equations() -> set[int]:
    """Numbers in the table of `theory`."""
    text = (NOTES / "theory.md").read_text("utf-8")
    section = text.split("## Equations one by one")[1].split("\n## ")[0]
    rows = re.findall(r"^\| ([\d, -]+) \|", section, re.MULTILINE)
    return set().union(*map(numbers, rows))


CITED = re.compile(r"[Tt]hesis(?:'s)?,? (?:4\.\d, )?(?:eqs?\.? )?((?:\d{1,2}(?:-|, )?)+)\b(?!\.)")


def test_every_thesis_equation_in_the_code_is_read_in_the_notes():
    known, cited = read_equations(), {}
    assert known == set(range(1, 94)), sorted(set(range(1, 94)) ^ known)
    for place in ("cellsys", "analysis", "examples"):
        for path in (ROOT / place).rglob("*.py"):
            for found in CITED.findall(path.read_text("utf-8")):
                cited.update(dict.fromkeys(numbers(found), path.name))
    assert {5, 24, 29, 36, 72, 86} <= cited.keys()
    missing = {n: where for n, where in cited.items() if n not in known}
    assert not missing, f"equations without a reading: {missing}"


def test_names_and_files_in_the_notes_exist():
    """A public name that was renamed, or a command whose script is gone, is found here."""
    wrong = []
    for path in FILES:
        text = path.read_text("utf-8")
        names = {(name, "") for name in re.findall(r"`cs\.(\w+)", text)}
        # `ClosedLoop.open_loop()`; an attribute may be a dataclass's field.
        attributes = re.findall(r"`([A-Z]\w+)\.(\w+)", text)
        names |= {(name, part) for name, part in attributes if hasattr(cs, name)}
        for name, part in sorted(names):
            thing = getattr(cs, name, None)
            fields = getattr(thing, "__dataclass_fields__", {})
            if thing is None or (part and not hasattr(thing, part) and part not in fields):
                wrong.append(f"{path.name}: {name}.{part}".rstrip("."))
        scripts = set(re.findall(r"(?:analysis|examples)/[\w/]+\.(?:py|toml|md)", text))
        wrong += [f"{path.name}: {script}" for script in scripts if not (ROOT / script).is_file()]
    assert not wrong, wrong


# Parameters


def rows() -> dict[str, str]:
    """Value of every parameter in the tables of `mechanics` and `matrix`."""
    text = "\n".join((NOTES / f"{name}.md").read_text("utf-8") for name in ("mechanics", "matrix"))
    found = re.findall(r"^\| `([\w.]+)` \| ([^|]+) \| ([^|]+) \| [^|]*\|$", text, re.MULTILINE)
    assert all(source.strip() for _, _, source in found), "a parameter without a source"
    names = [name for name, _, _ in found]
    assert len(names) == len(set(names)), "a parameter has two rows"
    return {name: value.strip() for name, value, _ in found}


def built() -> dict[str, tuple[object, str]]:
    """Value and unit of every parameter in the code that the notes must name."""
    out: dict[str, tuple[object, str]] = {}
    for name in EFFECTS.shipped:
        for item in dataclasses.fields(EFFECTS[name]):
            if "unit" in item.metadata:
                out[f"{name}.{item.name}"] = item.default, item.metadata["unit"]
    for kind in (cs.Crawler, _chain()):
        for item in dataclasses.fields(kind):
            if item.default is not None:
                out[f"{kind.__name__}.{item.name}"] = item.default, "1"
    for name, unit in (("diameter", "um"), ("thickness", "um"), ("modulus", "pN/um^2")):
        out[f"matrix.{name}"] = DiscTable.model_fields[name].default, unit
    cell = DiscSceneTable.model_fields["cells"].annotation.__args__[0]
    out["cells.radius"] = cell.model_fields["radius"].default, "um"
    for where, names in (
        ("mechanics.geometry.disc", {"DENSITY": "1/um^3", "COORDINATION": "1", "RIM": "1",
                                     "SURFACE_DEPTH": "um"}),
        ("mechanics.geometry.membrane", {"NODES": "1"}),
        ("scene.build", {"START_GAP": "um"}),
    ):  # fmt: skip
        module = import_module(f"cellsys.{where}")
        for name, unit in names.items():
            out[f"{where.rpartition('.')[2]}.{name}"] = getattr(module, name), unit
    return out


def _chain() -> type:
    from cellsys.mechanics.geometry.chain import Chain

    return Chain


def test_the_notes_have_every_parameter_at_its_value():
    noted, real = rows(), built()
    assert noted.keys() == real.keys(), (
        f"without a row: {sorted(real.keys() - noted.keys())}; "
        f"rows of nothing: {sorted(noted.keys() - real.keys())}"
    )
    wrong = {}
    for name, (value, unit) in real.items():
        text = noted[name]
        same = text == value if isinstance(value, str) else (
            # Eight digits are what a table shows of a number.
            quantity(text, unit) == pytest.approx(value, rel=1e-7, abs=0)
        )  # fmt: skip
        if not same:
            wrong[name] = f"{text} in the notes, {value!r} {unit} in the code"
    assert not wrong, wrong


def test_every_effect_has_a_source_for_every_parameter():
    bare = [
        f"{name}.{item.name}"
        for name in EFFECTS.shipped
        for item in dataclasses.fields(EFFECTS[name])
        if "unit" in item.metadata and not item.metadata["source"].strip()
    ]
    assert not bare, bare
