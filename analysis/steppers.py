"""What does a second of each stepper buy, on every class of scene?

    python analysis/steppers.py [--quick] [--classes]

Prints, for the shipped scene (cells on a disc, closed loop, 1500 s) in one run: processor time,
rms error of the nodes' coordinates at 100, 300 and 1500 s against RKC at 1e-6 (itself held against
DOP853 at 1e-8 over 50 s), the step residual after 50 s, right-hand sides and factorisations of
LinearlyImplicit, BDF2 and RKC; the factorisations of a step that no binary fraction divides. With
--classes: the same at the end of short runs of every class of scene, from which
stepper = "auto" takes its choice.
"""

import argparse
import dataclasses
import os
import time
from collections.abc import Callable

# As the command line does: vectors here are short, a second BLAS thread costs time.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import cellsys as cs

AFTER = 50.0  # s: what the residual is counted after; before, the cell falls onto the matrix
METHODS = {
    "LinearlyImplicit 0.5 s": cs.LinearlyImplicit(step=0.5),
    "BDF2 1.25 s": cs.BDF2(step=1.25),
    "BDF2 1 s": cs.BDF2(step=1.0),
    "RKC 1e-2": cs.RKC(rtol=1e-2, atol=1e-2),
}
CLASSES = ("spreading", "two_cells", "isolated_membrane", "passive_matrix", "stretched_matrix")


def distance(system: cs.OdeSystem, x: np.ndarray, reference: np.ndarray) -> str:
    """Rms of the coordinates' errors of every kind of node, nm: membranes/matrix."""
    kinds: dict[str, list[np.ndarray]] = {"position": [], "displacement": []}
    for block in system.states:
        kind = block.name.rpartition(".")[2]
        if kind in kinds:
            piece = system.states.slice(block.name)
            kinds[kind].append(x[piece] - reference[piece])
    found = [np.concatenate(gaps) for gaps in kinds.values() if gaps]
    return "/".join(f"{1e3 * np.sqrt((gap**2).mean()):.3f}" for gap in found)


def share_after(run: cs.Trajectory, start: float) -> str:
    """Step residual over the rate after `start` s, percent, of every block of nodes."""
    k = int(np.searchsorted(run.t, start))
    residual, rate = run.auxiliary("step_residual"), np.diff(run.x, axis=0)
    residual, rate = residual[k:], rate[k:] / np.diff(run.t)[k:, None]
    out = []
    for block in run.states:
        if block.kind == "position" and len(rate):
            piece = run.states.slice(block.name)
            size = float(np.linalg.norm(rate[:, piece]))
            out.append(100 * float(np.linalg.norm(residual[:, piece])) / size if size else 0.0)
    return ", ".join(f"{share:.2g} %" for share in out)


def timed(work: Callable[[], cs.Trajectory]) -> tuple[float, cs.Trajectory]:
    """Processor time, s, and what came out."""
    began = time.process_time()
    found = work()
    return time.process_time() - began, found


def compare(name: str, duration: float, marks: tuple[float, ...], repeats: int) -> None:
    """Every method on one scene, in turns; the shortest time of each counts."""
    scene = cs.load_scene(name)
    system, t = cs.build(scene), np.arange(0.0, duration + 1.0, 5.0)
    reference = cs.simulate(system, cs.RKC(rtol=1e-6, atol=1e-7), t, auxiliaries=False)
    rows = [int(np.searchsorted(t, mark)) for mark in marks if mark <= duration]
    print(f"\n{name}, {duration:g} s; errors, nm, at {', '.join(f'{t[k]:g}' for k in rows)} s")
    for method in METHODS.values():
        cs.simulate(system, method, t[:3])  # compile
    spent = dict.fromkeys(METHODS, np.inf)
    runs = {}
    for _ in range(repeats):
        for label, method in METHODS.items():
            seconds, runs[label] = timed(lambda m=method: cs.simulate(system, m, t))
            spent[label] = min(spent[label], seconds)
    first = spent["LinearlyImplicit 0.5 s"]
    for label, run in runs.items():
        errors = ", ".join(distance(system, run.x[k], reference.x[k]) for k in rows)
        counts = run.statistics
        print(
            f"{label:22s} {spent[label]:6.2f} s ({spent[label] / first:.2f}); {errors}; residual "
            f"{share_after(run, min(AFTER, 0.5 * duration))}; {counts['rhs']} right-hand sides, "
            f"{counts['factorisations']} factorisations"
        )


def confirm(duration: float) -> None:
    """The reference against a method that shares nothing with it."""
    system = cs.build(cs.load_scene("spreading"))
    t = np.array([0.0, duration])
    a, b = (
        cs.simulate(system, method, t, auxiliaries=False).x[-1]
        for method in (cs.RKC(rtol=1e-6, atol=1e-7), cs.DOP853(rtol=1e-8, atol=1e-8))
    )
    print(f"reference against DOP853 after {duration:g} s: {distance(system, a, b)} nm")


def uneven(duration: float) -> None:
    """A step of 5/3 s: its length differs from step to step by rounding."""
    system, t = cs.build(cs.load_scene("spreading")), np.arange(0.0, duration + 1.0, 5.0)
    for method in (cs.LinearlyImplicit(step=5 / 3), cs.BDF2(step=5 / 3)):
        counts = cs.simulate(system, method, t).statistics
        print(
            f"{type(method).__name__} 5/3 s, {duration:g} s: {counts['steps']} steps, "
            f"{counts['factorisations']} factorisations"
        )


def main(quick: bool, classes: bool) -> None:
    if classes:
        for name in CLASSES:
            spread = dataclasses.replace(cs.load_scene(name), stepper="auto")
            compare(name, 10.0 if quick else 100.0, (20.0, 100.0), 1 if quick else 2)
            print(f"stepper = {spread.stepper!r}: {spread.matrix_kind.method(spread)}")
        return
    confirm(5.0 if quick else 50.0)
    compare("spreading", 20.0 if quick else 1500.0, (20.0, 100.0, 300.0, 1500.0), 1 if quick else 2)
    uneven(10.0 if quick else 300.0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--classes", action="store_true")
    given = parser.parse_args()
    main(given.quick, given.classes)
