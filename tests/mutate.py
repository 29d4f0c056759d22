"""Do the tests notice? Seeded mutations of the package, each against the tests that run its line.

    python -m tests.mutate --count 300 --seed 1 [--room loop] [--workers 2] [--map FILE] [--list]

A mutation swaps one operator or comparison, drops a minus or a `not`, or shifts a whole number by
one. What is text (messages, annotations) is left alone. First the default tests run once under
`coverage`, which notes the lines each test runs (kept in --map, and made again when the sources
changed); then every mutant meets the tests that run its line, quickest first, until one fails. A
line that no test runs, and a line of a compiled kernel, which coverage does not see, meet all
tests of their room. `tests/harmless.toml` lists mutants that change nothing a user could see, with
the reason; a mutant that survives and is not listed there ends the command with exit code 1.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import cache_from_source
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "cellsys"
HARMLESS = Path(__file__).with_name("harmless.toml")
SWAPS: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
LINES = Path(tempfile.gettempdir(), "cellsys-lines.json")
MOST = 240.0  # s: a mutant that makes its tests hang is noticed


@dataclass(frozen=True)
class Mutation:
    """One change: file below the package, line, number of the site in the file, and in words."""

    file: str
    line: int
    site: int
    before: str
    after: str

    @property
    def name(self) -> str:
        """How `harmless.toml` names it: it survives edits elsewhere in the file."""
        return f"{self.file}: {self.before} -> {self.after}"


class _Sites(ast.NodeTransformer):
    """Visits the sites of a file in order; changes number `wanted`, else only lists them."""

    def __init__(self, wanted: int = -1) -> None:
        self.wanted, self.count = wanted, 0
        self.found: list[tuple[int, str, str]] = []

    def _site(self, node: ast.expr, new: ast.expr) -> ast.expr:
        number, self.count = self.count, self.count + 1
        self.found.append((node.lineno, ast.unparse(node), ast.unparse(new)))
        return ast.copy_location(new, node) if number == self.wanted else node

    # Text is left alone: what is raised, what is formatted, what is annotated.
    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        return node

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.args.defaults = [self.visit(d) for d in node.args.defaults]
        node.args.kw_defaults = [d and self.visit(d) for d in node.args.kw_defaults]
        if node.name not in ("__str__", "__repr__", "_repr_html_", "lines"):
            node.body = [self.visit(s) for s in node.body]
        return node

    def visit_If(self, node: ast.If) -> ast.AST:
        if ast.unparse(node.test) == "TYPE_CHECKING":
            return node
        return self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        text = any(isinstance(s, (ast.JoinedStr, ast.List)) or _is_text(s)
                   for s in (node.left, node.right))  # fmt: skip
        if text or type(node.op) not in SWAPS:
            return node
        return self._site(node, ast.BinOp(node.left, SWAPS[type(node.op)](), node.right))

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        for k, op in enumerate(node.ops):
            if type(op) in SWAPS:
                ops = [*node.ops[:k], SWAPS[type(op)](), *node.ops[k + 1 :]]
                changed = self._site(node, ast.Compare(node.left, ops, node.comparators))
                if changed is not node:
                    return changed
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        return self._site(node, ast.BoolOp(SWAPS[type(node.op)](), node.values))

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, (ast.USub, ast.Not)):
            return self._site(node, node.operand)
        return node


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def mutations(path: Path) -> list[Mutation]:
    """Every site of a file of the package."""
    visitor = _Sites()
    visitor.visit(ast.parse(path.read_text("utf-8")))
    name = path.relative_to(PACKAGE).as_posix()
    return [Mutation(name, line, k, a, b) for k, (line, a, b) in enumerate(visitor.found)]


def mutated(path: Path, site: int) -> str:
    """Source of a file with one site changed."""
    return ast.unparse(ast.fix_missing_locations(_Sites(site).visit(ast.parse(path.read_text()))))


def drawn(count: int, seed: int, rooms: list[str]) -> list[Mutation]:
    """A sample without replacement over all sites of the rooms."""
    files = sorted(PACKAGE.rglob("*.py"))
    if rooms:
        files = [f for f in files if f.relative_to(PACKAGE).parts[0].removesuffix(".py") in rooms]
    sites = [m for f in files for m in mutations(f)]
    return random.Random(seed).sample(sites, min(count, len(sites)))


# Which tests run which line


def line_map(file: Path, workers: int) -> dict[str, dict[str, list[str]]]:
    """{source file: {line: tests}} of the default tests, from `file` or made now."""
    sources = [p for d in ("cellsys", "tests") for p in sorted((ROOT / d).rglob("*.py"))]
    key = hashlib.sha256(b"".join(p.read_bytes() for p in sources)).hexdigest()
    if file.exists():
        known = json.loads(file.read_text())
        if known["key"] == key:
            return known["lines"]
    try:
        import coverage
    except ModuleNotFoundError:
        sys.exit("this command needs coverage: pip install '.[dev]'")
    print("default tests under coverage, once ...", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        data, settings = Path(scratch, "data"), Path(scratch, "rc")
        settings.write_text(
            f"[run]\nsource = {PACKAGE}\ndynamic_context = test_function\ndata_file = {data}\n"
            "patch = subprocess\nparallel = true\n"
        )
        tool = [sys.executable, "-m", "coverage"]
        tests = ["-m", "pytest", "-q", "-p", "no:cacheprovider"]
        split = ["-n", str(workers), "--dist", "loadfile"] if workers > 1 else []
        subprocess.run([*tool, "run", f"--rcfile={settings}", *tests, *split], cwd=ROOT, check=True)
        combine = [*tool, "combine", "-q", f"--rcfile={settings}", str(scratch)]
        subprocess.run(combine, cwd=ROOT, check=True)
        found = coverage.CoverageData(basename=str(data))
        found.read()
        lines = {}
        for source in found.measured_files():
            contexts = found.contexts_by_lineno(source)
            name = Path(source).relative_to(PACKAGE).as_posix()
            lines[name] = {str(n): sorted(c for c in cs if c) for n, cs in contexts.items()}
    file.write_text(json.dumps({"key": key, "lines": lines}))
    return lines


def test_file_of(context: str) -> str:
    """tests/a/test_b.py of the context ``tests.a.test_b.test_c``."""
    parts = context.split(".")
    for k in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:k]).with_suffix(".py")
        if path.exists():
            return path.relative_to(ROOT).as_posix()
    return ""


def tests_for(mutation: Mutation, lines: dict[str, dict[str, list[str]]]) -> list[str]:
    """Arguments of pytest: what runs the line, else the room's tests."""
    contexts = lines.get(mutation.file, {}).get(str(mutation.line), [])
    found: dict[str, set[str]] = {}
    for context in contexts:
        path = test_file_of(context)
        if path:
            module = path.removesuffix(".py").replace("/", ".")
            name = context.removeprefix(module + ".").split(".")
            found.setdefault(path, set()).add("::".join(name))
    if found and "kernels" not in mutation.file:
        chosen = [f"{p}::{n}" for p, names in sorted(found.items()) for n in sorted(names)]
        return chosen[:60]
    room = Path(mutation.file).parts[0].removesuffix(".py")
    folder = ROOT / "tests" / room
    return [f"tests/{room}"] if folder.is_dir() else ["tests"]


