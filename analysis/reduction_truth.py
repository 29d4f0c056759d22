"""How far can a reduced cell be trusted? Every number beside its floors and baselines.

    python analysis/reduction_truth.py [--quick] [--out DIR]

Homogeneous disc of the shipped parameters, runs from the sphere with turning headings, varying
amplitudes and loads on the matrix; held-out runs have other seeds, headings and places. With --out
runs are kept in DIR, so that a second call only fits. Prints, for held-out roll-outs with the
commands as only input: errors by order beside projection floor and baselines, one-step against
roll-out training, what contraction costs and buys, one constant-heading run for all headings, the
realisation floor, the start shifted by 5 and 100 nm, coverage of the error bands, the cell closed
with its field.
"""

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np

import cellsys as cs
from cellsys.cell.forecast import conformal_bands, residuals
from cellsys.cell.records import read_records, sites_of
from cellsys.cell.worth import Baselines, measure, relative, roll_record

SCENE = Path(__file__).parents[1] / "examples" / "spreading.toml"


def homogeneous(quick: bool) -> cs.Scene:
    """The shipped scene without its inclusion, the cell in the middle."""
    scene = cs.load_scene(SCENE)
    plan = dataclasses.replace(scene.training, duration=150.0 if quick else 1500.0)
    matrix = dataclasses.replace(scene.matrix, inclusion=None)
    if quick:
        matrix = dataclasses.replace(matrix, diameter=46.0, nodes=420)
    cell = dataclasses.replace(scene.cells[0], position=(0.0, 0.0))
    return dataclasses.replace(scene, matrix=matrix, cells=(cell,), training=plan)


def moved(scene: cs.Scene, shift: tuple[float, float], turn: float = 0.0) -> cs.Scene:
    """The same commands turned by `turn` rad, the cell `shift` um away."""
    (cell,) = scene.cells
    heading = cell.commands.heading
    turned = dataclasses.replace(heading, values=tuple(v + turn for v in heading.values))
    commands = dataclasses.replace(cell.commands, heading=turned)
    place = (cell.position[0] + shift[0], cell.position[1] + shift[1])
    cell = dataclasses.replace(
        cell, position=place, polarity=cell.polarity + turn, commands=commands
    )
    return dataclasses.replace(scene, cells=(cell,))


def constant(scene: cs.Scene, n: int, seed: int) -> list[cs.Scene]:
    """Runs with one heading each, at random places."""
    rng = np.random.default_rng(seed)
    out = []
    for start in cs.turning_scenes(scene, n, seed=seed, scatter=3.0):
        (cell,) = start.cells
        heading = dataclasses.replace(
            cell.commands.heading, times=(0.0,), values=(float(rng.uniform(0, 2 * np.pi)),)
        )
        commands = dataclasses.replace(cell.commands, heading=heading, amplitude=None)
        cell = dataclasses.replace(cell, polarity=heading.values[0], commands=commands)
        out.append(dataclasses.replace(start, cells=(cell,)))
    return out


def plan(quick: bool) -> dict[str, list[cs.Scene]]:
    """All scenes by what they are for."""
    scene = homogeneous(quick)
    few, some, many = (3, 2, 1) if quick else (11, 11, 10)
    tests = cs.turning_scenes(scene, 2 if quick else 8, seed=72, scatter=3.0)
    rng = np.random.default_rng(5)
    pairs = [
        moved(s, tuple(rng.uniform(-3, 3, 2)), float(rng.uniform(0, 2 * np.pi)))
        for s in tests[: 1 if quick else 6]
    ]
    return {
        "turning": cs.turning_scenes(scene, few, seed=71, scatter=3.0),
        "more": cs.turning_scenes(scene, some, seed=171, scatter=3.0),
        "loaded": cs.turning_scenes(scene, many, seed=71, loaded=True, scatter=3.0),
        "test": tests,
        "elsewhere": pairs,
        "5 nm": [moved(tests[0], (0.005, 0.0))],
        "100 nm": [moved(tests[0], (0.1, 0.0))],
        "constant": constant(scene, 1, 73),
        "constant test": constant(scene, 2 if quick else 6, 74),
    }


