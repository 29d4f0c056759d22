"""Small closed loops: a random stable latent model steered by heading features, and a sensor."""

import numpy as np

from cellsys.loop import PolarityLaw, closed_loop
from cellsys.model import LatentModel, StiffnessSensor
from tests.reduction.systems import stable_matrix

NAMES = ("cell1.cos", "cell1.sin", "cell1.cos2", "cell1.sin2")


def make(seed=0, m=5, kappa=1 / 60, normalise=True, gain=1.0, planar=True, names=NAMES, noise=0.0):
    rng = np.random.default_rng(seed)
    A = stable_matrix(m, rng, slowest=0.02, fastest=0.2)
    B, b = 0.1 * rng.standard_normal((m, len(names))), 0.02 * rng.standard_normal(m)
    K_d = rng.standard_normal((3, 1 + m))
    K_d[:, 1:] *= gain
    if planar:
        K_d[2] = 0.0
    model = LatentModel(A=A, B=B, offset=b, input_names=names)
    return closed_loop(
        model,
        controller=PolarityLaw(kappa=kappa),
        sensor=StiffnessSensor(K_d=K_d, noise=noise),
        normalise=normalise,
        z0=rng.standard_normal(m),
    )


def heading(theta):
    return np.array([np.cos(theta), np.sin(theta), 0.0])


def two_state(pole, coupling, kappa):
    """Heading 0, d = (1, 0) at rest; y of d is read from an oscillator driven by sin(theta).

    G(s) = coupling / (s^2 + 0.1 s + 1) scaled, so that every margin can be worked out.
    """
    A = np.array([[0.0, 1.0], [-(pole**2), -0.1 * pole]])
    B = np.zeros((2, 4))
    B[1, 1] = coupling * pole**2
    K_d = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    return closed_loop(
        LatentModel(A=A, B=B, input_names=NAMES),
        controller=PolarityLaw(kappa=kappa),
        sensor=StiffnessSensor(K_d=K_d),
        normalise=False,
        z0=np.zeros(2),
    )
