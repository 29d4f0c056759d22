"""The shipped scenes of two and of ten cells to their end, full-order and reduced, read alike.

    python analysis/many_cells.py [--quick] [--out DIR] [--only two|ten]

One equivariant cell is learned from runs of one cell with turning headings on a 60 um disc of the
same material. K of them on the matrix of the scene (all its fibres, not projected), each with its
own polarity law and the sensing law on the shared fibres, are run as the scene says and read out
by `observe` like the full-order run: matrix speed in the gap and at the periphery, normalised gap,
speed against spacing, attenuation length. Beside each stands the one-cell control: every cell alone
at the same place, full-order for full-order, reduced for reduced. --out keeps runs and figure.
"""

import argparse
import dataclasses
import itertools
import tempfile
import time
from pathlib import Path

import numpy as np

import cellsys as cs

EXAMPLES = Path(__file__).parents[1] / "examples"
CLOSE = 40.0  # um between the edges: pairs farther apart are not neighbours


def scenes(quick: bool, only: str | None) -> dict[str, cs.Scene]:
    """Scenes by name; in quick form one pair on a small disc."""
    names = {"two": ("two_cells", "two_cells_far"), "ten": ("ten_cells",)}
    chosen = [n for key, group in names.items() if only in (None, key) for n in group]
    found = {n: cs.load_scene(EXAMPLES / f"{n}.toml") for n in chosen[: 1 if quick else None]}
    if not quick:
        return found
    return {
        name: dataclasses.replace(
            s,
            matrix=dataclasses.replace(s.matrix, diameter=70.0, nodes=1000),
            cells=tuple(dataclasses.replace(c, radius=5.0) for c in s.cells),
            duration=60.0,
        )
        for name, s in found.items()
    }


def learn(quick: bool, folder: Path) -> cs.EquivariantModel:
    """One cell from turning runs on a homogeneous disc of 60 um."""
    scene = cs.load_scene(EXAMPLES / "spreading.toml")
    matrix = dataclasses.replace(scene.matrix, inclusion=None)
    cell = dataclasses.replace(scene.cells[0], position=(0.0, 0.0))
    if quick:
        matrix = dataclasses.replace(matrix, diameter=46.0, nodes=420)
        cell = dataclasses.replace(cell, radius=5.0)
        scene = dataclasses.replace(
            scene, training=dataclasses.replace(scene.training, duration=60.0)
        )
    scene = dataclasses.replace(scene, matrix=matrix, cells=(cell,))
    runs = cs.run_ensemble(
        cs.turning_scenes(scene, 3 if quick else 11, seed=71, scatter=3.0), folder
    )
    method = cs.Equivariant(folds=0, iterations=30) if quick else cs.Equivariant(folds=0)
    return cs.reduce(cs.snapshots(runs), order=16 if quick else 50, method=method)


def reduced(
    model: cs.EquivariantModel, scene: cs.Scene, field: cs.FullField, which: list[int]
) -> tuple[cs.Trajectory, float]:
    """The chosen cells of a scene on its matrix, in nodes; and the time it took, s."""
    chosen = [scene.cells[k] for k in which]
    ports = cs.LoadPorts(
        field,
        np.array([c.position for c in chosen]),
        np.array([c.polarity for c in chosen]),
    )
    cells = cs.couple(
        model,
        coupling=ports,
        controller=cs.PolarityLaw(kappa=scene.effects["polarity"].kappa),
        sensor=cs.FieldSensor.of(scene.effects["stiffness_sensing"]),
    )
    began = time.perf_counter()
    run = cells.simulate(model.dt * np.arange(int(scene.duration / model.dt) + 1))
    return cells.in_nodes(run), time.perf_counter() - began


def pair_of(run: cs.Trajectory, i: int, j: int) -> cs.Trajectory:
    """Cells i and j of a run as cell1 and cell2, with the matrix."""
    names = [f"cell{i + 1}.position", f"cell{j + 1}.position", "matrix.displacement"]
    blocks = [dataclasses.replace(run.states[n], name=new) for n, new in zip(
        names, ("cell1.position", "cell2.position", names[2]), strict=True)]  # fmt: skip
    x = np.column_stack([run.block(n).reshape(len(run), -1) for n in names])
    return cs.Trajectory(run.t, x, cs.Layout(blocks))


def on_grid(run: cs.Trajectory, dt: float) -> cs.Trajectory:
    """Every sample on the grid of dt, positions and polarity alone."""
    every = round(dt / (run.t[1] - run.t[0]))
    blocks = [b for b in run.states if b.name.endswith((".position", ".displacement"))]
    x = np.column_stack([run.block(b.name)[::every].reshape(len(run.t[::every]), -1)
                         for b in blocks])  # fmt: skip
    return cs.Trajectory(run.t[::every], x, cs.Layout(blocks), p=np.asarray(run.p)[::every])


