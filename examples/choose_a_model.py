"""Which reduced model to use: reductors side by side, then the choice, then what it is worth.

python examples/choose_a_model.py [--quick]
"""

import argparse

import numpy as np

import cellsys as cs

N = 24


def run(seed: int, samples: int) -> cs.RunData:
    """A chain that is pulled along by a heading which turns, on springs that give way."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(0.1 * rng.standard_normal(samples - 1)) + rng.uniform(0, 2 * np.pi)
    commands = np.column_stack([np.cos(heading), np.sin(heading)])
    x = np.zeros((samples, 2 * N))
    pull = np.exp(-np.arange(N) / 6.0)
    for k in range(samples - 1):
        for axis in range(2):
            q = x[k, axis * N : (axis + 1) * N]
            stretch = np.diff(q, prepend=q[0], append=0.0)
            force = np.tanh(stretch) + 0.02 * rng.standard_normal(N + 1)
            x[k + 1, axis * N : (axis + 1) * N] = q + 0.2 * (
                np.diff(force) + 1.2 * pull * commands[k, axis]
            )
    return cs.RunData(x=x, commands=commands, label=f"run {seed}")


def main(quick: bool = False) -> None:
    count, samples = (6, 120) if quick else (12, 300)
    runs = [run(seed, samples) for seed in range(count + 3)]
    train, test = cs.snapshots(runs[:count], dt=5.0), cs.snapshots(runs[count:], dt=5.0)

    methods = [cs.LeastSquares(), cs.Ridge(), cs.Contractive(iterations=100)]
    print(cs.compare_reductors(train, test, [4, 12], methods), "\n")

    methods += cs.candidates(cs.Ridge(), {"ridge": [0.01, 0.1], "step": [5.0, 20.0]})
    chosen = cs.select_model(train, methods, [4, 8, 12], folds=3, inner=2)
    print(chosen, "\n")
    print(cs.learning_curve(train, test, chosen.method, chosen.order, draws=2), "\n")
    print(cs.reduce(train, order=chosen.order, method=chosen.method, test=test).card.verdict)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
