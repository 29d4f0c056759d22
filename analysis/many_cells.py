"""The shipped scenes of two and of ten cells to their end, full-order and reduced, read alike.

    python analysis/many_cells.py [--quick] [--out DIR] [--only two|facing|ten]

One equivariant cell is learned from runs of one cell with turning headings on a 60 um disc of the
same material. K of them on the matrix of the scene (all its fibres, not projected), each with its
own polarity law and the sensing law on the shared fibres, are run as the scene says and read out
by `observe` like the full-order run: matrix speed in the gap and at the periphery, normalised gap,
speed against spacing, attenuation length. Beside each stands the one-cell control: every cell alone
at the same place, full-order for full-order, reduced for reduced. How far the scene can be known
at all is shown by the full-order run from a start shifted by 5 nm; what of the error is the
mechanics' own, by reduced cells that follow the headings of the full-order run. Facing cells run
until they touch. --out keeps runs and figure.
"""

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np

import cellsys as cs
from cellsys.accuracy.measures import motion, relative
from cellsys.trajectory import cell_names

EXAMPLES = Path(__file__).parents[1] / "examples"
SHIFT = 5e-3  # um
MATRIX = "matrix.displacement"


def scenes(quick: bool, only: str | None) -> dict[str, cs.Scene]:
    """Scenes by name; in quick form one pair on a small disc."""
    names = {"two": ("two_cells", "two_cells_far"), "facing": ("two_cells_facing",),
             "ten": ("ten_cells",)}  # fmt: skip
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
    model: cs.EquivariantModel,
    scene: cs.Scene,
    field: cs.FullField,
    which: list[int],
    heading: np.ndarray | None = None,
) -> tuple[cs.Trajectory, float]:
    """The chosen cells of a scene on its matrix, in nodes; and the time it took, s.

    They steer themselves, or follow `heading` (steps, K).
    """
    chosen = [scene.cells[k] for k in which]
    ports = cs.LoadPorts(
        field=field,
        positions=np.array([c.position for c in chosen]),
        headings=np.array([c.polarity for c in chosen]),
    )
    cells = cs.couple(
        model,
        coupling=ports,
        controller=cs.PolarityLaw(kappa=scene.effects["polarity"].kappa),
        sensor=cs.FieldSensor.of(scene.effects["stiffness_sensing"]),
    )
    began = time.perf_counter()
    steps = round(scene.duration / model.dt)
    run = cells.simulate(
        model.dt * np.arange(steps + 1), heading=None if heading is None else heading[:, which]
    )
    return cells.in_nodes(run), time.perf_counter() - began


def on_grid(run: cs.Trajectory, dt: float) -> cs.Trajectory:
    """Every sample on the grid of dt, positions and polarity alone."""
    every = run.stride(dt)
    blocks = [b for b in run.states if b.name.endswith((".position", ".displacement"))]
    x = np.column_stack([run.block(b.name)[::every].reshape(len(run.t[::every]), -1)
                         for b in blocks])  # fmt: skip
    return cs.Trajectory(
        t=run.t[::every],
        x=x,
        states=cs.Layout(blocks),
        p=np.asarray(run.p)[::every],
        events=run.events,
        geometry=run.geometry,
    )


def misses(found: cs.Trajectory, truth: cs.Trajectory) -> str:
    """Errors of cells, matrix and headings in words."""
    names = [f"{name}.position" for name in cell_names(truth.states)]
    places = [np.concatenate([r.block(n) for n in names], axis=1) for r in (found, truth)]
    turn = cs.heading_error_deg(found.p, truth.p)
    return (
        f"cells {motion(*places):.3f} of their motion, matrix "
        f"{relative(found.block(MATRIX), truth.block(MATRIX)):.3f}, "
        f"heading {np.sqrt(np.mean(turn**2)):.1f} deg rms"
    )


