"""The rules of the house that a machine can check: imports go down, files are documented."""

import ast
import re
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path

import pytest

from tests.house import (
    by_position,
    circles,
    contract_members,
    crowded,
    foreign_privates,
    never_raised,
    parsed,
    repeated_classes,
    sniffed,
    told_apart,
)

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "cellsys"
FILES = sorted(PACKAGE.rglob("*.py"))

# Top to bottom; rooms on one line do not see each other.
FLOORS = [
    ("cli", "__main__"),
    ("study",),
    ("figures",),
    ("accuracy", "design", "io"),
    ("symbols",),
    ("population",),
    ("observe", "ports"),
    ("loop",),
    ("reduction", "cell", "field", "scene"),
    ("worth",),
    ("model",),
    ("samples",),
    ("mechanics",),
    ("effects",),
    ("bondgraph", "geometry", "integrate", "response"),
    ("spectra",),
    ("contracts", "state_space"),
    ("linear_systems",),
    (
        "system",
        "overdamped",
        "trajectory",
        "trajectory_file",
        "tracks",
        "contours",
        "exported",
        "drawable",
        "answers",
    ),
    ("laws", "store"),
    (
        "units",
        "arguments",
        "kinds",
        "printable",
        "shown",
        "errors",
        "version",
        "threads",
        "compiled",
    ),
    ("renamed",),
]
FLOOR = {room: height for height, rooms in enumerate(reversed(FLOORS)) for room in rooms}
# The ground floor and the files of the middle one are single modules that may look at each other
# downwards only: trajectory is built from system and drawable, units from errors.
INSIDE = {
    ("trajectory", "system"),
    ("trajectory", "exported"),
    ("trajectory", "trajectory_file"),
    ("trajectory_file", "system"),
    ("exported", "drawable"),
    ("contours", "tracks"),
    ("overdamped", "system"),
    ("answers", "system"),
    ("units", "errors"),
    ("units", "arguments"),
    ("units", "kinds"),
    ("arguments", "kinds"),
    ("arguments", "errors"),
    ("__main__", "cli"),
}


