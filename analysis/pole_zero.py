"""Poles of PCR models, which do not predict, at several orders with their certainty; zeros.

python analysis/pole_zero.py [--quick] [--runs DIR] [--out DIR]
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
    orders = (10, 100)
    if quick:
        plan = dataclasses.replace(scene.training, runs=4, held_out=1, duration=100.0)
        scene, orders = dataclasses.replace(scene, training=plan), (4, 10)
    with tempfile.TemporaryDirectory() as scratch:
        train, held_out = cs.training_scenes(scene)
        ran = cs.run_ensemble(train + held_out, runs or scratch)
        data, test = cs.snapshots(ran[: len(train)]), cs.snapshots(ran[len(train) :])
        models = list(cs.reduce_orders(data, [cs.PCR()], orders, test))
    for model in models:
        poles = model.pole_set()
        growing = int(np.sum(poles.real > poles.error_bound))
        print(
            f"m = {model.order}: {int(np.sum(poles.real > 0))} poles with Re > 0, {growing} of "
            f"them beyond their bound, largest {poles.real.max():.3g} 1/s, largest |Im| "
            f"{np.abs(poles.imag).max():.3g} rad/s"
        )
        print(f"  {model.card.verdict}")
    small = models[0]
    print(f"m = {small.order}: {small.pole_set()}")
    # Zeros depend on what is read: here the sensed direction, from the first command.
    plant = small.plant(output=small.sensor.S_d[:2], output_names=["d_x", "d_y"], offset="drop")
    print(f"zeros from the commands to the sensed direction: {len(cs.zeros(plant))}")
    if out is not None:
        from cellsys.figures import pole_map, save_png, sheet

        figure, axes = sheet((10, 4.4), 1, 2)
        for ax, model in zip(axes, models, strict=True):
            poles = model.pole_set()
            pole_map(np.asarray(poles), ax, spread=poles.error_bound if model is small else None)
            ax.set_title(f"PCR, m = {model.order}")
        save_png(figure, Path(out) / "pole_zero.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--runs", help="run cache to use and fill")
    parser.add_argument("--out", help="folder for the figure")
    options = parser.parse_args()
    main(options.quick, options.runs, options.out)
