"""The notes that docstrings cite: every pointer has its heading, every parameter its row."""

import dataclasses
import re
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

import cellsys as cs
from cellsys.scene.registry import EFFECTS
from cellsys.scene.tables import DiscSceneTable, DiscTable
from cellsys.units import quantity

ROOT = Path(__file__).resolve().parent.parent
NOTES = ROOT / "analysis" / "notes"
FILES = sorted(NOTES.glob("*.md"))
KINDS = ("*.py", "*.pyi", "*.md", "*.toml")
PLACES = ("cellsys", "analysis", "examples", "tests")
# "[notes: theory, load ports]"; a line may break inside, behind a comment sign too.
POINTER = re.compile(r"\[notes:[\s#]*([a-z_]+),[\s#]*([^\]]+?)\]")
# What pointed to papers that are not in the repository.
OLD = re.compile(
    r"\b(?:theory|numerics|mechanics|physics|design|gel|stepping|style|field|pairs_phenotypes)\.md\b"
    r"|\bnumerics\b|\b(?:theory|mechanics):? \d|\bcalibration of \d|\[theory\b|\"mechanics \d"
)


@cache
def headings(name: str) -> frozenset[str]:
    """Headings of a note, in lower case."""
    text = (NOTES / f"{name}.md").read_text("utf-8")
    return frozenset(found.strip().lower() for found in re.findall(r"^##+ (.+)$", text, re.M))


def sources() -> list[Path]:
    """Every text that may point into the notes, the notes themselves among them."""
    found = {p for place in PLACES for kind in KINDS for p in (ROOT / place).rglob(kind)}
    return sorted((found | set(ROOT.glob("*.md"))) - {Path(__file__).resolve()})


def faults(text: str) -> list[str]:
    """Pointers of a text that lead nowhere, and pointers of the old kinds."""
    wrong = []
    for found in POINTER.finditer(text):
        name, heading = found[1], " ".join(re.sub(r"[\s#]+", " ", found[2]).split()).lower()
        if not (NOTES / f"{name}.md").is_file():
            wrong.append(f"{found[0]!r}: there is no {name}.md")
        elif heading not in headings(name):
            wrong.append(f"{found[0]!r}: {name}.md has no heading {heading!r}")
    # `notes: Mapping` is an annotation; a bracket or a word and a comma make it a pointer.
    if len(re.findall(r"\[notes:|[\[(]notes:? [a-z]+,", text)) != len(POINTER.findall(text)):
        wrong.append("a pointer that is not of the form [notes: FILE, HEADING]")
    # A path of the notes is a link, not a pointer of the old kinds.
    rest = re.sub(r"analysis/notes/\w+\.md", "", text)
    return wrong + [f"old pointer {found[0]!r}" for found in OLD.finditer(rest)]


def test_every_pointer_leads_to_a_heading():
    wrong, number = [], 0
    for path in sources():
        text = path.read_text("utf-8")
        if path.suffix == ".md":
            # Prose for people names a note by its file.
            text = re.sub(r"`\w+\.md`", "", text)
        number += len(POINTER.findall(text))
        wrong += [f"{path.relative_to(ROOT)}: {fault}" for fault in faults(text)]
    assert not wrong, "\n".join(wrong)
    assert number > 90, f"only {number} pointers found: the pattern no longer sees them"


@pytest.mark.parametrize(
    "text",
    [
        "A cell [notes: theory, no such heading].",
        "A cell [notes: nowhere, load ports].",
        "A cell [notes theory, load ports].",
        "A cell (notes: theory, load ports).",
        "A cell [theory.md 4b].",
        "A cell (numerics: 10).",
        'source="mechanics 2.4b k_b"',
        'source="cellsys calibration of 2.3 f_st"',
    ],
)
def test_a_false_pointer_is_seen(text):
    assert faults(text)


@pytest.mark.parametrize(
    "text",
    [
        "A cell [notes: theory, load ports].",
        "# A cell [notes: theory,\n    # load ports]",
        "from cellsys.mechanics import crawler",
        "notes: dict[str, str]",
        "The laws are in analysis/notes/mechanics.md.",
    ],
)
def test_a_true_pointer_passes(text):
    assert not faults(text)


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


class Row(NamedTuple):
    """A parameter in a table of the notes: value, source, and the heading it stands under."""

    value: str
    source: str
    file: str
    heading: str


@cache
def rows() -> dict[str, Row]:
    """Every parameter in the tables of `mechanics` and `matrix`."""
    found: dict[str, Row] = {}
    for file in ("mechanics", "matrix"):
        heading = ""
        for line in (NOTES / f"{file}.md").read_text("utf-8").split("\n"):
            if line.startswith("## "):
                heading = line[3:].lower()
            row = re.match(r"\| `([\w.]+)` \| ([^|]+) \| ([^|]+) \|", line)
            if row:
                assert row[1] not in found, f"{row[1]} has two rows"
                found[row[1]] = Row(row[2].strip(), row[3].strip(), file, heading)
    return found


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
        ("geometry.disc", {"DENSITY": "1/um^3", "COORDINATION": "1", "RIM": "1",
                                     "SURFACE_DEPTH": "um"}),
        ("geometry.membrane", {"NODES": "1"}),
        ("scene.plane", {"START_GAP": "um"}),
    ):  # fmt: skip
        module = import_module(f"cellsys.{where}")
        for name, unit in names.items():
            out[f"{where.rpartition('.')[2]}.{name}"] = getattr(module, name), unit
    return out


def _chain() -> type:
    from cellsys.geometry.chain import Chain

    return Chain


def test_the_notes_have_every_parameter_at_its_value():
    noted, real = {name: row.value for name, row in rows().items()}, built()
    assert noted.keys() == real.keys(), (
        f"without a row: {sorted(real.keys() - noted.keys())}; "
        f"rows of nothing: {sorted(noted.keys() - real.keys())}"
    )
    wrong = {}
    for name, (value, unit) in real.items():
        text = noted[name]
        value = str(value).lower() if isinstance(value, bool) else value
        same = text == value if isinstance(value, str) else (
            # Eight digits are what a table shows of a number.
            quantity(text, unit) == pytest.approx(value, rel=1e-7, abs=0)
        )  # fmt: skip
        if not same:
            wrong[name] = f"{text} in the notes, {value!r} {unit} in the code"
    assert not wrong, wrong


def test_code_and_notes_name_the_same_source():
    """Source of a parameter in the code: that of its row, and a pointer to the row's heading."""
    wrong = {}
    for name in EFFECTS.shipped:
        for item in dataclasses.fields(EFFECTS[name]):
            if "unit" not in item.metadata:
                continue
            row, source = rows()[f"{name}.{item.name}"], item.metadata["source"]
            word, _, pointer = source.partition(" [")
            if not (word and row.source.startswith(word)):
                wrong[f"{name}.{item.name}"] = f"{source!r} in the code, {row.source!r} noted"
            if pointer != f"notes: {row.file}, {row.heading}]":
                wrong[f"{name}.{item.name}"] = f"{source!r} does not lead to {row.heading!r}"
    assert not wrong, wrong
