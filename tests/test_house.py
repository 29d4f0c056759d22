"""The rules of the house that a machine can check: imports go down, files are documented."""

import ast
import os
import subprocess
import sys
import time
import tomllib
import warnings
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "cellsys"
FILES = sorted(PACKAGE.rglob("*.py"))

# Top to bottom; rooms on one line do not see each other.
FLOORS = [
    ("cli", "__main__"),
    ("study",),
    ("figures",),
    ("accuracy", "io"),
    ("population",),
    ("observe",),
    ("loop",),
    ("reduction", "cell", "field", "scene"),
    ("worth",),
    ("model",),
    ("samples",),
    ("mechanics",),
    ("bondgraph", "integrate", "response"),
    ("contracts", "state_space"),
    ("laws", "store"),
    ("system", "overdamped", "trajectory", "drawable"),
    ("units", "arguments", "kinds", "printable", "errors", "version"),
    ("renamed",),
]
FLOOR = {room: height for height, rooms in enumerate(reversed(FLOORS)) for room in rooms}
# The ground floor and the files of the middle one are single modules that may look at each other
# downwards only: trajectory is built from system and drawable, units from errors.
INSIDE = {
    ("trajectory", "system"),
    ("trajectory", "drawable"),
    ("overdamped", "system"),
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
        elif isinstance(node, ast.Call) and path.name != "drawable.py":
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
            if "numba" in names and path != PACKAGE / "mechanics" / "compiled.py":
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
    bases = ("system.py", "overdamped.py", "mechanics/effects/protocol.py", "integrate/stepping.py")
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


HEAVY = ("control", "casadi", "matplotlib", "numba")


def best_of(command: list[str], times: int) -> float:
    """Shortest wall time, s: what is left when other processes do not disturb."""
    best = float("inf")
    for _ in range(times):
        began = time.perf_counter()
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        best = min(best, time.perf_counter() - began)
        assert done.returncode == 0, done.stderr
    return best


def test_import_is_light():
    """`import cellsys` loads no heavy library: the interpreter alone plus under 0.4 s."""
    code = f"import sys, cellsys; print([m for m in {HEAVY!r} if m in sys.modules])"
    loaded = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()
    assert loaded == "[]"
    assert best_of([sys.executable, "-c", "import cellsys"], 5) < 0.4


def test_help_is_quick():
    """`cellsys --help` in under 0.8 s, exit code 0."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", "cellsys", "--help"],
        cwd=ROOT, capture_output=True, text=True, check=False, env=environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for command in ("run", "reduce", "poles", "bode", "stability", "effects", "schema"):
        assert command in done.stdout
    assert best_of([sys.executable, "-m", "cellsys", "--help"], 5) < 0.8


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
