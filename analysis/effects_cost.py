"""Does an effect cost only what it costs itself, and what is saved by leaving one out?

    python analysis/effects_cost.py [--quick]

Prints, for a scene of each effect with what it needs, the processor time of a step, of the laws of
its effects and of the solve, and the whole over laws and solve; then, for shipped scenes and for
two that hold every further effect, the time of a step with one effect left out over the time with
all of them, timed in turns, at one evaluation of the laws a step and as the scene runs. The solve
is: summing the bounds of the tangent and factorising the sum (looked at every 30 steps), and
solving with the factors and the rank-one terms. The whole is measured without any stopwatch inside.
"""

import argparse
import dataclasses
import time

import numpy as np

import cellsys as cs
from cellsys.scene import StepCost, step_cost
from cellsys.scene.registry import EFFECTS
from cellsys.scene.variants import without

SCENES = (
    "spreading", "stochastic_spreading", "two_cells", "passive_matrix", "stretched_matrix",
    "isolated_membrane",
)  # fmt: skip
NOISE = 0.05  # of the least of several times, from one try to another on a shared machine
CELLS = ({"position": ["-9 um", "0 um"]}, {"position": ["9 um", "0 um"]})


def needed(name: str) -> list[str]:
    """The effect, the drag, and all that it needs."""
    found = ["drag"]
    for need in EFFECTS[name].needs:
        found += needed(need.partition("|")[0])
    return [*found, name]


def one_effect(name: str) -> cs.Scene:
    """A disc of 2000 nodes, two cells on it where the effect acts on cells."""
    names = needed(name)
    kinds = {EFFECTS[n].acts_on for n in names}
    on_cells = bool({"cell", "cells"} & kinds) or name in ("drag", "noise")
    table = {
        "name": name, "duration": "20 s", "effects": {n: {} for n in names},
        "cells": list(CELLS) if on_cells else [],
    }  # fmt: skip
    if "matrix" in kinds or not on_cells:
        table["matrix"] = {"diameter": "60 um", "modulus": "5 kPa"}
    return cs.Scene.parse(table)


def ratio_of(cost: StepCost, stepping: float = 0.0) -> float:
    """Time of a step over its laws, its solve and `stepping`."""
    return cost.whole / (sum(cost.laws.values()) + cost.solve + stepping)


def alone(duration: float, repeats: int) -> None:
    """Time of a step of scenes with one effect."""
    print("one effect with what it needs, ms a step: whole = laws + solve + stepping")
    print("  strict: whole/(laws + solve); floor: the stepping of the same nodes under drag alone;")
    print("  fair: whole/(laws + solve + floor)")
    strict, fair, floors = {}, {}, []
    for name in EFFECTS:
        scene = one_effect(name)
        empty = dataclasses.replace(scene, effects={"drag": scene.effects["drag"]})
        cost, bare = (
            step_cost(cs.build(s), scene.step, duration, repeats=repeats) for s in (scene, empty)
        )
        strict[name], fair[name] = ratio_of(cost), ratio_of(cost, bare.rest)
        floors.append(bare.rest)
        laws, solve, rest, floor = (
            f"{1e3 * seconds:6.3f}"
            for seconds in (sum(cost.laws.values()), cost.solve, cost.rest, bare.rest)
        )
        print(
            f"  {name:20s} {1e3 * cost.whole:7.3f} = {laws} + {solve} + {rest}   "
            f"strict {strict[name]:5.2f}   floor {floor}   fair {fair[name]:5.2f}"
        )
    for kind, ratios in (("strict", strict), ("fair", fair)):
        name = max(ratios, key=ratios.__getitem__)
        above = [n for n, ratio in ratios.items() if ratio > 1.3]
        print(
            f"greatest {kind} ratio: {ratios[name]:.2f} ({name}); above the 1.3 asked for: "
            f"{', '.join(above) or 'none'}"
        )
    print(
        f"the floor, {1e3 * min(floors):.3f} to {1e3 * max(floors):.3f} ms, is some thirty passes "
        "of numpy over the state and as many calls"
    )


