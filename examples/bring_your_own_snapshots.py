"""Arrays from another simulator, with named blocks, to a reduced model and a plant.

Here the "other simulator" is a rod that conducts heat, pushed at one end; only its samples are
used, as a file would give them.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import scipy.linalg as sla

import cellsys as cs

N, DT = 30, 0.5


def other_simulator(command: np.ndarray) -> np.ndarray:
    """Samples (T, N) of the rod for a command (T - 1,), exact for held commands."""
    A = 0.2 * (np.eye(N, k=1) - 2 * np.eye(N) + np.eye(N, k=-1))
    step = sla.expm(DT * A)
    push = sla.solve(A, (step - np.eye(N))[:, 0])
    x = np.zeros((len(command) + 1, N))
    for k, c in enumerate(command):
        x[k + 1] = step @ x[k] + c * push
    return x


def main(quick: bool = False) -> cs.LatentModel:
    rng = np.random.default_rng(5)
    length = 120 if quick else 600
    with tempfile.TemporaryDirectory() as folder:
        files = []
        for i in range(3):
            command = np.repeat(rng.standard_normal(length // 20), 20)
            files.append(Path(folder) / f"run{i}.npz")
            np.savez(files[-1], x=other_simulator(command), commands=command[:, None], dt=DT)
        blocks = {"component": range(10), "field": range(10, N)}
        train, test = (
            cs.snapshots(chosen, scale="none", blocks=blocks) for chosen in (files[:2], files[2:])
        )
        model = cs.reduce(train, order=6, method=cs.LeastSquares(), test=test)
    print(model)
    print(cs.poles(model.plant()))
    return model


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
