"""Kinds of matrix of one's own: a sheet under cells, a network that is the disc's, and a bead."""

import json
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import cellsys as cs
from cellsys.contracts import MatrixKind, needs
from cellsys.effects import parameter
from cellsys.errors import ParameterError, SceneError
from cellsys.geometry.disc import Disc, connect
from cellsys.scene import CellScene, ChainScene, MatrixScene, Plane, Scene
from cellsys.scene.ensemble import read_run
from cellsys.scene.load import scene_from_plain
from cellsys.scene.plane import NO_MATRIX
from cellsys.study.fields import draw_displacement
from cellsys.system import Block, Layout, OdeSystem
from tests.mechanics.scenes import TABLE as DISC


@dataclass(frozen=True)
class Sheet(Plane):
    """A square sheet of fibres, held along its four sides."""

    kind: ClassVar[str] = "sheet"
    width: float = parameter("36 um", "um", above=0, source="test", about="length of a side")
    tension: float = parameter("900 pN", "pN", above=0, source="test", about="EA of a fibre")

    @property
    def node_count(self):
        """Two layers of a square lattice 2 um wide."""
        return 2 * (int(self.width / 2.0) + 1) ** 2

    @property
    def reach(self):
        """Half the side."""
        return 0.5 * self.width

    def outside(self, cell):
        """Beyond a side."""
        if np.abs(cell.position).max() + cell.radius <= self.reach:
            return None
        return f"reaches over a side of the sheet of {self.width:g} um; move it"

    def network(self, seed):
        """A lattice that is shaken, so that no two fibres are parallel."""
        side = np.linspace(-self.reach, self.reach, int(self.width / 2.0) + 1)
        x = np.array([(a, b, z) for z in (-0.2, -1.4) for a in side for b in side])
        held = np.abs(x[:, :2]).max(axis=1) > self.reach - 1e-9
        shake = np.random.default_rng(seed).uniform(-0.3, 0.3, x.shape) * [1, 1, 0.5]
        x = x + np.where(held[:, None], 0.0, shake)
        fibres = connect(x, 9.0)
        length = np.linalg.norm(x[fibres[:, 1]] - x[fibres[:, 0]], axis=1)
        top = np.flatnonzero((x[:, 2] > -0.7) & ~held)
        return Disc(
            radius=2**0.5 * self.reach,
            thickness=1.4,
            position=x,
            fibres=fibres,
            length=length,
            stiffness=self.tension / length,
            clamped=held,
            surface=top,
        )


@dataclass(frozen=True)
class Coin(Plane):
    """The network of the disc under another name."""

    kind: ClassVar[str] = "coin"
    diameter: float = parameter("20 um", "um", above=0, source="test", about="width")

    def network(self, seed):
        """That of `MatrixScene`."""
        return MatrixScene(diameter=self.diameter).network(seed)


@dataclass(frozen=True)
class Bead:
    """Satisfies the contract and derives from nothing: a bead in a trap, x' = -rate x."""

    kind: ClassVar[str] = "bead"
    title: ClassVar[str] = "a bead in a trap"
    rate: float = parameter("0.5 1/s", "1/s", above=0, source="test", about="stiffness / drag")

    def build(self, scene):
        states = Layout([Block("bead", (1,), "um")])
        return OdeSystem(states=states, x0=np.ones(1), W_x=-self.rate * np.eye(1))

    def place_cells(self, scene):
        if scene.cells:
            raise SceneError(f"cells[0] has no place beside a bead, got {len(scene.cells)} cells")

    def start_elsewhere(self, scene, rng):
        return scene.cells

    def train(self, scene):
        return [scene], [scene]

    def turn(self, scene, n, *, seed, loaded, scatter, label):
        return [scene] * n

    def draw(self, run, ax=None, *, k=-1):
        ax.plot(run.t, run.block("bead"))
        return ax

    def refuse(self, scene, use="run"):
        if use == "step":
            raise SceneError("a bead is run at 1e-9; leave the error out")

    def method(self, scene):
        return cs.DOP853(rtol=1e-9, atol=1e-12)

    def memory(self, scene, *, on_disk=True, run=True):
        return 3e8, 3e8, 8.0 * len(scene.times)

    def words(self, scene):
        return "a bead", "take none"


