"""What a scene does not name does not exist: no call, no state, no column, no import, no bit.

"Its file does not exist" is taken literally: a copy of the package with the file deleted (for
effects that share a file, with the class cut out) runs the same scene, and the bytes are compared.
"""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cellsys
from cellsys.effects.protocol import Element
from cellsys.integrate import LinearlyImplicit, simulate
from cellsys.scene import Scene, build
from cellsys.scene.registry import EFFECTS, LISTED
from tests.mechanics.small_scenes import closed, tiny, tiny_system

PACKAGE = Path(cellsys.__file__).parent
T = np.arange(0.0, 11.0, 5.0)
STANDARD = (
    "membrane_elasticity", "volume", "cortical_tension", "focal_adhesion", "lamellipodium",
    "substrate_contact", "foundation", "polarity",
)  # fmt: skip
# Scenes that together hold every effect, each without its contradictions.
WHOLE = [
    (*STANDARD, "external_load", "external_strain", "fibre_bending", "matrix_creep", "nucleus",
     "stress_fibres", "cell_contact", "matrix_degradation", "noise", "matrix_contact"),
    ("membrane_elasticity", "volume", "cortex", "stochastic_adhesion", "lamellipodium",
     "substrate_contact", "foundation", "polarity"),
]  # fmt: skip


def run(system, **options):
    return simulate(system, LinearlyImplicit(step=0.5), T, seed=2, **options)


def rest_of(name):
    """Effects that go with `name` in one of the whole scenes and do not need it.

    Stress fibres end at a nucleus where there is one: they are left out beside it.
    """
    scene = next(s for s in WHOLE if name in closed(*s))
    gone = {"drag", "stress_fibres" if name == "nucleus" else "drag"}
    return [n for n in closed(*scene) if name not in closed(n) and n not in gone]


def methods_of(kinds):
    for kind in kinds:
        for owner in kind.__mro__:
            if owner is Element or not issubclass(owner, Element):
                break
            for name, value in list(vars(owner).items()):
                if callable(value) and not name.startswith("__"):
                    yield owner, name, value


@pytest.mark.parametrize("name", [n for n in EFFECTS if n != "drag"])
def test_an_absent_effect_is_never_called_and_leaves_no_trace(name, monkeypatch):
    """Calls are counted in every method of the effect's elements, with it and without it."""
    rest = rest_of(name)
    full, bare = tiny_system(*rest, name), tiny_system(*rest)
    shared = {type(e) for e in bare.elements}
    kinds = {type(e) for e in full.elements} - shared
    if name in ("stiffness_sensing", "polarity"):
        pytest.skip("parameters of the polarity that a lamellipodium has anyway; tested below")
    assert kinds, "nothing was built"
    calls = []
    for owner, method, value in methods_of(kinds):
        if any(issubclass(kind, owner) for kind in shared):
            continue
        monkeypatch.setattr(owner, method, lambda *a, value=value: calls.append(value) or value(*a))
    run(bare)
    assert not calls
    run(full)
    assert calls
    own = {p.block for e in full.elements if type(e) in kinds for p in e.ports}
    own |= {b.name for e in full.elements if type(e) in kinds for b in e.internal}
    own |= {b + ".rate" for b in own}
    brought = {a.name for a in full.arrays} - {a.name for a in bare.arrays}
    for with_it, without_it in (
        (full.states, bare.states),
        (full.auxiliaries, bare.auxiliaries),
        (full.inputs, bare.inputs),
    ):
        left = [b for b in with_it if b.name not in own]
        left = [b for b in left if not b.name.startswith(tuple(f"{a}." for a in brought))]
        if name == "lamellipodium":
            left = [b for b in left if not b.name.endswith(("heading", "amplitude"))]
        assert left == list(without_it)
    assert bare.W_eta.shape == (bare.states.size, bare.auxiliaries.size)


