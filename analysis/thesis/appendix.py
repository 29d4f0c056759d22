"""The thesis's data path [A.1-A.3] on a recorded run, and what three slips of its code do.

    python analysis/thesis/appendix.py [--quick]

A short run of a small cell is written as recorded files (A.1) and read as those of another program
are: columns of forces alone. From them A.2 makes residuals, states and auxiliaries, integrates
them again, and fits rates on principal components; A.3 turns the polarity to the sensed direction.
Each slip is named, made on purpose, and held against the right form on the same data.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import scipy.linalg as sla

import cellsys as cs

C_CELL, C_MATRIX = 2e3, 1e3  # C_c + C_cort and C_e, pN s/um
KAPPA = 1 / 60  # 1/s [thesis 72]
SCENE = {
    "name": "small cell", "duration": "120 s", "sample": "1 s", "seed": 7,
    "matrix": {"diameter": "40 um", "nodes": 300},
    "cells": [{"position": ["0 um", "0 um"], "polarity": "60 deg", "radius": "5 um"}],
    "effects": {
        "drag": {}, "membrane_elasticity": {}, "volume": {}, "cortical_tension": {},
        "focal_adhesion": {"kinetics": "clutch"}, "lamellipodium": {"force": "600 pN"},
        "substrate_contact": {}, "matrix_elasticity": {}, "stiffness_sensing": {},
        "polarity": {"kappa": "1/60 1/s"},
    },
}  # fmt: skip


def recorded(duration: float) -> cs.Trajectory:
    """A run through its files, described by their columns alone."""
    run = cs.run_scene(cs.Scene.parse({**SCENE, "duration": f"{duration:g} s"}))
    with tempfile.TemporaryDirectory() as folder:
        files = cs.write_recorded(run, Path(folder) / "Data", digits=12)
        (files / "cellsys.json").unlink()
        return cs.recorded_run(files)


def flat(values: np.ndarray) -> np.ndarray:
    return values.reshape(len(values), -1)


def integrated(x: np.ndarray, force: np.ndarray, drag: float, dt: float) -> float:
    """Miss of x_k+1 = x_k + dt F_k/C at the end, over the distance moved."""
    again = x[0] + dt * np.cumsum(force, axis=0) / drag
    moved = np.linalg.norm(x[-1] - x[0])
    return float(np.linalg.norm(again[-1] - x[-1]) / moved)


def residual(x: np.ndarray, total: np.ndarray, drag: float, dt: float, late: bool) -> np.ndarray:
    """What forces leave over: of the step that follows, or [v_0; diff(x)] as A.2 has it."""
    rate = np.diff(x, axis=0) / dt
    if late:
        rate = np.vstack([rate[:1], rate[:-1]])
    return drag * rate - total


def rates_missed(x_star: np.ndarray, rates: np.ndarray, true: np.ndarray, order: int) -> float:
    """Rms of (fitted - true) rates over that of the true ones, fitted on principal components."""
    centred = x_star - x_star.mean(axis=0)
    centred = centred / np.maximum(np.sqrt((centred**2).mean()), 1e-300)
    z = centred @ sla.svd(centred, full_matrices=False)[2][:order].T
    ones = np.column_stack([np.ones(len(z)), z])
    fitted = ones @ sla.lstsq(ones, rates)[0]
    return float(np.linalg.norm(fitted - true) / np.linalg.norm(true))


def polarity_missed(p: np.ndarray, d: np.ndarray, dt: float, literal: bool) -> float:
    """Largest angle, deg, between the recorded polarity and that turned to d.

    As A.3 turns it, by Euler steps to the unit vector along d; or by the law of the run, whose cue
    has a strength, by exact steps.
    """
    law, q, worst = cs.PolarityLaw(kappa=KAPPA), p[0], 0.0
    for k in range(len(p) - 1):
        if not literal:
            q = law.step(q, d[k], dt)
        else:
            n = d[k] / np.linalg.norm(d[k])
            q = q + dt * law.rate(q, n)
            q = q / np.linalg.norm(q)
        cosine = np.clip(q @ p[k + 1] / np.linalg.norm(p[k + 1]), -1, 1)
        worst = max(worst, float(np.degrees(np.arccos(cosine))))
    return worst


def main(quick: bool = False) -> dict[str, tuple[float, float]]:
    run = recorded(30.0 if quick else 120.0)
    dt = float(run.t[1] - run.t[0])
    x, u = flat(run.block("cell1.position")), flat(run.block("matrix.displacement"))
    force = {
        b.name: flat(run.auxiliary(b.name)) for b in run.auxiliaries if b.name != "step_residual"
    }
    cell = sum(f for name, f in force.items() if name.startswith("cell1."))
    adhesion, elastic = force["matrix.focal_adhesion"], force["matrix.matrix_elasticity"]
    matrix = adhesion + elastic
    found = {}

    print(run)
    print(f"closure: {run.source['closure_share']:.2g} of the rates")
    late, right = (residual(x, cell, C_CELL, dt, late) for late in (True, False))
    found["backward velocities in a forward step"] = tuple(
        integrated(x, cell + r, C_CELL, dt) for r in (late, right)
    )
    wrong, right = (residual(u, matrix, drag, dt, False) for drag in (C_CELL, C_MATRIX))
    found["drag of the cell in the residual of the matrix"] = tuple(
        integrated(u, matrix + r, C_MATRIX, dt) for r in (wrong, right)
    )
    loads = np.hstack([cell / C_CELL, adhesion / C_MATRIX, (elastic + right) / C_MATRIX])
    x_star = np.hstack([x[:-2], u[:-2], loads[:-1]])
    adhesion_rate, elastic_rate = (
        np.diff(f, axis=0) / dt / C_MATRIX for f in (adhesion, elastic + right)
    )
    found["adhesion differenced in place of elasticity"] = tuple(
        rates_missed(x_star, rates, elastic_rate, 10) for rates in (adhesion_rate, elastic_rate)
    )
    for name, (slip, kept) in found.items():
        print(f"{name}: off by {slip:.3g} of the motion or rate, the right form by {kept:.2g}")
    p, d = run.polarities[:, 0], np.asarray(run.d)[:, 0]
    turned = [polarity_missed(p, d, dt, literal) for literal in (True, False)]
    print(
        f"polarity turned to d: largest angle to the recorded one {turned[0]:.3g} deg as in A.3, "
        f"which makes d a unit vector (here its length is {np.linalg.norm(d, axis=1).mean():.2g}), "
        f"{turned[1]:.2g} deg by the law of the run"
    )
    z = np.column_stack([np.ones(len(x) - 1), (x - x.mean(axis=0))[:-1] @ sla.svd(
        x - x.mean(axis=0), full_matrices=False)[2][:6].T])  # fmt: skip
    n = d[:-1] / np.linalg.norm(d[:-1], axis=1)[:, None]
    left = n - z @ sla.lstsq(z, n)[0]
    share = float((left**2).sum() / ((n - n.mean(axis=0)) ** 2).sum())
    print(f"direction regressed on six components (A.3): {100 * (1 - share):.0f} % explained")
    model = cs.reduce(cs.snapshots([run]), order=6, method=cs.PCR())
    print(model)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
