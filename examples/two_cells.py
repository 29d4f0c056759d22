"""Two cells on one matrix: what each does to the other, beside one cell alone at its place.

    python examples/two_cells.py [--quick] [--runs DIR]

Full-order runs of two_cells.toml and two_cells_far.toml (polarity across the axis) with their
one-cell controls, then of two_cells_facing.toml until the cells touch.
"""

import argparse
import dataclasses
from pathlib import Path

import cellsys as cs

HERE = Path(__file__).parent


def load(name: str, quick: bool) -> cs.Scene:
    scene = cs.load_scene(HERE / f"{name}.toml")
    if not quick:
        return scene
    # A smaller disc: its rim is felt, the read-outs work the same.
    matrix = dataclasses.replace(scene.matrix, diameter=80.0)
    return dataclasses.replace(scene, matrix=matrix, duration=30.0)


def main(quick: bool = False, runs: str | None = None) -> None:
    folder = runs or cs.cache_folder()
    readouts = []
    for name in ("two_cells",) if quick else ("two_cells", "two_cells_far"):
        scene = load(name, quick)
        rest = cs.build(scene).matrix.position
        pair, *alone = cs.run_ensemble([scene, *cs.alone_scenes(scene)], folder)
        readouts.append(cs.observe_pair(pair, alone, rest))
        print(f"{scene.name}: {readouts[-1]}")
        print(f"  around cell 1 alone: {cs.attenuation_length(alone[0], rest)}")
    print("gap (um), matrix speed in it, same place with one cell (nm/s):")
    for row in cs.speed_against_spacing(readouts):
        print("  " + "  ".join(f"{v:6.2f}" for v in row))
    facing = cs.until_contact(cs.run_scene(load("two_cells_facing", quick), folder))
    end = facing.events[-1] if facing.events else None
    if end is None:
        print(f"facing: no contact in {facing.t[-1]:g} s, gap {cs.edge_gap(facing)[-1]:.1f} um")
    else:
        print(f"facing: {end.detail} touch at {end.time:.0f} s; the run ends there")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--runs", help="folder that keeps the runs")
    options = parser.parse_args()
    main(options.quick, options.runs)
