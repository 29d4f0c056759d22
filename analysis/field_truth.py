"""How well does the projected matrix follow the true one from true loads, and what does it cost?

    python analysis/field_truth.py [--quick] [--out DIR]

Held-out runs of the shipped scene with turning commands, without and with loads on the matrix.
The loads are the logged ones at the end of each interval, so every error is the model's own.
Prints the relative error of the matrix displacement by number of modes, the projection floor,
processor time, and the passivity of the implicit step.
"""

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np

import cellsys as cs

SCENE = Path(__file__).parents[1] / "examples" / "spreading.toml"


def scenes(quick: bool) -> list[cs.Scene]:
    """Held-out scenes: turning commands, then the same with loads on the matrix."""
    scene = cs.load_scene(SCENE)
    duration = 150.0 if quick else 1500.0
    plan = dataclasses.replace(scene.training, duration=duration)
    scene = dataclasses.replace(scene, duration=duration, training=plan)
    n = 1 if quick else 3
    plain = cs.turning_scenes(scene, n, seed=9001, scatter=3.0, label="held out")
    return plain + cs.turning_scenes(
        scene, n, seed=9002, loaded=True, scatter=3.0, label="held out"
    )


def relative(field, q: np.ndarray, truth: np.ndarray) -> float:
    """Rms error of nodal displacements over rms displacement, whole run."""
    return float(np.linalg.norm(field.displacement(q) - truth) / np.linalg.norm(truth))


def main(quick: bool = False, out: str | None = None) -> None:
    planned = scenes(quick)
    system = cs.build(planned[0])
    orders = (50, 100) if quick else (50, 100, 200, 400)
    began = time.process_time()
    answers = {"places": 40, "per_place": 4} if quick else {}
    field = cs.GalerkinField(system=system, order=orders[-1], **answers)
    print(f"modes: q = {field.order}, built in {time.process_time() - began:.1f} s")
    on_linear = cs.GalerkinField(system=system, order=orders[-1], linear=True, **answers)

    sample, top, middle = planned[0].sample, orders[-1], orders[-2]
    setups = [(f"nonlinear q={q}", field.truncated(q), 1) for q in orders]
    setups += [
        (f"nonlinear q={middle}, 10 s", field.truncated(middle), 2),
        (
            f"nonlinear q={top}, linear modes",
            cs.GalerkinField(system=system, modes=on_linear.modes),
            1,
        ),
        (f"linear q={middle}", on_linear.truncated(middle), 1),
        ("linear full", cs.full_field(system, linear=True), 1),
        ("nonlinear full", cs.full_field(system), 1),
        ("nonlinear full, 10 s", cs.full_field(system), 2),
    ]
    rows: dict[str, list] = {name: [] for name, _, _ in setups}
    balance = []
    for scene in planned:
        run = cs.run_scene(scene)
        truth = run.block("matrix.displacement")
        loads = field.loads(run, "end")
        for name, model, stride in setups:
            projected = model.project(loads[stride - 1 :: stride])
            began = time.process_time()
            done = model.simulate(projected, sample * stride)
            spent = time.process_time() - began
            balance.append(done.statistics["least_balance"])
            floor = relative(model, model.project(truth), truth)
            rows[name].append((relative(model, done.x, truth[::stride]), floor, spent))

    heads = ["turning" if "loaded" not in s.name else "loaded" for s in planned]
    print(f"\n{'field error from true loads':32s}" + "".join(f"{h:>9s}" for h in heads)
          + f"{'floor':>9s}{'time':>9s}")  # fmt: skip
    for name, found in rows.items():
        errors = "".join(f"{error:9.3f}" for error, _, _ in found)
        floor, spent = np.mean([f for _, f, _ in found]), np.mean([s for _, _, s in found])
        print(f"{name:32s}{errors}{floor:9.3f}{spent:8.2f}s")
    print(f"\ntime: processor time of {planned[0].duration:g} s of field, steps of {sample:g} s")
    print(f"least work - gain over all steps: {min(balance):.3g} pN um")
    print(f"at rest, {field.passivity(sample)}")
    half = field.truncated(middle)
    end = half.simulate(loads, sample).x[-1]
    print(f"at the end of the last run, {half.passivity(sample, at=end)}")
    if out:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "field_truth.csv").open("w") as file:
            file.write("model,run,error,floor,seconds\n")
            for name, found in rows.items():
                for head, values in zip(heads, found, strict=True):
                    file.write(",".join([name.replace(",", ""), head, *map(str, values)]) + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out")
    arguments = parser.parse_args()
    main(arguments.quick, arguments.out)
