"""A recorded run, one text file per second and kind, to a reduced model: the thesis's data path.

The files are written here from a short run of a small cell; those of another program in the same
layout (thesis A.1) are read alike.
"""

import argparse
import tempfile
from pathlib import Path

import cellsys as cs

SCENE = {
    "name": "small cell", "duration": "30 s", "sample": "1 s", "seed": 7,
    "matrix": {"diameter": "40 um", "nodes": 300},
    "cells": [{"position": ["0 um", "0 um"], "polarity": "60 deg", "radius": "5 um"}],
    "effects": {
        "drag": {}, "membrane_elasticity": {}, "volume": {}, "cortical_tension": {},
        "focal_adhesion": {"kinetics": "clutch"}, "lamellipodium": {"force": "600 pN"},
        "substrate_contact": {}, "matrix_elasticity": {}, "stiffness_sensing": {},
        "polarity": {"kappa": "1/60 1/s"},
    },
}  # fmt: skip


def main(quick: bool = False) -> cs.LatentModel:
    scene = {**SCENE, "duration": "12 s"} if quick else SCENE
    run = cs.run_scene(cs.Scene.parse(scene))
    with tempfile.TemporaryDirectory() as folder:
        files = cs.write_recorded(run, Path(folder) / "Data", digits=9)
        print(f"{len(list(files.iterdir()))} files, such as {sorted(files.iterdir())[20].name}")
        recorded = cs.recorded_run(files)
        print(recorded)
        print(f"what the forces leave over: {recorded.source['closure_share']:.2g} of the rates")
        data = cs.read_recorded(files)
    models = [cs.reduce(d, order=4, method=cs.PCR()) for d in (cs.snapshots([run]), data)]
    print("poles from the run itself, and from its files:")
    for model in models:
        print(cs.poles(model.plant()))
    return models[1]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
