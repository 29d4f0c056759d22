"""A time-invariant cell whose step can be refined exactly: what stepping costs then shows alone."""

import dataclasses

import numpy as np
import scipy.linalg as sla

import cellsys as cs
from tests.cell.runs import model

POLES = (0.97, 0.9, 0.8, 0.6)
PULL = (1.0, -0.7, 0.8, 0.5)


def refined(parts=1):
    """`model` with fixed blocks and `parts` steps for one: the same answer to held inputs."""
    m = model()
    dynamics, blocks = m.dynamics, []
    for block in dynamics.blocks:
        if not block.size:
            blocks.append(block)
            continue
        A = np.diag(POLES[: block.size])
        pull = np.array(PULL)[: block.size, None]
        B = (1 - np.diag(A))[:, None] * pull * np.array([1.0, 0.5, 0.2])
        F = sla.fractional_matrix_power(A, 1 / parts)
        G = np.linalg.solve(sum(np.linalg.matrix_power(F, i) for i in range(parts)), B)
        every = [np.repeat(v[None], len(block.A), axis=0) for v in (F, G)]
        gamma = block.gamma / parts  # the port acts once a step
        blocks.append(dataclasses.replace(block, A=every[0], B=every[1], gamma=gamma))

    def read(r):
        last = [np.repeat(v[-1:], len(v), axis=0) / parts for v in (r.R_z, r.R_u)]
        return dataclasses.replace(r, R_z=last[0], R_u=last[1], R_y=r.R_y / parts)

    dynamics = dataclasses.replace(
        dynamics,
        blocks=tuple(blocks),
        dt=dynamics.dt / parts,
        alone=read(dynamics.alone),
        riding=read(dynamics.riding),
    )
    return cs.EquivariantModel(
        dynamics=dynamics,
        representation=m.representation,
        modes=m.modes,
        sites=m.sites,
        states=m.states,
        auxiliaries=m.auxiliaries,
        z_start=m.z_start,
    )


def reading(m, gain):
    """A sensor of a constant direction and the slowest state of charge 1."""
    K = np.zeros((3, 1 + m.order))
    K[:2, 0] = np.cos(0.5), np.sin(0.5)
    first = m.dynamics.starts()[1]
    K[0, 1 + first], K[1, 1 + first + m.dynamics.blocks[1].size] = gain, gain
    return cs.StiffnessSensor(K_d=K)