def test_a_polarity_without_a_sensor_senses_nothing(monkeypatch):
    from cellsys.effects import steering

    def refuse(*arguments):
        raise RuntimeError("the law of an absent effect was called")

    for law in ("stiffest_direction", "stress_direction", "exact_step", "rate"):
        monkeypatch.setattr(steering, law, refuse)
    run(tiny_system("lamellipodium", "membrane_elasticity"))
    with pytest.raises(RuntimeError, match="absent effect"):
        run(tiny_system("lamellipodium", "polarity"))
    monkeypatch.undo()
    monkeypatch.setattr(steering, "exact_step", refuse)
    run(tiny_system("lamellipodium", "stiffness_sensing"))


def test_only_the_files_of_named_effects_are_imported():
    """One process names one more effect at a time; its file appears then and not before.

    The file of the drag, which every scene has, is the exception.
    """
    alone = [n for n in LISTED if _own_file(n)]
    code = [
        "import sys",
        "from tests.mechanics.small_scenes import tiny_system",
        "def there(file): return 'cellsys.effects.' + file in sys.modules",
        "import cellsys, cellsys.scene",
        *(f"assert not there({_file(n)!r}), {n!r}" for n in LISTED if _file(n) != "matrix"),
        "tiny_system('membrane_elasticity', matrix=False)",
        "assert not there('steering') and not there('adhesion')",
        "tiny_system('lamellipodium', 'focal_adhesion')",
        "assert there('clutch') and not there('switching')",
    ]
    for k, name in enumerate(alone):
        if name == "focal_adhesion":
            continue
        code.append(f"tiny_system({name!r})")
        code.append(f"assert there({_file(name)!r})")
        code += [
            f"assert not there({_file(later)!r}), {(name, later)!r}"
            for later in alone[k + 1 :]
            if later != "focal_adhesion"
        ]
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(code)], cwd=PACKAGE.parent, capture_output=True,
        text=True, check=False, env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def _file(name):
    return LISTED[name].partition(":")[0]


def _own_file(name):
    return sum(path.partition(":")[0] == _file(name) for path in LISTED.values()) == 1


RUN = """
import hashlib, sys
import numpy as np
import cellsys
from cellsys.integrate import LinearlyImplicit, simulate
from cellsys.scene import Scene, build
assert cellsys.__file__.startswith(sys.argv[1]), cellsys.__file__
for table in {tables!r}:
    run = simulate(build(Scene.parse(table)), LinearlyImplicit(step=0.5), {times!r}, seed=2)
    parts = [a for a in (run.x, run.eta, run.u, run.p, run.d) if a is not None]
    print(hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in parts)).hexdigest())
"""