def room_of(path: Path) -> str:
    """Room of a file: the folder under cellsys/, or the name of a file that stands there."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return parts[0]


def imported_rooms(path: Path) -> set[tuple[str, int]]:
    """(room, line) of every import of cellsys in a file, function-level ones included."""
    found = set()
    inside = ("cellsys", *path.relative_to(PACKAGE).parts[:-1])
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            for name in (alias.name.split(".") for alias in node.names):
                if name[0] == "cellsys":
                    found.add((name[1] if len(name) > 1 else "__init__", node.lineno))
        elif isinstance(node, ast.ImportFrom):
            base = tuple((node.module or "").split(".")) if node.module else ()
            if node.level:
                base = inside[: len(inside) - node.level + 1] + base
            if base[:1] != ("cellsys",):
                continue
            rooms = [base[1]] if len(base) > 1 else [alias.name for alias in node.names]
            found.update((room, node.lineno) for room in rooms)
        elif isinstance(node, ast.Call) and path.name not in ("drawable.py", "exported.py"):
            # importlib.import_module("cellsys.x"), __import__("cellsys.x")
            for argument in node.args:
                text = argument.value if isinstance(argument, ast.Constant) else None
                if isinstance(text, str) and text.startswith("cellsys."):
                    name = ast.unparse(node.func)
                    if name.endswith(("import_module", "__import__")):
                        found.add((text.split(".")[1], node.lineno))
    return found


def test_every_room_has_a_floor():
    rooms = {room_of(p) for p in FILES} - {"__init__"}
    assert rooms <= set(FLOOR), f"rooms without a place in the house: {sorted(rooms - set(FLOOR))}"
    assert set(FLOOR) <= rooms, f"floors without a room: {sorted(set(FLOOR) - rooms)}"


def test_imports_go_down():
    wrong = []
    for path in FILES:
        here = room_of(path)
        if here == "__init__":
            continue
        for there, line in imported_rooms(path):
            if there in (here, "__init__", "__version__"):
                continue
            allowed = FLOOR.get(there, 99) < FLOOR[here] or (here, there) in INSIDE
            if not allowed:
                wrong.append(f"{path.relative_to(ROOT)}:{line} ({here} -> {there})")
    assert not wrong, "imports that do not go down:\n" + "\n".join(wrong)


def test_the_import_test_sees_function_level_imports(tmp_path):
    """Naive version: looking at module-level statements only misses a hidden upward import."""
    source = "def f():\n    from cellsys.loop import closed_loop\n    return closed_loop\n"
    module_level = [n for n in ast.parse(source).body if isinstance(n, ast.ImportFrom)]
    assert not module_level
    hidden = PACKAGE / "laws" / "arrays.py"  # its place decides how relative imports resolve
    walked = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.ImportFrom)]
    assert walked[0].module == "cellsys.loop"
    assert FLOOR["loop"] > FLOOR[room_of(hidden)]


SOURCES = {str(p.relative_to(ROOT)): p.read_text("utf-8") for p in FILES}


def test_no_files_in_a_circle():
    found = circles(SOURCES)
    assert not found, f"files that import each other: {[sorted(group) for group in found]}"


def test_the_circle_test_sees_hidden_imports():
    """Naive version: imports at the top of a file alone, where these two do not meet."""
    hidden = "def f():\n    from cellsys.b import g\n    return g\n"
    typed = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .a import f\n"
    pair = {"cellsys/__init__.py": "", "cellsys/a.py": hidden, "cellsys/b.py": typed}
    top = [n for text in pair.values() for n in parsed(text).body]
    assert not any("cellsys" in ast.unparse(n) for n in top if isinstance(n, ast.ImportFrom))
    assert circles(pair) == [{"cellsys.a", "cellsys.b"}]
    long = {f"cellsys/n{k}.py": f"import cellsys.n{(k + 1) % 5}\n" for k in range(5)}
    assert circles(long) == [{f"cellsys.n{k}" for k in range(5)}]
    assert circles({**long, "cellsys/n4.py": ""}) == []


def test_no_class_name_stands_twice():
    assert repeated_classes(SOURCES) == {}


def test_the_class_test_sees_inner_and_private_classes():
    """Naive version: the public names of the package, which hold one of two that are alike."""
    two = {"a.py": "class _Port:\n    pass\n", "b.py": "def f():\n    class _Port:\n        pass\n"}
    assert repeated_classes(two) == {"_Port": ["a.py", "b.py"]}


def test_private_names_stay_in_their_file():
    assert foreign_privates(SOURCES) == []


def test_the_privacy_test_sees_names_behind_their_module():
    """Naive version: ``from x import _y`` alone misses ``x._y``."""
    pair = {
        "cellsys/a.py": "_LIMIT = 1\n",
        "cellsys/b.py": "from cellsys import a\nimport cellsys.a as c\nx = a._LIMIT + c._LIMIT\n",
        "cellsys/c.py": "def f():\n    from cellsys.a import _LIMIT as limit\n    return limit\n",
    }
    seen = foreign_privates(pair)
    assert seen == ["cellsys/b.py: a._LIMIT", "cellsys/b.py: c._LIMIT", "cellsys/c.py: _LIMIT"]


def test_contracts_are_not_sniffed():
    """What crosses a room crosses it in a contract (`needs`), not by ``hasattr``."""
    asked = contract_members(SOURCES["cellsys/contracts.py"])
    for file in ("linear_systems", "integrate/capabilities", "ports/capabilities"):
        asked |= contract_members(SOURCES[f"cellsys/{file}.py"])
    found = sniffed(SOURCES, asked)
    assert not found, f"hasattr on a contract: {sorted(found)}"


def test_the_contract_test_sees_attributes_and_methods():
    contracts = "class Field(Protocol):\n    order: int\n    def gather(self): ...\n"
    contracts += "class Other:\n    x: int\n"
    assert contract_members(contracts) == {"order", "gather"}
    asks = "def f(v):\n    return hasattr(v, 'gather') or hasattr(v, 'x')\n"
    assert sniffed({"a.py": asks}, contract_members(contracts)) == {("a.py", "gather")}


def test_no_file_asks_which_matrix_it_has():
    """Disc and chain are objects of one contract, and so is what a user adds."""
    assert told_apart(SOURCES) == []
    # naive: a search for one spelling
    for asks in ("isinstance(scene.matrix, ChainScene)", "plan.matrix.kind == 'chain'"):
        assert told_apart({"a.py": f"def f(scene, plan):\n    return {asks}\n"}) == ["a.py:2"]


def test_every_exception_is_raised():
    """Of `errors`, but the root. Naive: a name that is imported and caught counts as used."""
    found = never_raised(SOURCES["cellsys/errors.py"], SOURCES)
    assert found <= {"CellsysError"}, f"never raised: {sorted(found)}"
    caught = "from e import Lost\ntry:\n    f()\nexcept Lost:\n    pass\n"
    assert never_raised("class Lost(Exception):\n    pass\n", {"a.py": caught}) == {"Lost"}


def test_every_extra_is_used():
    """A package of an extra is imported by the package, its tests or its scripts, or run by CI."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    text = "\n".join(
        path.read_text("utf-8")
        for folder in ("cellsys", "tests", "analysis")
        for path in (ROOT / folder).rglob("*.py")
    ) + (ROOT / ".ci" / "run").read_text("utf-8")
    names = {
        "scikit-image": "extra(\"skimage.",
        "pytest-xdist": "-n 2", "dask[distributed]": "importorskip(\"distributed\")",
        "mypy": "python .ci/types", "scipy-stubs": "python .ci/types",  # it reads the stubs
    }  # fmt: skip
    for extra, wanted in project["optional-dependencies"].items():
        for requirement in wanted:
            package = re.split("[=><]", requirement)[0]
            asked = names.get(package, rf"(import {package}\b|from {package}\b|-m {package}\b|"
                              rf"bin/{package}\b|importorskip\(\"{package}[\".])")  # fmt: skip
            assert re.search(asked if package not in names else re.escape(asked), text), extra


