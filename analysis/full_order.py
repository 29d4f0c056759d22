"""Is the full-order model accurate at its shipped step, insensitive to its start, fast?

    python analysis/full_order.py [--quick]

Prints: wall time of 3000 s, error against explicit Euler after 100 s, step residual, effect of a
5 nm and a 100 nm shift of the start for both adhesion kinetics, magnitudes.
"""

import argparse
import dataclasses
import os
import time
from pathlib import Path

# As the command line does: vectors here are short, a second BLAS thread costs time.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import cellsys as cs

SCENE = Path(__file__).parents[1] / "examples" / "spreading.toml"
ARRAYS = ("cell1.position", "matrix.displacement")


def open_loop(shift: float = 0.0, kinetics: str = "clutch", duration: float = 1500.0) -> cs.Scene:
    """One cell on a homogeneous disc, constant heading, started `shift` um beside the centre."""
    scene = cs.load_scene(SCENE)
    effects = {k: v for k, v in scene.effects.items() if k != "polarity"}
    effects["focal_adhesion"] = dataclasses.replace(effects["focal_adhesion"], kinetics=kinetics)
    if kinetics == "switching":  # clusters carry no reaction of the lamellipodium
        effects["lamellipodium"] = dataclasses.replace(effects["lamellipodium"], reaction="none")
    return dataclasses.replace(
        scene,
        duration=duration,
        effects=effects,
        cells=(dataclasses.replace(scene.cells[0], position=(shift, 0.0)),),
        matrix=dataclasses.replace(scene.matrix, inclusion=None),
        commands=cs.Commands(cs.History((0.0,), (np.pi / 2,))),
    )


def change(run: cs.Trajectory, base: cs.Trajectory, name: str) -> float:
    """Rms difference over rms displacement."""
    x, y = run.block(name), base.block(name)
    return float(np.linalg.norm(x - y) / np.linalg.norm(y - y[0]))


def main(quick: bool = False) -> None:
    long, window, whole = (60.0, 10.0, 60.0) if quick else (3000.0, 100.0, 1500.0)
    system = cs.build(open_loop())
    t = np.arange(0.0, window + 1.0, 5.0)
    cs.simulate(system, cs.LinearlyImplicit(step=0.5), t[:2])  # compile

    began = time.perf_counter()
    cs.run_scene(open_loop(duration=long))
    print(f"full-order run of {long:g} s: {time.perf_counter() - began:.1f} s of wall time")

    limit = cs.stability_limit(system)
    reference = cs.simulate(system, cs.ExplicitEuler(step=limit / 2), t, auxiliaries=False)
    print(f"explicit Euler: stable below {1e3 * limit:.1f} ms; reference at half of it")
    for step in (1.0, 0.5, 0.25):
        run = cs.simulate(system, cs.LinearlyImplicit(step=step), t)
        error = [
            1e3 * np.sqrt(((run.block(n)[-1] - reference.block(n)[-1]) ** 2).sum(1).mean())
            for n in ARRAYS
        ]
        share = [100 * run.residual_share()[n] for n in ARRAYS]
        print(
            f"step {step:4.2f} s: after {window:g} s {error[0]:.2f} nm rms on the membrane, "
            f"{error[1]:.3f} nm on the matrix; step residual {share[0]:.2g} %, {share[1]:.2g} %"
        )

    for kinetics in ("clutch", "switching"):
        base = cs.run_scene(open_loop(kinetics=kinetics, duration=whole))
        for shift in (0.005, 0.1):
            run = cs.run_scene(open_loop(shift, kinetics, whole))
            print(
                f"{kinetics}: a {1e3 * shift:g} nm shift of the start changes the run by "
                f"{change(run, base, ARRAYS[0]):.2g} (cell), {change(run, base, ARRAYS[1]):.2g} "
                f"(matrix) over {whole:g} s; {len(base.events)} events"
            )
        if kinetics == "clutch":
            for name, value in cs.summary_of_run(base, system.matrix.position).items():
                print(f"  {name.replace('_', ' ')}: {value:.3g}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
