"""Equivariant cells on one field as a diagram of python-control, step for step that of a run.

Headings leap: what is kept of a cell is its heading g half a step ago,

    e = sensed(cells, field, g)     p = g turned by dt/2 towards e
    d = sensed(cells, field, p)     h = p turned by dt/2 towards d     g+ = h
    cells+, field+ = step(cells, field, h)

so that the step of cells and field is asked for once.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from cellsys.loop import PolarityLaw
from cellsys.model.sensor_block import latent_names, vector_names
from cellsys.population.headings import turn
from cellsys.population.ported.equivariant_system import EquivariantSystem
from cellsys.population.signals import cell_prefixes
from cellsys.ports.capabilities import FieldReader
from cellsys.state_space import block, joined

if TYPE_CHECKING:
    from control import InterconnectedSystem, NonlinearIOSystem


def leaping_start(system: EquivariantSystem, law: PolarityLaw) -> np.ndarray:
    """State of the diagram at contact: cells, field, its velocity, headings half a step before."""
    state, p = system.unpack(system.x0)
    before = turn(law, p, system.sensed(state, p), -0.5 * system.dt)
    return np.concatenate([system.whole.pack(state), before.ravel()])


def field_diagram(system: EquivariantSystem, law: PolarityLaw) -> InterconnectedSystem:
    """Cells with their field, controllers and sensors; outputs z, field, p and d."""
    K, dt, whole = system.n_cells, system.dt, system.whole
    each, n = cell_prefixes(K), int(whole.field.order)
    size = K * whole.model.order
    z, q = latent_names(whole.model.order, each), [f"field_q[{i}]" for i in range(n)]
    memory, ones = whole.field.memory(), np.ones(K)

    def moved(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
        h = u.reshape(K, 3)
        angle = np.arctan2(h[:, 1], h[:, 0])
        return whole.pack(whole.step(whole.unpack(x, K), ones, angle, t, memory)[0])

    def shown(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
        return x[: size + n]

    def sensor(name: str, heading: str, sensed: str) -> NonlinearIOSystem:
        def read(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
            state = whole.unpack(np.concatenate([u[: size + n], np.zeros(n)]), K)
            p = u[size + n :].reshape(K, 3)
            # python-control asks once with nothing connected: no heading, nothing sensed.
            if not np.all(np.hypot(p[:, 0], p[:, 1]) > 0):
                return np.zeros(3 * K)
            return system.sensed(state, p).ravel()

        return block(name, [*z, *q, *vector_names(heading, each)], vector_names(sensed, each), read)

    def half(name: str, heading: str, sensed: str, out: str) -> NonlinearIOSystem:
        def turned(
            t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]
        ) -> np.ndarray:
            p, d = u.reshape(2, K, 3)
            return turn(law, p, d, 0.5 * dt).ravel()

        inputs = [*vector_names(heading, each), *vector_names(sensed, each)]
        return block(name, inputs, vector_names(out, each), turned)

    def kept(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
        return u

    rates = [f"field_rate[{i}]" for i in range(n)]
    g = vector_names("p_before", each)
    # A sensor of the cell's own state does not look at p.
    ahead = "d" if isinstance(system.sensor, FieldReader) else "d_ahead"
    second = [sensor("sensor", "p", "d")] if ahead == "d" else []
    parts = [
        block(
            "plant", vector_names("p_drive", each), [*z, *q], shown,
            states=[*z, *q, *rates], update=moved, dt=dt,
        ),
        block(
            "heading", vector_names("p_drive", each), g, None, states=g, update=kept, dt=dt
        ),
        sensor("sensor_ahead", "p_before", "d_ahead"),
        half("turn", "p_before", "d_ahead", "p"),
        *second,
        half("turn_on", "p", ahead, "p_drive"),
    ]  # fmt: skip
    seen = vector_names(ahead, each)
    return joined("loop", parts, [*z, *q, *vector_names("p", each), *seen])
