"""Do commands found on the reduced loop bring the full-order cell where they say? Random targets.

python analysis/steer_truth.py [--quick] [--runs DIR] [--model model_equivariant.npz]
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import numpy as np

import cellsys as cs

SCENE = Path(__file__).parents[1] / "examples" / "spreading.toml"


def learned(scene: cs.Scene, runs: str, order: int, method: cs.Equivariant) -> cs.EquivariantModel:
    train, held_out = cs.training_scenes(scene)
    ran = cs.run_ensemble(train + held_out, runs)
    data, test = cs.snapshots(ran[: len(train)]), cs.snapshots(ran[len(train) :])
    return cs.reduce(data, order=order, method=method, test=test)


def main(quick: bool = False, runs: str | None = None, model: str | None = None) -> list[bool]:
    scene, count, horizon, pieces = cs.load_scene(SCENE), 10, 1500.0, 15
    order, method = 50, cs.Equivariant()
    if quick:
        plan = dataclasses.replace(scene.training, runs=4, held_out=1, duration=60.0)
        scene = dataclasses.replace(scene, training=plan)
        count, horizon, pieces, order, method = 1, 60.0, 3, 12, cs.Equivariant(folds=0)
    reached: list[bool] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = runs or scratch
        plant = cs.EquivariantModel.load(model) if model else learned(scene, folder, order, method)
        loop, rng = cs.closed_loop(plant), np.random.default_rng(18)
        far = cs.steer(loop, cs.Target(place=[1e3, 0.0]), horizon=horizon, pieces=pieces)
        reach = float(np.linalg.norm(far.places[-1] - far.places[0]))
        print(f"reach in {horizon:g} s: {reach:.1f} um")
        start = np.array(scene.cells[0].position)
        for _ in range(count):
            angle, share = rng.uniform(0, 2 * np.pi), np.sqrt(rng.uniform(0.2, 0.8))
            place = start + share * reach * np.array([np.cos(angle), np.sin(angle)])
            aim = angle + rng.uniform(-1.0, 1.0)
            target = cs.Target(place=place, heading=float(aim))
            found = cs.steer(
                loop, target, horizon=horizon, pieces=pieces, scene=scene, folder=folder
            )
            print(found, f"({found.spent['total_s']:.1f} s to find)", flush=True)
            reached.append(found.full.miss.within(target))
    print(f"reached on the full-order model: {sum(reached)} of {len(reached)}")
    return reached


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--runs", help="run cache to use and fill")
    parser.add_argument("--model", help="a learned model of the scene")
    options = parser.parse_args()
    main(options.quick, options.runs, options.model)