def test_dataclasses_above_four_fields_are_filled_by_name():
    """What comes first may go by place: Realization(A, B, C, D), GalerkinField(system)."""
    assert by_position(SOURCES, 4) == []
    five = "@dataclass(frozen=True)\nclass A:\n" + "".join(f"    f{i}: int\n" for i in range(5))
    assert by_position({"a.py": five}, 4) == ["a.py: A takes 5"]


def test_no_room_is_over_six_thousand_lines():
    """With the folders inside it. Naive: file by file, or folder by folder."""
    assert crowded(SOURCES, 6000) == {}
    assert crowded({"a/b/c.py": "x\n" * 4, "a/b/d/e.py": "x\n" * 3}, 6) == {"a/b": 7}


def test_heavy_libraries_have_their_rooms():
    """Matplotlib in figures/ alone, numba behind `compiled`."""
    wrong = []
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name.split(".")[0] for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names = [node.module.split(".")[0]]
            if "matplotlib" in names and room_of(path) != "figures":
                wrong.append(f"{path.relative_to(ROOT)}:{node.lineno} imports matplotlib")
            if "numba" in names and path != PACKAGE / "compiled.py":
                wrong.append(f"{path.relative_to(ROOT)}:{node.lineno} imports numba")
    assert not wrong, "\n".join(wrong)