class Data:
    """Runs, snapshots and records of every set."""

    def __init__(self, quick: bool, folder: Path) -> None:
        self.scenes = plan(quick)
        every = [s for scenes in self.scenes.values() for s in scenes]
        runs = cs.run_ensemble(every, folder, progress=None)
        self.runs, at = {}, 0
        for name, scenes in self.scenes.items():
            self.runs[name], at = runs[at : at + len(scenes)], at + len(scenes)
        self.step = cs.Equivariant().step
        self.records = {n: self.read(n) for n in self.runs}

    def snapshots(self, *names: str) -> cs.Snapshots:
        """Snapshots of the runs of some sets."""
        return cs.snapshots([r for n in names for r in self.runs[n]])

    def read(self, name: str) -> list:
        """Records of a set."""
        return read_records(self.snapshots(name), self.step, cs.PolarPort())

    def fit(self, method: cs.Equivariant, order: int, *names: str) -> cs.EquivariantModel:
        """A model from the runs of some sets."""
        data = self.snapshots(*names)
        records = [
            dataclasses.replace(r, run=k)
            for k, r in enumerate(r for n in names for r in self.records[n])
        ]
        return method.fit_records(records, data, order, sites_of(data))

    def errors(self, model: cs.EquivariantModel, known: tuple[str, ...], on: str = "test") -> dict:
        """Rows of the card on a set, baselines learned from `known`."""
        base = Baselines(tuple(r for n in known for r in self.records[n]), model)
        return measure(model, self.records[on], base)


def line(name: str, rows: dict) -> str:
    """One line of errors."""
    cells = rows["cells"]
    return (
        f"{name:44s} rc {cells['model']:.3f} (sd over runs {cells['spread over runs']:.3f}, floor "
        f"{cells['floor']:.3f}), shape {rows['shape']['model']:.3f}, centroid "
        f"{rows['centroid']['model']:.3f}, loads {rows['loads']['model']:.2f}"
    )


