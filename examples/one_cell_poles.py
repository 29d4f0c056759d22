"""One cell: full-order runs, a reduced model that predicts, its poles and what they are worth."""

import argparse
import dataclasses
from pathlib import Path

import cellsys as cs

SCENE = Path(__file__).with_name("spreading.toml")


def main(quick: bool = False, out: str | None = None) -> cs.EquivariantModel:
    scene = cs.load_scene(SCENE)
    if quick:
        plan = dataclasses.replace(scene.training, runs=4, held_out=1, duration=120.0)
        scene = dataclasses.replace(scene, training=plan)
    train, held_out = cs.training_scenes(scene)
    runs = cs.run_ensemble(train + held_out, out or cs.cache_folder())
    data, test = cs.snapshots(runs[: len(train)]), cs.snapshots(runs[len(train) :])
    order, method = (12, cs.Equivariant(folds=0)) if quick else (50, cs.Equivariant())
    model = cs.reduce(data, order=order, method=method, test=test)
    print(model.card)
    for pole in model.labelled_poles()[:12]:  # charge 0 spreads, 1 moves and turns, 2 elongates
        print(f"charge {pole.charge}: {pole.value:.4g} 1/s")
    print(model.pole_set())  # with what rounding and the data leave open of each
    return model


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", help="folder that keeps the runs; default the cache")
    options = parser.parse_args()
    main(options.quick, options.out)