def test_commands_write_through_their_output():
    """What files hold reaches a terminal without control characters: `cli.output` alone prints."""
    wrong = []
    for path in sorted((PACKAGE / "cli").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            called = isinstance(node, ast.Call) and ast.unparse(node.func)
            if called in ("print", "typer.echo") and path.name != "output.py":
                wrong.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not wrong, wrong


def test_outside_scripts_use_public_names_only():
    """analysis/ and examples/ import cellsys itself or whole rooms, never underscored names."""
    wrong = []
    for folder in ("analysis", "examples"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cellsys"):
                    hidden = [a.name for a in node.names if a.name.startswith("_")]
                    if hidden or any(p.startswith("_") for p in node.module.split(".")):
                        wrong.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not wrong, wrong


def public_definitions(tree: ast.Module):
    """(node, is_method) of public functions, classes and their public methods."""
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            yield node, False
            if isinstance(node, ast.ClassDef):
                for item in node.body:
                    if isinstance(item, ast.FunctionDef) and not item.name.startswith("_"):
                        yield item, True


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_file(path):
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    wrong = []
    lines = text.count("\n")
    if lines > 400:
        wrong.append(f"{lines} lines; split it by noun")
    if text.strip() and ast.get_docstring(tree) is None:
        wrong.append("no module docstring")
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            wrong.append(f"line {node.lineno}: bare assert")
        if isinstance(node, ast.ExceptHandler) and (
            node.type is None or ast.unparse(node.type) in ("Exception", "BaseException")
        ):
            wrong.append(f"line {node.lineno}: broad except")
    documented = {
        item.name
        for node in tree.body
        if isinstance(node, ast.ClassDef)
        for item in node.body
        if isinstance(item, ast.FunctionDef) and ast.get_docstring(item)
    }
    for node, is_method in public_definitions(tree):
        # A method that takes part in a protocol is documented where the protocol is.
        inherited = is_method and (node.name in documented or node.name in PROTOCOL)
        if ast.get_docstring(node) is None and not inherited:
            wrong.append(f"line {node.lineno}: {node.name} has no docstring")
        if isinstance(node, ast.FunctionDef) and node.args.kwarg is not None:
            wrong.append(f"line {node.lineno}: {node.name} takes **kwargs")
    if len(wrong) > 0:
        pytest.fail(f"{path.relative_to(ROOT)}: " + "; ".join(wrong))


def _protocol() -> set[str]:
    """Methods documented on the base classes that other rooms implement."""
    names = set()
    bases = ("system.py", "overdamped.py", "effects/protocol.py", "integrate/stepping.py")
    for base in bases:
        for node in ast.parse((PACKAGE / base).read_text("utf-8")).body:
            if isinstance(node, ast.ClassDef):
                names |= {
                    item.name
                    for item in node.body
                    if isinstance(item, ast.FunctionDef) and ast.get_docstring(item)
                }
    return names


PROTOCOL = _protocol()


def test_top_level_entries():
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    entries = {name.split("/")[0] for name in listed.stdout.splitlines()}
    seen = {name for name in entries if not name.startswith(".")}
    assert seen == {"pyproject.toml", "cellsys", "analysis", "tests", "examples", "README.md"}


def test_nothing_points_at_one_machine():
    """No absolute home or work directory in anything that is shipped."""
    marks = ["/" + "home/", "/" + "work/", "/" + "tmp/", "/" + "Users/"]
    listed = subprocess.run(
        ["git", "ls-files", "cellsys", "examples", "analysis", "README.md", "pyproject.toml"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    wrong = []
    for name in listed.stdout.splitlines():
        path = ROOT / name
        if path.suffix in (".py", ".pyi", ".toml", ".md") and path.exists():
            text = path.read_text("utf-8")
            wrong += [f"{name}: {mark}" for mark in marks if mark in text]
    assert not wrong, wrong


@pytest.mark.parametrize(
    ("category", "module", "error"),
    [
        (DeprecationWarning, "cellsys.store.runs", True),
        (UserWarning, "tests.naive", True),
        (DeprecationWarning, "control.statesp", False),
        (UserWarning, "matplotlib._mathtext", False),
        (RuntimeWarning, "scipy.linalg", True),  # of numbers that we gave it
    ],
)
def test_warnings_of_our_code_are_errors_and_those_of_others_are_theirs(category, module, error):
    with warnings.catch_warnings(record=True) as told:  # the filters stay
        try:
            warnings.warn_explicit("said", category, "a file", 1, module=module)
        except category:
            assert error
        else:
            assert not error
            assert len(told) <= 1


def test_the_versions_that_are_stated_are_the_versions_that_are_tried():
    """Every dependency states its lowest, and CI installs just these."""
    done = subprocess.run(
        [sys.executable, ".ci/lowest", "pytest"], cwd=ROOT, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    pins = dict(line.split("==") for line in done.stdout.split())
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert {f"{name}>={version}" for name, version in pins.items() if name != "pytest"} == set(
        stated["dependencies"]
    )
    assert ".ci/lowest" in (ROOT / ".ci" / "run").read_text("utf-8")
    for version in ("3.11", "3.12", "3.13"):
        assert f"Programming Language :: Python :: {version}" in stated["classifiers"]
