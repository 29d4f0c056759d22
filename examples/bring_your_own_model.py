"""Your own system of equations to a reduced model and its poles.

A chain of six masses with cubic springs and a pushed end: dx/dt = W_x x + W_eta eta(x) + u.
"""

import argparse

import numpy as np

import cellsys as cs

N = 6


def chain(push: float) -> cs.OdeSystem:
    """Positions q, velocities v; spring forces are the auxiliaries."""

    def springs(t, x):
        stretch = [x[0]] + [x[i] - x[i - 1] for i in range(1, N)]
        return [s + 0.3 * s * s * s for s in stretch]

    W_x, W_eta, u = np.zeros((2 * N, 2 * N)), np.zeros((2 * N, N)), np.zeros(2 * N)
    W_x[:N, N:] = np.eye(N)
    W_x[N:, N:] = -0.4 * np.eye(N)
    W_eta[N:] = -np.eye(N) + np.eye(N, k=1)
    u[-1] = push
    return cs.OdeSystem(
        states=[f"q{i}" for i in range(N)] + [f"v{i}" for i in range(N)],
        auxiliaries=[f"spring{i}" for i in range(N)],
        x0=np.zeros(2 * N),
        W_x=W_x,
        W_eta=W_eta,
        law=springs,
        forcing=lambda t, x: u,
    )


def main(quick: bool = False) -> cs.LatentModel:
    t = np.arange(0.0, 20.0 if quick else 60.0, 0.05)
    method = cs.CVODES(rtol=1e-9, atol=1e-11)
    runs = [cs.simulate(chain(push), method, t) for push in (-0.4, -0.2, 0.1, 0.3)]
    model = cs.reduce(cs.snapshots(runs, scale="none"), order=8, method=cs.LeastSquares())
    print(model)
    plant = model.plant()
    print(cs.poles(plant))
    print(cs.stability(plant).verdict)
    return model


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
