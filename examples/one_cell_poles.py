"""One cell: full-order runs, a reduced model, its poles and what they are worth."""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import cellsys as cs

SCENE = Path(__file__).with_name("spreading.toml")


def main(quick: bool = False, out: str | None = None) -> cs.LatentModel:
    scene = cs.load_scene(SCENE)
    if quick:
        plan = dataclasses.replace(scene.training, runs=3, held_out=1, duration=60.0)
        scene = dataclasses.replace(scene, training=plan)
    with tempfile.TemporaryDirectory() as scratch:
        train, held_out = cs.training_scenes(scene)
        runs = cs.run_ensemble(train + held_out, out or scratch)
        data, test = cs.snapshots(runs[: len(train)]), cs.snapshots(runs[len(train) :])
        model = cs.reduce(data, order=5 if quick else 10, method=cs.PCR(), test=test)
    print(model.card)
    print(cs.damping(model.plant()))
    return model


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", help="folder that keeps the runs")
    options = parser.parse_args()
    main(options.quick, options.out)