# Running


# Imports what all tests import, then forks for every list of tests: a second, not six.
SERVER = """
import json, os, sys
import casadi, control, matplotlib.pyplot, numba, pytest, scipy.signal, scipy.stats

for line in sys.stdin:
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nowhere, stream)
        os._exit(int(pytest.main(json.loads(line))))
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


class Bench:
    """A copy of the project in which one mutant at a time is tried."""

    def __init__(self, folder: Path) -> None:
        self.root = folder
        for name in ("cellsys", "tests", "examples", "analysis"):
            shutil.copytree(ROOT / name, folder / name,
                            ignore=shutil.ignore_patterns("__pycache__"))  # fmt: skip
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(ROOT / name, folder / name)
        env = {**os.environ, "PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1",
               "MPLBACKEND": "Agg"}  # fmt: skip
        self.server = subprocess.Popen(
            [sys.executable, "-c", SERVER], cwd=folder, env=env, text=True, bufsize=1,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip

        if self._exit_code(["-x", "-q", "-p", "no:cacheprovider", "tests/worth"]) != 0:
            sys.exit("the copy fails its tests before anything is changed")

    def try_one(self, mutation: Mutation, tests: list[str]) -> bool:
        """Whether a test failed."""
        target = self.root / "cellsys" / mutation.file
        original = target.read_text("utf-8")
        target.write_text(mutated(PACKAGE / mutation.file, mutation.site))
        stale = Path(cache_from_source(str(target)))  # it knows a file by its second and its size
        stale.unlink(missing_ok=True)
        try:
            return self._exit_code(["-x", "-q", "-p", "no:cacheprovider", *tests]) not in (0, 5)
        finally:
            target.write_text(original)
            stale.unlink(missing_ok=True)

    def _exit_code(self, arguments: list[str]) -> int:
        """Of pytest in a child of the server; 1 where it had to be killed."""
        self.server.stdin.write(json.dumps(arguments) + "\n")
        child = int(self.server.stdout.readline())
        late = threading.Timer(MOST, os.killpg, (child, signal.SIGKILL))
        late.start()
        try:
            code = int(self.server.stdout.readline())
        finally:
            late.cancel()
        return 1 if code < 0 else code

    def close(self) -> None:
        """End the server."""
        self.server.stdin.close()
        self.server.wait()


def harmless() -> dict[str, str]:
    """{name of the mutation: why it changes nothing a user could see}."""
    if not HARMLESS.exists():
        return {}
    return {row["mutation"]: row["why"] for row in tomllib.loads(HARMLESS.read_text())["harmless"]}


def run(chosen: list[Mutation], lines: dict, workers: int) -> Iterator[tuple[Mutation, bool]]:
    """Each mutant with whether it was noticed, as they come."""
    with tempfile.TemporaryDirectory() as scratch:
        benches = [Bench(Path(scratch, str(k))) for k in range(workers)]
        free = list(benches)

        def one(mutation: Mutation) -> tuple[Mutation, bool]:
            bench = free.pop()
            try:
                noticed = bench.try_one(mutation, tests_for(mutation, lines))
            finally:
                free.append(bench)
            return mutation, noticed

        try:
            with ThreadPoolExecutor(workers) as pool:
                yield from pool.map(one, chosen)
        finally:
            for bench in benches:
                bench.close()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--room", action="append", default=[], help="only this room (repeatable)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--map", type=Path, default=LINES)
    parser.add_argument("--list", action="store_true", help="only list the mutations")
    options = parser.parse_args()
    chosen = drawn(options.count, options.seed, options.room)
    if options.list:
        for m in chosen:
            print(f"cellsys/{m.file}:{m.line}: {m.before}  ->  {m.after}")
        return 0
    lines, known = line_map(options.map, options.workers), harmless()
    noticed, survivors, excused = 0, [], []
    for k, (m, seen) in enumerate(run(chosen, lines, options.workers), start=1):
        noticed += seen
        if not seen:
            (excused if m.name in known else survivors).append(m)
            where = f"cellsys/{m.file}:{m.line}"
            print(f"[{k}] survives: {where}: {m.before}  ->  {m.after}", flush=True)
    print(f"{len(chosen)} mutations (seed {options.seed}): {noticed} noticed "
          f"({100 * noticed / max(len(chosen), 1):.1f} %), {len(excused)} known to be harmless, "
          f"{len(survivors)} survive")  # fmt: skip
    for m in excused:
        print(f"  harmless: {m.name}\n    {known[m.name]}")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