KINDS = [Sheet, Coin, Bead]


def table(matrix, cells=((0.0, 0.0),), seconds=5, step=0.5):
    """A scene of small cells with that matrix, for a few seconds."""
    return {
        **{k: v for k, v in DISC.items() if k not in ("matrix", "cells", "training")},
        "duration": f"{seconds} s",
        "sample": "1 s",
        "step": f"{step} s",
        "matrix": matrix,
        "cells": [{"position": [f"{x} um", f"{y} um"], "radius": "4 um"} for x, y in cells],
    }


@pytest.mark.parametrize("matrix", [MatrixScene(), ChainScene(), NO_MATRIX, *(k() for k in KINDS)])
def test_all_kinds_keep_the_contract(matrix):
    needs(matrix, MatrixKind, "matrix")


def test_another_name_for_the_disc_gives_its_run_to_the_last_digit():
    runs = [
        cs.run_scene(Scene.parse(table({"kind": kind, "diameter": "20 um"}), matrices=KINDS))
        for kind in ("disc", "coin")
    ]
    for name in ("x", "eta"):
        assert np.array_equal(*(getattr(run, name) for run in runs))


def test_a_sheet_holds_cells_in_its_corners_where_a_disc_has_none(tmp_path):
    corner = (13.5, 13.5)
    scene = Scene.parse(table({"kind": "sheet"}, [corner]), matrices=KINDS)
    # naive: the rule of a disc of that width for every matrix
    with pytest.raises(SceneError, match="outside the disc"):
        Scene.parse(table({"kind": "disc", "diameter": "36 um"}, [corner]))
    with pytest.raises(SceneError, match=r"cells\[1\] reaches over a side of the sheet of 36 um"):
        Scene.parse(table({"kind": "sheet"}, [(0, 0), (15, 0)]), matrices=KINDS)
    with pytest.raises(SceneError, match="overlap"):
        Scene.parse(table({"kind": "sheet"}, [(0, 0), (5, 0)]), matrices=KINDS)
    system = cs.build(scene)
    assert len(system.matrix.position) == scene.matrix.node_count
    run = cs.run_scene(scene)
    assert draw_displacement(run, scene.matrix, tmp_path / "u.png").stat().st_size > 5000
    u = run.block("matrix.displacement")[-1]
    assert np.array_equal(u[system.matrix.clamped], np.zeros((system.matrix.clamped.sum(), 3)))
    moved = np.linalg.norm(u, axis=1)
    near = np.linalg.norm(system.matrix.position[:, :2] - corner, axis=1) < 6.0
    # What is pulled on is what lies under the cell; elasticity carries it on, getting smaller.
    assert moved[near].max() > 2.0 * moved[~near].max() > 0.0


def test_units_bounds_and_names_of_parameters_are_held():
    scene = Scene.parse(table({"kind": "sheet", "width": "0.05 mm"}), matrices=KINDS)
    assert scene.matrix == Sheet(width=50.0)
    for given, words in (
        ({"width": "-1 um"}, "Sheet.width must be > 0 um"),
        ({"width": "5 kPa"}, "wrong dimension"),
        ({"widht": "5 um"}, "did you mean 'width'"),
        ({"spacing": "1 um"}, "belongs to matrix.kind = 'chain', not to 'sheet'"),
    ):
        with pytest.raises(SceneError, match=words):
            Scene.parse(table({"kind": "sheet", **given}), matrices=KINDS)
    with pytest.raises(SceneError, match=r"must be 'disc', 'gel' or 'chain' \(got 'sheet'\)"):
        Scene.parse(table({"kind": "sheet"}))
    with pytest.raises(SceneError, match=r"'chain', 'sheet', 'coin' or 'bead' \(got 'gell'\)"):
        Scene.parse(table({"kind": "gell"}), matrices=KINDS)