def read(
    run: cs.Trajectory, alone: list[cs.Trajectory], rest: np.ndarray, places: np.ndarray
) -> dict[tuple[int, int], cs.PairReadout]:
    """Read-outs of every pair of neighbours, up to their contact."""
    out = {}
    for i, j in itertools.combinations(range(len(places)), 2):
        pair = pair_of(run, i, j)
        if cs.edge_gap(pair)[0] < CLOSE:
            pair = cs.until_contact(pair)
            out[i, j] = cs.observe_pair(pair, [alone[i], alone[j]], rest)
    return out


def compare(model: cs.EquivariantModel, scene: cs.Scene, folder: Path) -> dict:
    """One scene, both ways."""
    full, *singles = cs.run_ensemble([scene, *cs.alone_scenes(scene)], folder)
    wall = full.statistics["wall_time"]
    full, *singles = (on_grid(r, model.dt) for r in (full, *singles))
    system = cs.build(scene)
    rest, field = system.matrix.position, cs.full_field(system)
    K = len(scene.cells)
    small, took = reduced(model, scene, field, list(range(K)))
    controls = [reduced(model, scene, field, [k])[0] for k in range(K)]
    places = np.array([c.position for c in scene.cells])
    rows = {
        "full": read(full, singles, rest, places),
        "reduced": read(small, controls, rest, places),
    }
    print(f"\n{scene.name}: {K} cells, {len(rest)} nodes, {scene.duration:g} s; full-order "
          f"{wall:.0f} s, reduced {took:.1f} s")  # fmt: skip
    moved = np.concatenate([full.block(f"cell{k + 1}.position") for k in range(K)], axis=1)
    found = np.concatenate([small.block(f"cell{k + 1}.position") for k in range(K)], axis=1)
    miss = np.linalg.norm(found - found[0] - moved + moved[0]) / np.linalg.norm(moved - moved[0])
    u, v = full.block("matrix.displacement"), small.block("matrix.displacement")
    lone = sum(r.block("matrix.displacement") for r in singles)
    size = np.linalg.norm(u)
    angle = [np.arctan2(r.p[..., 1], r.p[..., 0]) for r in (full, small)]
    turn = np.degrees(np.angle(np.exp(1j * (angle[1] - angle[0]))))
    print(f"  cells {miss:.3f} of their motion, matrix {np.linalg.norm(v - u) / size:.3f} "
          f"(superposed full-order fields of cells alone {np.linalg.norm(lone - u) / size:.3f}), "
          f"heading {np.sqrt(np.mean(turn**2)):.1f} deg rms")  # fmt: skip
    for name, run in (("full", singles[0]), ("reduced", controls[0])):
        print(f"  {name}, around cell 1 alone: {cs.attenuation_length(run, rest)}")
    head = ("pair", "gap um", "norm. gap", "gap nm/s", "alone", "far nm/s", "alone")
    print("  " + " ".join(f"{h:>10s}" for h in ("", *head)))
    for pair in rows["full"]:
        for name in ("full", "reduced"):
            if pair not in rows[name]:
                continue
            m = rows[name][pair].means()
            values = (m["gap_start_um"], m["normalised_gap_end"], m["gap_speed_nm_s"],
                      m["gap_speed_one_cell_nm_s"], m["periphery_speed_nm_s"],
                      m["periphery_speed_one_cell_nm_s"])  # fmt: skip
            print(f"  {name:>10s} {f'{pair[0] + 1}-{pair[1] + 1}':>10s} "
                  + " ".join(f"{value:10.2f}" for value in values))  # fmt: skip
    return rows


def draw(found: dict[str, dict], folder: Path) -> None:
    """Gap speed against spacing, full-order and reduced, beside the one-cell control."""
    from cellsys.figures import save_png, sheet

    figure, ax = sheet((6.5, 4.0))
    for color, kind in (("C0", "full"), ("C1", "reduced")):
        rows = cs.speed_against_spacing([r for s in found.values() for r in s[kind].values()])
        ax.plot(rows[:, 0], rows[:, 1], "o", color=color, label=f"{kind}, together")
        ax.plot(rows[:, 0], rows[:, 2], "x", color=color, label=f"{kind}, one cell alone")
    ax.set(xlabel="free gap at the start (um)", ylabel="matrix speed in the gap (nm/s)")
    ax.grid(alpha=0.3)
    ax.legend(fontsize="small")
    save_png(figure, folder / "many_cells.png")


def main(quick: bool = False, out: str | None = None, only: str | None = None) -> None:
    if out is None:
        with tempfile.TemporaryDirectory() as scratch:
            return main(quick, scratch, only)
    folder = Path(out)
    model = learn(quick, folder / "runs")
    print(model.card.verdict)
    found = {n: compare(model, s, folder / "runs") for n, s in scenes(quick, only).items()}
    draw(found, folder)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", help="folder of runs and figure")
    parser.add_argument("--only", choices=("two", "ten"))
    given = parser.parse_args()
    main(given.quick, given.out, given.only)
