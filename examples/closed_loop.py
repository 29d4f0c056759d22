"""The polarity loop on a reduced plant: simulate it, cut it open, read the margins on kappa."""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import numpy as np

import cellsys as cs

SCENE = Path(__file__).with_name("spreading.toml")


def main(quick: bool = False, out: str | None = None) -> cs.ClosedLoop:
    scene = cs.load_scene(SCENE)
    if quick:
        plan = dataclasses.replace(scene.training, runs=4, held_out=1, duration=60.0)
        scene = dataclasses.replace(scene, training=plan)
    with tempfile.TemporaryDirectory() as scratch:
        train, _ = cs.training_scenes(scene)
        data = cs.snapshots(cs.run_ensemble(train, out or scratch))
        model = cs.reduce(data, order=3 if quick else 10, method=cs.LeastSquares())
    loop = cs.closed_loop(model, controller=cs.PolarityLaw(kappa=1 / 60))
    t = np.linspace(0.0, scene.training.duration, 61)
    run = loop.simulate(t, cs.CVODES(rtol=1e-8, atol=1e-8), p0=[0.0, 1.0, 0.0])
    turned = np.degrees(np.arctan2(run.p[:, 0, 1], run.p[:, 0, 0]))
    print(f"heading: {turned[0]:.0f} deg at the start, {turned[-1]:.0f} deg at the end")
    point = loop.linearize(run, slower_than=1.0 / t[-1])
    print(point)
    print(cs.margins(loop.open_loop(point)))
    return loop


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", help="folder that keeps the runs")
    options = parser.parse_args()
    main(options.quick, options.out)
