"""What the house test looks for in sources, given as file name -> text."""

import ast
import re
from functools import cache

KINDS = ("chain", "disc", "gel")  # of matrices


@cache
def parsed(text: str) -> ast.Module:
    """Tree of a file, which several of the tests walk."""
    return ast.parse(text)


def module_of(name: str) -> str:
    """Module of a file of the package: ``cellsys/a/b.py`` -> ``cellsys.a.b``."""
    return name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def file_imports(sources: dict[str, str]) -> dict[str, set[str]]:
    """Module -> modules of the package that it imports anywhere, under TYPE_CHECKING too."""
    modules = {module_of(name) for name in sources}
    found: dict[str, set[str]] = {}
    for name, text in sources.items():
        here = module_of(name)
        room = here if name.endswith("__init__.py") else here.rpartition(".")[0]
        seen = found.setdefault(here, set())
        for node in ast.walk(parsed(text)):
            if isinstance(node, ast.Import):
                seen |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                base = node.module or ""
                if node.level:
                    above = room.split(".")[: len(room.split(".")) - node.level + 1]
                    base = ".".join([*above, base] if base else above)
                for alias in node.names:
                    full = f"{base}.{alias.name}"
                    seen.add(full if full in modules else base)
        found[here] = (seen & modules) - {here}
    return found


def circles(sources: dict[str, str]) -> list[set[str]]:
    """Sets of files that import each other, directly or on the way."""
    imports = file_imports(sources)
    reach = {name: set(seen) for name, seen in imports.items()}
    grown = True
    while grown:
        grown = False
        for seen in reach.values():
            more = set().union(*(reach[n] for n in seen)) - seen if seen else set()
            seen |= more
            grown = grown or bool(more)
    groups = {frozenset(n for n in reach[m] if m in reach[n]) for m in reach if m in reach[m]}
    return [set(group) for group in groups]


def repeated_classes(sources: dict[str, str]) -> dict[str, list[str]]:
    """Class name -> files, of names that are defined more than once."""
    places: dict[str, list[str]] = {}
    for name, text in sources.items():
        for node in ast.walk(parsed(text)):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(name)
    return {name: files for name, files in places.items() if len(files) > 1}


def foreign_privates(sources: dict[str, str]) -> list[str]:
    """``file: name`` of underscored names that a file takes from another file of the package."""
    modules = {module_of(name) for name in sources}
    wrong = []
    for name, text in sources.items():
        tree, bound = parsed(text), set()
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (
                node.level or (node.module or "").split(".")[0] == "cellsys"
            ):
                for alias in node.names:
                    if alias.name.startswith("_") and not alias.name.startswith("__"):
                        wrong.append(f"{name}: {alias.name}")
                    if node.level or f"{node.module}.{alias.name}" in modules:
                        bound.add(alias.asname or alias.name)
            elif isinstance(node, ast.Import):
                bound |= {a.asname for a in node.names if a.asname and a.name in modules}
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                hidden = node.attr.startswith("_") and not node.attr.startswith("__")
                if hidden and node.value.id in bound:
                    wrong.append(f"{name}: {node.value.id}.{node.attr}")
    return wrong


def contract_members(text: str) -> set[str]:
    """Methods and attributes that the Protocols of a file ask for."""
    names = set()
    for node in parsed(text).body:
        if isinstance(node, ast.ClassDef) and any("Protocol" in ast.unparse(b) for b in node.bases):
            for item in node.body:
                if isinstance(item, ast.FunctionDef):
                    names.add(item.name)
                elif isinstance(item, ast.AnnAssign):
                    names.add(ast.unparse(item.target))
    return names


def sniffed(sources: dict[str, str], members: set[str]) -> set[tuple[str, str]]:
    """(file, member) of every ``hasattr`` that asks for a member of a contract."""
    return {
        (name, node.args[1].value)
        for name, text in sources.items()
        for node in ast.walk(parsed(text))
        if isinstance(node, ast.Call)
        and ast.unparse(node.func) in ("hasattr", "builtins.hasattr")
        and isinstance(node.args[1], ast.Constant)
        and node.args[1].value in members
    }


def told_apart(sources: dict[str, str]) -> list[str]:
    """``file:line`` where code asks of which kind a matrix is: by its class or by its name."""
    wrong = []
    for name, text in sources.items():
        for node in ast.walk(parsed(text)):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance":
                asked = ast.unparse(node.args[1])
                found = any(cls in asked for cls in ("ChainScene", "MatrixScene", "Plane"))
            elif isinstance(node, ast.Compare):
                sides = (node.left, *node.comparators)
                found = any(isinstance(s, ast.Constant) and s.value in KINDS for s in sides)
            else:
                continue
            if found:
                wrong.append(f"{name}:{node.lineno}")
    return wrong


def never_raised(errors: str, sources: dict[str, str]) -> set[str]:
    """Exceptions of a file that no code makes or hands on to be raised."""
    defined = {n.name for n in ast.parse(errors).body if isinstance(n, ast.ClassDef)}
    used = set()
    for text in sources.values():
        for node in ast.walk(parsed(text)):
            if isinstance(node, ast.Call):
                given = [node.func, *node.args, *(k.value for k in node.keywords)]
            elif isinstance(node, ast.Raise):
                given = [node.exc]
            else:
                continue
            used |= {value.id for value in given if isinstance(value, ast.Name)}
    return defined - used


def crowded(sources: dict[str, str], most: int) -> dict[str, int]:
    """Lines of every room (a folder of the package with all below it) that holds over `most`."""
    lines: dict[str, int] = {}
    for name, text in sources.items():
        room = "/".join(name.split("/")[:2])
        lines[room] = lines.get(room, 0) + text.count("\n")
    return {folder: n for folder, n in lines.items() if n > most}


def by_position(sources: dict[str, str], most: int) -> list[str]:
    """Dataclasses of more than `most` fields that take more than `most` of them by position."""
    wrong = []
    for name, text in sources.items():
        for node in ast.walk(parsed(text)):
            if not isinstance(node, ast.ClassDef):
                continue
            made = [ast.unparse(d) for d in node.decorator_list if "dataclass" in ast.unparse(d)]
            given = [s for s in node.body if isinstance(s, ast.AnnAssign)]
            kinds = [ast.unparse(s.annotation) for s in given]
            stop = kinds.index("KW_ONLY") if "KW_ONLY" in kinds else len(given)
            taken = [
                s
                for s, kind in zip(given[:stop], kinds, strict=False)
                if not kind.startswith("ClassVar")
                and (
                    s.value is None
                    or not re.search("kw_only=True|init=False", ast.unparse(s.value))
                )
            ]
            if made and "kw_only=True" not in made[0] and len(taken) > most:
                wrong.append(f"{name}: {node.name} takes {len(taken)}")
    return wrong