def shifted(scene: cs.Scene) -> cs.Scene:
    """Every cell 5 nm to the side."""
    cells = [
        dataclasses.replace(c, position=(c.position[0] + SHIFT, c.position[1])) for c in scene.cells
    ]
    return dataclasses.replace(scene, name=f"{scene.name}, shifted", cells=tuple(cells))


def followed(run: cs.Trajectory) -> np.ndarray:
    """Headings (steps, K) of a run, half-way between its samples."""
    angle = np.radians(cs.heading_deg(run.p))
    return 0.5 * (angle[1:] + angle[:-1])


def compare(model: cs.EquivariantModel, scene: cs.Scene, folder: Path) -> dict:
    """One scene, both ways."""
    alone = cs.alone_scenes(scene)
    full, moved, *singles = cs.run_ensemble([scene, shifted(scene), *alone], folder)
    wall = full.statistics["wall_time"]
    full, moved, *singles = (on_grid(r, model.dt) for r in (full, moved, *singles))
    system = cs.build(scene)
    rest, field = system.matrix.position, cs.full_field(system)
    K = len(scene.cells)
    small, took = reduced(model, scene, field, list(range(K)))
    controls = [reduced(model, scene, field, [k])[0] for k in range(K)]
    places = np.array([c.position for c in scene.cells])
    rows = {
        "full": cs.observe_neighbours(full, singles, rest),
        "reduced": cs.observe_neighbours(small, controls, rest),
    }
    print(f"\n{scene.name}: {K} cells, {len(rest)} nodes, {scene.duration:g} s; full-order "
          f"{wall:.0f} s, reduced {took:.1f} s")  # fmt: skip
    u, heading = full.block(MATRIX), followed(full)
    led, _ = reduced(model, scene, field, list(range(K)), heading)
    led_alone = [reduced(model, scene, field, [k], heading)[0] for k in range(K)]
    rows["led"] = cs.observe_neighbours(led, led_alone, rest)
    print(f"  reduced, each its own polarity: {misses(small, full)}")
    print(f"  full-order, start shifted by 5 nm: {misses(moved, full)}")
    print(f"  superposed fields of cells alone, each its own polarity: matrix full-order "
          f"{relative(sum(r.block(MATRIX) for r in singles), u):.3f}, reduced "
          f"{relative(sum(r.block(MATRIX) for r in controls), u):.3f}")  # fmt: skip
    print(f"  reduced, headings of the full-order run: {misses(led, full)}; superposed reduced "
          f"fields of cells alone: matrix "
          f"{relative(sum(r.block(MATRIX) for r in led_alone), u):.3f}")  # fmt: skip
    inner = int(np.argmin(np.linalg.norm(places, axis=1)))  # far from the rim, which is held
    for name, run in (("full", singles[inner]), ("reduced", controls[inner])):
        print(f"  {name}, around cell {inner + 1} alone: {cs.attenuation_length(run, rest)}")
    print("  led: reduced, headings of the full-order run")
    head = ("pair", "gap um", "norm. gap", "gap nm/s", "alone", "far nm/s", "alone")
    print("  " + " ".join(f"{h:>10s}" for h in ("", *head)))
    for pair in rows["full"]:
        for name in rows:
            if pair not in rows[name]:
                continue
            m = rows[name][pair].means()
            values = (m["gap_start_um"], m["normalised_gap_end"], m["gap_speed_nm_s"],
                      m["gap_speed_one_cell_nm_s"], m["periphery_speed_nm_s"],
                      m["periphery_speed_one_cell_nm_s"])  # fmt: skip
            print(f"  {name:>10s} {f'{pair[0] + 1}-{pair[1] + 1}':>10s} "
                  + " ".join(f"{value:10.2f}" for value in values))  # fmt: skip
    return rows