def test_an_effect_says_itself_where_it_has_no_meaning(monkeypatch):
    drag = cs.Scene.parse(table({"kind": "sheet"}), matrices=KINDS).effects["drag"]
    monkeypatch.setattr(type(drag), "not_on", {"sheet": "a dry sheet"})
    Scene.parse(table({"kind": "disc"}))
    with pytest.raises(SceneError, match=r"effects.drag has no meaning .* 'sheet': a dry sheet"):
        Scene.parse(table({"kind": "sheet"}), matrices=KINDS)


def test_what_is_no_kind_of_matrix_is_told_what_it_lacks():
    @dataclass(frozen=True)
    class Half:
        kind: ClassVar[str] = "half"

        def build(self, scene):
            """Alone."""

    with pytest.raises(SceneError, match=r"Half.* no title, place_cells, start_elsewhere, train"):
        Scene.parse(table({"kind": "half"}), matrices=[Half])
    with pytest.raises(ParameterError, match="matrix"):
        Scene(name="x", duration=1.0, sample=1.0, effects={}, matrix=Half())
    with pytest.raises(SceneError, match="not a dataclass"):
        Scene.parse(table({"kind": "half"}), matrices=[Plane])
    with pytest.raises(SceneError, match="'disc' already"):
        Scene.parse(table({"kind": "disc"}), matrices=[type("D", (Sheet,), {"kind": "disc"})])
    with pytest.raises(SceneError, match="kind of its own"):
        Scene.parse(table({"kind": "disc"}), matrices=[type("D", (Sheet,), {})])


def test_a_bead_is_run_kept_and_read_back_and_the_fingerprint_knows_its_law(tmp_path):
    spec = {"name": "b", "duration": "4 s", "sample": "1 s", "matrix": {"kind": "bead"}}
    scene = Scene.parse(spec, matrices=KINDS)
    run = cs.run_scene(scene, tmp_path)
    # 1e-8: ten times the method's own tolerance.
    assert np.allclose(run.x[:, 0], np.exp(-0.5 * run.t), rtol=1e-8)
    plain = json.loads(json.dumps(scene.canonical()))
    assert scene_from_plain(plain, matrices=KINDS) == scene
    assert "a bead in a trap" in repr(scene)
    assert plain["matrix"]["kind"] == "bead"
    assert plain["matrix"]["origin"].startswith("Bead ")
    with pytest.raises(ParameterError, match=r"'bead' is of a script .* matrices="):
        scene_from_plain(plain)
    with pytest.raises(cs.FileFormatError, match="matrices="):
        read_run(next(p for p in tmp_path.iterdir() if p.is_dir()))
    with pytest.raises(SceneError, match="no place beside a bead"):
        Scene(name="x", duration=4.0, sample=1.0, effects={}, cells=(CellScene(),), matrix=Bead())
    assert "origin" not in Scene.parse(DISC).canonical()["matrix"]
    assert cs.training_scenes(scene) == ([scene], [scene])
    with pytest.raises(SceneError, match="leave the error out"):
        scene.matrix_kind.refuse(scene, "step")


@pytest.mark.slow
def test_a_study_of_a_sheet_draws_its_field(tmp_path):
    scene = Scene.parse(table({"kind": "sheet"}, [(-9, 0), (9, 0)], seconds=2), matrices=KINDS)
    result = cs.study(scene, out=tmp_path, workers=1)
    assert (tmp_path / "figures" / "displacement_field.png").stat().st_size > 5000
    assert "sheet" not in result.summary  # the summary is that of every matrix under cells


def test_the_schema_and_other_packages(monkeypatch):
    class Point:
        name, value = "sheet", "pack:Sheet"

        def __lt__(self, other):
            return False

        def load(self):
            return Sheet

    text = json.dumps(cs.scene_schema(matrices=[Sheet]))
    assert "length of a side [um] (test)" in text
    assert '"const": "sheet"' in text
    assert "length of a side" not in json.dumps(cs.scene_schema())
    monkeypatch.setattr("cellsys.scene.forms.entry_points", lambda group: [Point()])
    assert Scene.parse(table({"kind": "sheet"})).matrix == Sheet()
    assert "length of a side" in json.dumps(cs.scene_schema())
