"""Commands that bring cells where they are wanted: around a stiff spot, and two to a given gap.

python examples/steer.py [--quick] [--out FOLDER]
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import cellsys as cs

SCENE = Path(__file__).with_name("spreading.toml")


def main(quick: bool = False, out: str | None = None) -> None:
    scene = cs.load_scene(SCENE)
    horizon, pieces, order, method = 1500.0, 15, 50, cs.Equivariant()
    if quick:
        plan = dataclasses.replace(scene.training, runs=4, held_out=1, duration=60.0)
        scene = dataclasses.replace(scene, training=plan)
        horizon, pieces, order, method = 60.0, 3, 12, cs.Equivariant(folds=0)
    over = {"horizon": horizon, "pieces": pieces, "turning": 0.01}  # rad/s
    with tempfile.TemporaryDirectory() as scratch:
        folder = out or scratch
        train, held_out = cs.training_scenes(scene)
        runs = cs.run_ensemble(train + held_out, folder)
        data, test = cs.snapshots(runs[: len(train)]), cs.snapshots(runs[len(train) :])
        model = cs.reduce(data, order=order, method=method, test=test)
        loop = cs.closed_loop(model)

        # The stiff spot of the scene lies on the straight way.
        spot = cs.Obstacle(center=scene.matrix.inclusion.center, radius=5.0)
        target = cs.Target(place=[-2.7, -2.2] if quick else [5.0, -4.5])
        found = cs.steer(loop, target, **over, avoid=[spot], scene=scene, folder=folder)
        print(found)
        print(cs.steer(loop, cs.Target(place=[25.0, 0.0]), **over))

        # Two cells on one field, 20 um apart: their edges are to come closer.
        cells = (
            dataclasses.replace(scene.cells[0], position=(-10.0, 0.0), polarity=1.5),
            dataclasses.replace(scene.cells[0], position=(10.0, 0.0), polarity=1.5),
        )
        two = dataclasses.replace(scene, cells=cells)
        field = cs.GalerkinField(system=cs.build(two), order=40, linear=True, places=20)
        places = cs.LoadPorts(field=field, positions=[c.position for c in cells])
        pair = cs.couple(model, coupling=places)
        gap = cs.Target(gap=19.8 if quick else 17.0)
        print(cs.steer(pair, gap, **over, scene=two, folder=folder))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", help="folder that keeps the runs")
    options = parser.parse_args()
    main(options.quick, options.out)