def until_touch(model: cs.EquivariantModel, scene: cs.Scene, folder: Path) -> None:
    """Facing cells: when they touch, full-order and reduced, and what they do until then."""
    full, moved = cs.run_ensemble([scene, shifted(scene)], folder)
    ends, whole = [], dataclasses.replace(scene, until=None)
    scene = dataclasses.replace(scene, duration=float(full.t[-1]), until=None)
    singles = cs.run_ensemble(cs.alone_scenes(scene), folder)
    full, moved, *singles = (on_grid(r, model.dt) for r in (full, moved, *singles))
    system = cs.build(scene)
    field = cs.full_field(system)
    small, took = reduced(model, whole, field, [0, 1])
    led, _ = reduced(model, scene, field, [0, 1], followed(full))
    for name, run in (("full-order", full), ("shifted by 5 nm", moved),
                      ("reduced", cs.until_contact(small)),
                      ("reduced, led by its headings", cs.until_contact(led))):  # fmt: skip
        touch = [e for e in run.events if e.name == "contact"]
        end = f"{touch[0].detail} touch at {touch[0].time:.0f} s" if touch else "no contact"
        gap = cs.edge_gap(run)
        ends.append(f"{name}: {end}, gap {gap[0]:.1f} -> {gap[-1]:.1f} um")
    print(f"\n{scene.name}, reduced in {took:.1f} s (trained for {model.horizon:g} s)\n  "
          + "\n  ".join(ends))  # fmt: skip
    count = min(len(full), len(small), len(moved))
    print(f"  until {full.t[count - 1]:.0f} s, reduced: "
          f"{misses(first(small, count), first(full, count))}")  # fmt: skip
    print(f"  on its headings: {misses(first(led, count), first(full, count))}")
    print(f"  shifted by 5 nm: {misses(first(moved, count), first(full, count))}")
    count = min(len(full), *(len(r) for r in singles))
    read_out = cs.observe_pair(first(full, count), [first(r, count) for r in singles],
                               system.matrix.position)  # fmt: skip
    print(f"  full-order: {read_out}")


def first(run: cs.Trajectory, count: int) -> cs.Trajectory:
    """The first samples of a run, positions and polarity alone."""
    return cs.Trajectory(
        t=run.t[:count],
        x=run.x[:count],
        states=run.states,
        p=np.asarray(run.p)[:count],
        geometry=run.geometry,
    )


def draw(found: dict[str, dict], folder: Path) -> None:
    """Gap speed against spacing, full-order and reduced, beside the one-cell control.

    Led: on the headings of the full-order run.
    """
    from cellsys.figures import save_png, sheet

    figure, ax = sheet((7.5, 5.0))
    kinds = {"full": "full-order", "reduced": "reduced, own polarity", "led": "reduced, led"}
    for color, (kind, label) in zip(("C0", "C1", "C2"), kinds.items(), strict=True):
        rows = cs.speed_against_spacing([r for s in found.values() for r in s[kind].values()])
        ax.plot(rows[:, 0], rows[:, 1], "o", color=color, label=f"{label}, together")
        ax.plot(rows[:, 0], rows[:, 2], "x", color=color, label=f"{label}, one cell alone")
    ax.set(xlabel="free gap at the start (um)", ylabel="matrix speed in the gap (nm/s)")
    ax.grid(alpha=0.3)
    ax.legend(fontsize="small", ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    save_png(figure, folder / "many_cells.png")


def main(quick: bool = False, out: str | None = None, only: str | None = None) -> None:
    if out is None:
        with tempfile.TemporaryDirectory() as scratch:
            return main(quick, scratch, only)
    folder = Path(out)
    model = learn(quick, folder / "runs")
    print(model.card.verdict)
    found = {}
    for name, scene in scenes(quick, only).items():
        if scene.until is not None:
            until_touch(model, scene, folder / "runs")
        else:
            found[name] = compare(model, scene, folder / "runs")
    if found:
        draw(found, folder)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", help="folder of runs and figure")
    parser.add_argument("--only", choices=("two", "facing", "ten"))
    given = parser.parse_args()
    main(given.quick, given.out, given.only)
