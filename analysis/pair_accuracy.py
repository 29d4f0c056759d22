"""Two reduced cells on one shared field against full-order pairs, beside the one-cell control.

    python analysis/pair_accuracy.py [--quick] [--runs DIR] [--out DIR]

Trains one equivariant cell on single-cell runs (turning headings, varying amplitude, some with
loads on the matrix), puts two of them on the matrix by `LoadPorts`, and compares cells and matrix
with full-order pairs under commands of the same range. Beside it: superposed isolated reduced
fields, superposed isolated full-order fields, and what one cell alone does in the gap.
"""

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np

import cellsys as cs
from cellsys.accuracy.measures import relative

SCENE = Path(__file__).parents[1] / "examples" / "spreading.toml"
PLACES = (((-9.0, 0.0), (9.0, 0.0)), ((-10.0, 2.0), (8.0, -3.0)), ((-5.0, -8.0), (6.0, 7.0)))


def scenes(quick: bool):
    """Training scenes and pairs on one homogeneous disc."""
    base = cs.load_scene(SCENE)
    matrix = dataclasses.replace(base.matrix, inclusion=None)
    cell = dataclasses.replace(base.cells[0], position=(0.0, 0.0))
    places, plain, loaded = PLACES, 22, 10
    if quick:
        matrix = dataclasses.replace(matrix, diameter=44.0, nodes=500)
        cell = dataclasses.replace(cell, radius=5.0)
        base = dataclasses.replace(base, duration=30.0)
        plan = dataclasses.replace(base.training, duration=30.0)
        base = dataclasses.replace(base, training=plan)
        places, plain, loaded = PLACES[:1], 3, 0
    base = dataclasses.replace(base, matrix=matrix, cells=(cell,))
    train = cs.turning_scenes(base, plain, seed=101, scatter=3.0)
    if loaded:
        train += cs.turning_scenes(base, loaded, seed=101, scatter=3.0, loaded=True)
    commanded = cs.turning_scenes(base, 2 * len(places), seed=777, scatter=0.0)
    pairs = [
        dataclasses.replace(
            first,
            name="pair",
            cells=tuple(
                dataclasses.replace(
                    s.cells[0], position=x, commands=s.cells[0].commands or s.commands
                )
                for s, x in zip((first, second), place, strict=True)
            ),
        )
        for place, first, second in zip(places, commanded[::2], commanded[1::2], strict=True)
    ]
    return train, pairs


def commands(scene, t: np.ndarray):
    """Amplitude and heading of every cell over the steps of t: means of the commands."""

    def mean(history, default):
        return np.full(len(t) - 1, default) if history is None else history.means(t)

    each = [cell.commands for cell in scene.cells]
    return (
        np.column_stack([mean(c.amplitude, 1.0) for c in each]),
        np.column_stack([mean(c.heading, 0.0) for c in each]),
    )


def compare(model, field, scene, folder) -> dict[str, float]:
    """One pair: errors and speeds."""
    run, *alone = cs.run_ensemble([scene, *cs.alone_scenes(scene)], folder)
    every = run.stride(model.dt)
    t = run.t[::every]
    amplitude, heading = commands(scene, t)
    places = np.array([c.position for c in scene.cells])
    truth = np.array(run.block("matrix.displacement")[::every])
    body = np.stack([run.block(f"cell{k}.position")[::every] for k in (1, 2)], axis=1)

    def coupled(which):
        cells = cs.couple(model, coupling=cs.LoadPorts(field=field, positions=places[which]))
        return cells, cells.simulate(t, amplitude=amplitude[:, which], heading=heading[:, which])

    began = time.perf_counter()
    cells, reduced = coupled([0, 1])
    wall = time.perf_counter() - began
    matrix, nodes = cells.matrix_displacement(reduced), cells.nodes(reduced)
    singles = [coupled([k]) for k in (0, 1)]
    superposed = sum(c.matrix_displacement(r) for c, r in singles)
    full = sum(np.array(r.block("matrix.displacement")[::every]) for r in alone)
    rest = cs.build(scene).matrix.position
    out = {
        "least distance": float(
            np.linalg.norm(np.diff(body.mean(axis=2), axis=1)[:, 0, :2], axis=1).min()
        ),
        "field": relative(matrix, truth),
        "superposed reduced": relative(superposed, truth),
        "superposed full": relative(full, truth),
        "cell 1": relative(nodes[:, 0] - body[0, 0], body[:, 0] - body[0, 0]),
        "cell 2": relative(nodes[:, 1] - body[0, 1], body[:, 1] - body[0, 1]),
    }
    gap, rim = (mask[::every][:-1] for mask in cs.pair_regions(run, rest))
    single = [np.array(r.block("matrix.displacement")[::every]) for r in alone]
    for name, mask in (("gap", gap), ("periphery", rim)):
        speeds = [
            1e3 * (np.linalg.norm(np.diff(u, axis=0), axis=2) / model.dt)[mask].mean()
            for u in (truth, matrix, *single)
        ]
        out |= {f"{name}, full": speeds[0], f"{name}, reduced": speeds[1]}
        out[f"{name}, one cell alone"] = float(np.mean(speeds[2:]))
    print(f"pair at {places[0]} and {places[1]} um, reduced in {wall:.1f} s:")
    print("  " + ", ".join(f"{name} {value:.3g}" for name, value in out.items()))
    share = 1 - out["field"] / out["superposed reduced"]
    print(
        f"  matrix error {100 * share:.0f} % below superposed isolated reduced fields, gap speed "
        f"off by {100 * abs(out['gap, reduced'] / out['gap, full'] - 1):.0f} %"
    )
    return out


def main(quick: bool = False, runs: str | None = None, out: str | None = None) -> None:
    train, pairs = scenes(quick)
    with tempfile.TemporaryDirectory() as scratch:
        folder = runs or scratch
        data = cs.snapshots(cs.run_ensemble(train, folder))
        method = cs.Equivariant(folds=0, iterations=8) if quick else cs.Equivariant(folds=0)
        model = cs.reduce(data, order=24 if quick else 100, method=method)
        print(model.card.verdict)
        system = cs.build(pairs[0])
        field = (
            cs.GalerkinField(system=system, order=40, places=20)
            if quick
            else cs.GalerkinField(system=system)
        )
        print(cs.couple(model, coupling=cs.LoadPorts(field=field, positions=PLACES[0])).stability())
        rows = [compare(model, field, scene, folder) for scene in pairs]
    if out is None:
        return
    from cellsys.figures import save_png, sheet

    figure, ax = sheet((6.5, 3.8))
    kinds = ("field", "superposed reduced", "superposed full")
    for i, kind in enumerate(kinds):
        ax.bar(np.arange(len(rows)) + 0.27 * i, [r[kind] for r in rows], 0.25, label=kind)
    ax.set_xticks(
        np.arange(len(rows)) + 0.27, [f"{r['least distance']:.0f} um apart" for r in rows]
    )
    ax.set(ylabel="matrix displacement error")
    ax.legend(fontsize="small")
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    save_png(figure, folder / "pair_accuracy.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--runs", help="folder that keeps the runs")
    parser.add_argument("--out", help="folder for the figure")
    options = parser.parse_args()
    main(options.quick, options.runs, options.out)
