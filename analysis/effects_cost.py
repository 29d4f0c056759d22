"""Does an effect cost only what it costs itself, and what is saved by leaving one out?

    python analysis/effects_cost.py [--quick]

Prints, for a scene of each effect with what it needs, the processor time of a step, of the laws of
its effects and of the solve (factorising included), and the whole over laws and solve; then, for
the scene `spreading`, the time of a step with one effect left out over the time with all of them,
timed in turns.
"""

import argparse
import dataclasses
import time

import numpy as np

import cellsys as cs
from cellsys.scene import step_cost
from cellsys.scene.registry import EFFECTS
from cellsys.scene.variants import without

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


def alone(duration: float, repeats: int) -> None:
    """Time of a step of scenes with one effect."""
    print("one effect with what it needs, ms a step: whole = laws + solve + stepping")
    print("  strict: whole/(laws + solve); fair: with the stepping of drag alone")
    worst = {"strict": ("", 0.0), "fair": ("", 0.0)}
    for name in EFFECTS:
        scene = one_effect(name)
        empty = dataclasses.replace(scene, effects={"drag": scene.effects["drag"]})
        cost, bare = (
            step_cost(cs.build(s), 0.5, duration, repeats=repeats) for s in (scene, empty)
        )
        laws = sum(cost.laws.values())
        ratios = {
            "strict": cost.whole / (laws + cost.solve),
            "fair": cost.whole / (laws + cost.solve + bare.rest),
        }
        for kind, ratio in ratios.items():
            worst[kind] = max(worst[kind], (name, ratio), key=lambda item: item[1])
        parts = " + ".join(f"{1e3 * seconds:6.3f}" for seconds in (laws, cost.solve, cost.rest))
        print(
            f"  {name:20s} {1e3 * cost.whole:7.3f} = {parts}   "
            f"strict {ratios['strict']:5.2f}   fair {ratios['fair']:5.2f}"
        )
    for kind, (name, ratio) in worst.items():
        print(f"greatest {kind} ratio: {ratio:.2f} ({name}); asked for: <= 1.3")


def left_out(duration: float, repeats: int) -> None:
    """Time of a step of `spreading` without each of its effects, over the time with all."""
    scene = cs.load_scene("spreading")
    systems = {"nothing": cs.build(scene)}
    for name in scene.effects:
        if name != "drag":
            systems[name] = cs.build(without(scene, name)[0])
    method = cs.LinearlyImplicit(step=scene.step)
    t = np.array([0.0, 2.0 * duration])
    start = {n: cs.simulate(s, method, t, auxiliaries=False).x[-1] for n, s in systems.items()}
    best, work = dict.fromkeys(systems, np.inf), {}
    t = t[1] + np.array([0.0, duration])
    for _ in range(repeats):  # in turns: other load disturbs all alike, and the least counts
        for name, system in systems.items():
            began = time.process_time()
            run = cs.simulate(system, method, t, start[name], auxiliaries=False)
            counts = run.statistics
            best[name] = min(best[name], (time.process_time() - began) / counts["steps"])
            work[name] = counts["rhs"] / counts["steps"]
    print("spreading without an effect: time of a step over that with all, evaluations a step")
    for name, whole in best.items():
        print(f"  {name:20s} {whole / best['nothing']:5.2f}   {work[name]:5.2f}")
    slower = [n for n, whole in best.items() if whole > 1.05 * best["nothing"]]
    print(f"slower by more than 5 %: {', '.join(slower) or 'none'}")


def main(quick: bool = False) -> None:
    """Both questions."""
    alone(*((2.0, 1) if quick else (20.0, 5)))
    left_out(*((2.0, 1) if quick else (20.0, 25)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
