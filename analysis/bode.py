"""Bode plot and margins of the polarity loop on PCR and least squares, which do not predict.

The thesis's reductors, with their verdicts; the gain margin is checked by sweeping kappa. For the
plant that predicts see `examples/closed_loop.py`.

python analysis/bode.py [--quick] [--runs DIR] [--out DIR]
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import numpy as np

import cellsys as cs

SCENE = Path(__file__).parents[1] / "examples" / "spreading.toml"


def main(quick: bool = False, runs: str | None = None, out: str | None = None) -> None:
    scene = cs.load_scene(SCENE)
    order = 10
    if quick:
        plan = dataclasses.replace(scene.training, runs=4, held_out=1, duration=100.0)
        scene, order = dataclasses.replace(scene, training=plan), 3
    with tempfile.TemporaryDirectory() as scratch:
        train, held_out = cs.training_scenes(scene)
        ran = cs.run_ensemble(train + held_out, runs or scratch)
        data, test = cs.snapshots(ran[: len(train)]), cs.snapshots(ran[len(train) :])
        models = list(cs.reduce_orders(data, [cs.PCR(), cs.LeastSquares()], [order], test))
    drawn = None
    for model in models:
        loop = cs.closed_loop(model, controller=cs.PolarityLaw(kappa=1 / 60))
        point = loop.linearize(scene.training.duration, slower_than=1.0 / scene.training.duration)
        result = cs.margins(loop.open_loop(point))
        print(f"{model.card.method}: {model.card.verdict}\n{point}\n{result}")
        factors = np.geomspace(1e-2, 1e3, 60)
        said = [cs.stability(point.closed(f)).verdict for f in factors]
        counts = ", ".join(f"{said.count(v)} {v}" for v in sorted(set(said)))
        print(f"kappa swept over {factors[0]:g} .. {factors[-1]:g} times its value: {counts}\n")
        drawn = result if drawn is None else drawn
    if out is not None:
        from cellsys.figures import bode, save_png, sheet

        figure, axes = sheet((7.5, 6), 2, sharex=True)
        bode(drawn, axes)
        save_png(figure, Path(out) / "bode.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--runs", help="run cache to use and fill")
    parser.add_argument("--out", help="folder for the figure")
    options = parser.parse_args()
    main(options.quick, options.runs, options.out)