def left_out(scene: cs.Scene, duration: float, repeats: int) -> list[str]:
    """Time of a step without each effect over that with all; names of those that are slower.

    Slower is judged at one evaluation of the laws a step, which is what an effect costs. The time
    of the run itself stands beside it: without an effect the cell moves otherwise, and may need
    more corrections or fewer. It also comes to another state, which costs what it costs (without
    tension a cell binds more); from the same state the missing force would be a shock.
    """
    systems = {"nothing": cs.build(scene)}
    for name in scene.effects:
        if name != "drag":
            systems[name] = cs.build(without(scene, name)[0])
    as_run = cs.LinearlyImplicit(step=scene.step)
    methods = {"one": dataclasses.replace(as_run, corrections=1), "run": as_run}
    t = np.array([0.0, 2.0 * duration])
    start = {n: cs.simulate(s, as_run, t, auxiliaries=False).x[-1] for n, s in systems.items()}
    best = {kind: dict.fromkeys(systems, np.inf) for kind in methods}
    work, t = {}, t[1] + np.array([0.0, duration])

    def measure(names: list[str]) -> list[str]:
        """In turns: other load disturbs all alike, and the least counts."""
        for _ in range(repeats):
            for name in names:
                for kind, method in methods.items():
                    began = time.process_time()
                    run = cs.simulate(systems[name], method, t, start[name], auxiliaries=False)
                    counts = run.statistics
                    took = (time.process_time() - began) / counts["steps"]
                    best[kind][name] = min(best[kind][name], took)
                work[name] = counts["rhs"] / counts["steps"]
        one = best["one"]
        return [n for n, took in one.items() if took > (1.0 + NOISE) * one["nothing"]]

    slower = measure(list(systems))
    if slower:  # once more, before it is believed
        slower = measure(["nothing", *slower])
    print(f"{scene.name} without an effect: time of a step over that with all, at one evaluation")
    print("  of the laws a step; as the scene runs; evaluations a step then")
    for name in systems:
        one, run = (best[kind][name] / best[kind]["nothing"] for kind in ("one", "run"))
        print(f"  {name:20s} {one:5.2f}   {run:5.2f}   {work[name]:5.2f}")
    return slower


def extras() -> list[cs.Scene]:
    """Two cells on the disc of `spreading` with every further effect, and with the other kinds."""
    scene = cs.load_scene("spreading")
    near = tuple(
        dataclasses.replace(scene.cells[0], position=(x, 0.0), polarity=0.0) for x in (-9.0, 9.0)
    )
    others = {"cortical_tension": "cortex", "focal_adhesion": "stochastic_adhesion"}
    known = (*scene.effects, *others.values())
    further = {n: kind() for n, kind in EFFECTS.items() if n not in known}
    other = {others.get(n, n): EFFECTS[others[n]]() if n in others else e
             for n, e in scene.effects.items()}  # fmt: skip
    return [
        dataclasses.replace(scene, name="every further effect", cells=near,
                            effects={**scene.effects, **further}),
        dataclasses.replace(scene, name="cortex and stochastic adhesion", cells=near,
                            step=0.25, effects=other),
    ]  # fmt: skip


def main(quick: bool = False) -> None:
    """Both questions."""
    alone(*((2.0, 1) if quick else (30.0, 9)))
    scenes = [cs.load_scene(name) for name in (SCENES[:1] if quick else SCENES)]
    scenes += [] if quick else extras()
    slower = {s.name: left_out(s, *((2.0, 1) if quick else (20.0, 6))) for s in scenes}
    found = [f"{n} ({scene})" for scene, names in slower.items() for n in names]
    print(f"slower by more than {100 * NOISE:g} %, measured twice: {', '.join(found) or 'none'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