def hashes(folder, tables):
    code = RUN.format(tables=tables, times=T.tolist())
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder)], cwd=folder, capture_output=True, text=True,
        check=False, env={**os.environ, "PYTHONPATH": str(folder)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def package_without(folder, names):
    """A copy of the package in which the files of these effects do not exist."""
    # With the compiled loops beside their files: the copies have the same times.
    shutil.copytree(PACKAGE, folder / "cellsys")
    for name in names:
        path = folder / "cellsys" / "effects" / f"{_file(name)}.py"
        if _own_file(name):
            path.unlink()
            continue
        kind = LISTED[name].partition(":")[2]
        tree = ast.parse(path.read_text())
        (node,) = [n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == kind]
        lines = path.read_text().splitlines(keepends=True)
        first = node.decorator_list[0].lineno - 1
        path.write_text("".join(lines[:first] + lines[node.end_lineno :]))
    return folder


@pytest.mark.slow
def test_a_build_without_the_files_of_absent_effects_gives_the_same_bits(tmp_path):
    """The standard scene, with all files of effects it does not name taken out of the package."""
    tables = [tiny(*STANDARD)]
    absent = [n for n in LISTED if n not in closed(*STANDARD) and _own_file(n)]
    assert len(absent) == 12
    package_without(tmp_path, absent)
    assert hashes(tmp_path, tables) == hashes(PACKAGE.parent, tables)
    code = (
        "import cellsys as cs\n"
        f"try: cs.Scene.parse({tiny('nucleus')!r})\n"
        "except cs.SceneError as error: print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert "unknown key 'effects.nucleus'" in done.stdout


@pytest.fixture(scope="module")
def whole_build():
    """What the whole package gives for the scene without each effect; one process for all."""
    names = [n for n in LISTED if n != "drag"]
    found = hashes(PACKAGE.parent, [tiny(*rest_of(n)) for n in names])
    return dict(zip(names, found, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in LISTED if n != "drag"])
def test_a_build_without_one_effect_gives_the_same_bits_as_a_scene_without_it(
    name, whole_build, tmp_path
):
    (found,) = hashes(package_without(tmp_path, [name]), [tiny(*rest_of(name))])
    assert found == whole_build[name]


ZERO = {
    "membrane_elasticity": {"line": "0 pN/um", "area": "0 pN/um"},
    "volume": {"modulus": "0 Pa", "pressure": "zero"},
    "cortical_tension": {"tension": "0 pN/um"},
    "focal_adhesion": {"stiffness": "0 pN/um", "zipper": "0 pN/um"},
    "lamellipodium": {"force": "0 pN"},
    "substrate_contact": {"stiffness": "0 pN/um"},
    "foundation": {"spring": "0 pN/um"},
    "external_load": {"force": "0 pN"},
    "polarity": {"kappa": "0 1/s"},
    "external_strain": {"strain": 0},
    "fibre_bending": {"rigidity": "0 pN um^2"},
    "matrix_creep": {"ratio": 0},
    "nucleus": {"filament": "0 pN/um", "line": "0 pN/um", "area": "0 pN/um", "modulus": "0 Pa"},
    "stochastic_adhesion": {"bind_rate": "0 1/s"},
    "stress_fibres": {"tension": "0 pN"},
    "cell_contact": {"stiffness": "0 pN/um"},
    "matrix_contact": {"stiffness": "0 pN/um"},
    "matrix_degradation": {"rate": "0 1/s"},
    "noise": {"temperature": "0 K"},
}
# A sensor has no coefficient, a cortex takes over a drag (below), and EA of the matrix is > 0.
WITHOUT_ZERO = {"drag", "matrix_elasticity", "stiffness_sensing", "cortex"}


@pytest.mark.parametrize("name", ZERO)
def test_an_absent_effect_equals_one_with_coefficient_zero(name):
    """To 1e-10 um: the tangent's bound may be put together in another order, not more."""
    rest = [n for n in rest_of(name) if n != "noise"]
    # A start at rest is found to rounding with one more array to move (4e-13 um), and rounding
    # then decides when a factor is made again: 0.3 nm, what a step is worth.
    sphere = {"volume": {"pressure": "zero"}} if name == "nucleus" else {}
    bare = run(build(Scene.parse(tiny(*rest, **sphere))))
    zero = run(build(Scene.parse(tiny(*rest, name, **sphere, **{name: ZERO[name]}))))
    for block in bare.states:
        assert np.abs(bare.block(block.name) - zero.block(block.name)).max() < 1e-10, block.name


def test_every_effect_has_a_zero_or_a_reason():
    assert set(ZERO) | WITHOUT_ZERO == set(LISTED)


def test_a_cortex_without_tension_is_a_membrane_without_cortical_drag():
    rest = [n for n in rest_of("cortex") if n != "cortical_tension"]
    drag = {"drag": {"cortex": "0 pN s/um"}}
    bare = run(build(Scene.parse(tiny(*rest, **drag))))
    zero = run(build(Scene.parse(tiny(*rest, "cortex", cortex={"tension": "0 pN/um"}))))
    for block in bare.states:
        assert np.abs(bare.block(block.name) - zero.block(block.name)).max() < 1e-10, block.name


def test_nodes_at_rest_ask_for_no_further_corrections():
    """A matrix that nothing pulls on leaves rounding over; dropping an adhesion costs nothing."""
    still = run(tiny_system("matrix_elasticity", "membrane_elasticity", "lamellipodium"))
    assert still.statistics["rhs"] <= still.statistics["steps"] + 3