def main(quick: bool = False, out: str | None = None) -> None:
    if out is None:
        with tempfile.TemporaryDirectory() as scratch:
            return main(quick, scratch)
    data = Data(quick, Path(out) / "runs")
    small, large = ("turning",), ("turning", "more", "loaded")
    orders = (8, 16) if quick else (10, 20, 50, 100, 200)
    quickly = {"iterations": 30} if quick else {}

    print("training on", ", ".join(f"{len(data.runs[n])} {n}" for n in large), "runs; held out:",
          len(data.runs["test"]))  # fmt: skip
    models = {}
    for names in (small, large):
        n = sum(len(data.runs[name]) for name in names)
        for order in orders:
            model = models[names, order] = data.fit(cs.Equivariant(**quickly), order, *names)
            rows = data.errors(model, names)
            print(line(f"Equivariant, {n} runs, m = {order}", rows)
                  + f", fit {model.notes['fit_seconds']:.1f} s")  # fmt: skip
    top = orders[-2] if len(orders) > 2 else orders[-1]
    model = models[large, top]
    rows = data.errors(model, small)
    print("\nbaselines (learned from the turning runs), rc:", ", ".join(
        f"{k} {v:.3f}" for k, v in rows["cells"].items()
        if k in ("nothing moves", "mean velocity", "mean motion", "nearest run",
                 "linear in polarity", "body-frame mean")))  # fmt: skip
    body = rows["cells"]["body-frame mean"]
    print(
        f"m = {top}: {rows['cells']['model'] / body:.2f} of the body-frame mean's error, better on "
        f"{100 * rows['cells']['runs better than body-frame mean']:.0f} % of the runs"
    )
    pairs = list(zip(data.records["test"], data.records["elsewhere"], strict=False))
    floor = cs.realisation_floor(model, pairs)
    print(
        f"realisation floor: cells {floor['cells']:.3f}, loads {floor['loads']:.2f}; the model's "
        f"error is {rows['cells']['model'] / floor['cells']:.2f} times the floor"
    )
    for name in ("5 nm", "100 nm"):
        a, b = data.records["test"][0].nodes, data.records[name][0].nodes
        print(f"start shifted by {name}: rc {relative(b - a, a):.5f}")

    print("\nwhat the pieces are worth (turning runs only)")
    base = cs.Equivariant(**quickly)
    for label, method in (
        ("roll-out loss, contractive (default)", base),
        ("one-step loss, contractive", dataclasses.replace(base, iterations=0)),
        ("roll-out loss, unconstrained", dataclasses.replace(base, margin=None)),
        ("one-step loss, unconstrained", dataclasses.replace(base, iterations=0, margin=None)),
        ("time-invariant", dataclasses.replace(base, clock=cs.Clock(vertices=1))),
    ):
        with np.errstate(over="ignore", invalid="ignore"):
            fitted = data.fit(method, top, *small)
            print(line(label, data.errors(fitted, small)))
        steps = 2000 if quick else 100_000
        with np.errstate(over="ignore", invalid="ignore"):
            z = fitted.simulate_commands(fitted.z_start, np.ones(steps), np.zeros(steps))
            sizes = [np.abs(x).max(initial=0.0) for x in fitted.dynamics.split(z[-1:]).x]
        print(
            f"{'':44s} norm {fitted.dynamics.norm():.6f}, after {10 * steps:.0e} s the states "
            f"reach {max(sizes):.3g}"
        )

    one = data.fit(cs.Equivariant(**quickly), orders[-3] if len(orders) > 2 else orders[0],
                   "constant")  # fmt: skip
    print(
        "\n"
        + line(
            f"ONE constant-heading run, m = {one.order}: any heading",
            data.errors(one, ("constant",), "constant test"),
        )
    )

    if len(data.runs["turning"]) >= 3:
        snapshots = data.snapshots(*small)
        kept = data.records["turning"]
        method = dataclasses.replace(base, folds=3 if quick else base.folds)
        misses, _ = method.left_out(kept, snapshots, top, sites_of(snapshots))
        bands = conformal_bands(misses, data.step, method.folds)
        fitted = models[small, top]
        held = [residuals(fitted, r, roll_record(fitted, r)) for r in data.records["test"]]
        for level in bands.levels:
            found = bands.coverage(held, level)
            print(f"{100 * level:g} % band covers", ", ".join(
                f"{k} {100 * v:.1f} %" for k, v in found.items()))  # fmt: skip

    order = 60 if quick else 200
    field = cs.GalerkinField(system=cs.build(data.scenes["test"][0]), order=order)
    cells = cs.CellsOnField(model=model, field=field)
    miss, seconds = [], np.inf
    for record, run in zip(data.records["test"], data.runs["test"], strict=True):
        place = record.nodes[0].mean(axis=0)[:2]
        began = time.perf_counter()
        done = cells.simulate(record.amplitude[:, None], record.heading[:, None], place)
        seconds = min(seconds, time.perf_counter() - began)
        truth = run.block("matrix.displacement")[:: run.stride(data.step)]
        u = field.displacement(done.block("field.modes"))
        miss.append((relative(model.nodes(done.block("z")[:, 0]) - record.nodes, record.nodes),
                     float(np.linalg.norm(u - truth) / np.linalg.norm(truth))))  # fmt: skip
    rc, re = np.sqrt(np.mean(np.square(miss), axis=0))
    print(
        f"\none cell closed with its field (m = {model.order}, q = {order}): rc {rc:.3f}, matrix "
        f"error {re:.3f}, {seconds:.2f} s a run, port index {model.dynamics.passivity_index():.1g}"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", help="folder that keeps the runs")
    arguments = parser.parse_args()
    main(arguments.quick, arguments.out)
