"""What do the printed forms do to the error? One table, each form beside what is used instead.

python analysis/literal_forms.py [--quick]

One full-order cell per heading on the shipped scene; a PCR model of them, its input map read off
M_pol in three ways beside the fitted harmonics, its sensor on [P_F z; P_c z] beside z itself.
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import numpy as np

import cellsys as cs

SCENE = Path(__file__).parents[1] / "examples" / "spreading.toml"
METHOD = cs.DOP853(rtol=1e-4, atol=1e-6)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main(quick: bool = False, runs: str | None = None) -> None:
    scene, order = cs.load_scene(SCENE), 10
    if quick:
        plan = dataclasses.replace(scene.training, runs=4, held_out=1, duration=60.0)
        scene, order = dataclasses.replace(scene, training=plan), 5
    with tempfile.TemporaryDirectory() as scratch:
        train, held_out = cs.training_scenes(scene)
        ran = cs.run_ensemble(train + held_out, runs or scratch)
        known, test = ran[: len(train)], ran[len(train) :]
        data = cs.snapshots(known)
        model = cs.reduce(data, order=order, method=cs.PCR())
        inputs(scene, model, test)
        sensors(model, known, test)


def inputs(scene: cs.Scene, model: cs.LatentModel, test: list[cs.Trajectory]) -> None:
    """V_x^T u of the held-out runs, full-order u against the maps."""
    rows = np.arange(model.states.size)[model.states.slice("cell1.position")]
    lamellipodium = scene.effects["lamellipodium"]
    shape = {k: getattr(lamellipodium, k) for k in ("height", "edge", "full", "downward")}
    end = np.asarray(test[0].block("cell1.position"))[-1]
    scale = np.ones(len(rows)) if model.scale is None else model.scale[rows]
    true, heads, amplitude = [], [], []
    for run in test:
        pushed = np.asarray(run.u)[:, run.states.slice("cell1.position")]
        true.append(pushed / scale @ model.V_x[rows])
        heads.append(np.asarray(run.p)[:-1, 0])
        drive = np.ones((len(run.t), 1)) if run.amplitude is None else np.asarray(run.amplitude)
        amplitude.append(drive[:-1, 0])
    u, p, a = np.concatenate(true), np.concatenate(heads), np.concatenate(amplitude)
    print(f"{'input V_x^T u, error over its size (held-out runs)':<60}")
    for lookup in ("interpolate", "nearest", "arctan"):
        table = cs.MPol.from_membrane(end, **shape, lookup=lookup)
        loop = cs.literal_loop(model, table, force=1.0, drag=1.0, rows=rows)
        found = a[:, None] * np.array([loop.push(row) for row in p])
        factor = float(np.sum(found * u) / np.sum(found**2))  # F_L / C
        print(f"  M_pol, {lookup:<50} {rms(found * factor - u) / rms(u):8.3f}")


def sensors(model: cs.LatentModel, known: list[cs.Trajectory], test: list[cs.Trajectory]) -> None:
    """Angle of the sensed direction on held-out runs."""
    latent, held = (
        [model.encode(r.x[: len(r.eta)], r.eta) for r in cs.snapshots(part).runs]
        for part in (known, test)
    )
    d = [np.asarray(r.d)[:-1, 0] for r in known]
    d_held = [np.asarray(r.d)[:-1, 0] for r in test]
    print("sensor, mean angle off the sensed direction (held-out runs)")
    maps = (cs.P_F_phi(model), cs.P_c(model))
    literal = cs.fit_sensor(latent, d, held, d_held, literal=True, maps=maps)
    ridge = cs.fit_sensor(latent, d, held, d_held)
    for name, found in (("[P_F z; P_c z], least squares [84]", literal), ("z, ridge", ridge)):
        print(f"  {name:<57} {found.held_out_error:8.1f} deg")
    print(f"  {'the best constant direction':<57} {ridge.constant_error:8.1f} deg")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--runs", help="run cache to use and fill")
    options = parser.parse_args()
    main(options.quick, options.runs)
