"""The polarity loop on a reduced cell that predicts: simulate it, cut it open, read the margins."""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

import cellsys as cs

SCENE = Path(__file__).with_name("spreading.toml")


def main(quick: bool = False, out: str | None = None) -> cs.ScheduledLoop:
    scene = cs.load_scene(SCENE)
    if quick:
        plan = dataclasses.replace(scene.training, runs=4, held_out=1, duration=120.0)
        scene = dataclasses.replace(scene, training=plan)
    train, held_out = cs.training_scenes(scene)
    runs = cs.run_ensemble(train + held_out, out or cs.cache_folder())
    data, test = cs.snapshots(runs[: len(train)]), cs.snapshots(runs[len(train) :])
    order, method = (12, cs.Equivariant(folds=0)) if quick else (50, cs.Equivariant())
    model = cs.reduce(data, order=order, method=method, test=test)
    print(model.card.verdict)  # a loop is worth what its plant is
    loop = cs.closed_loop(model, controller=cs.PolarityLaw(kappa=1 / 60), p0=[0.0, 1.0, 0.0])
    run = loop.simulate(np.arange(0.0, scene.training.duration + 1, 10.0))
    turned = cs.heading_deg(run.p[:, 0])
    print(f"heading: {turned[0]:.0f} deg at the start, {turned[-1]:.0f} deg at the end")
    point = loop.linearize(run.t[-1], slower_than=1.0 / run.t[-1])
    print(point)
    print(cs.margins(loop.open_loop(point)))
    return loop


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", help="folder that keeps the runs; default the cache")
    options = parser.parse_args()
    main(options.quick, options.out)
