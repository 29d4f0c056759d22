"""Polarity of many cells at once: commands, sensed directions and exact steps, row by row."""

from __future__ import annotations

import numpy as np

from cellsys.errors import ParameterError
from cellsys.laws.polarity import exact_steps, rate
from cellsys.laws.sensing import cue_rows
from cellsys.loop import AntiparallelStay, ClosedLoop, PolarityLaw, closed_loop
from cellsys.model import LatentModel, StiffnessSensor

_FEATURES = ("amplitude", "cos", "sin", "cos2", "sin2")


def loop_of(
    model: LatentModel,
    controller: PolarityLaw | None,
    sensor: StiffnessSensor | None,
    normalise: bool,
    headings: np.ndarray | None = None,
) -> ClosedLoop | None:
    """The polarity loop of one cell, or None for a model without heading features or sensor.

    Raises
    ------
    ParameterError
        When a controller, a sensor or headings are given, or normalise=False, and the model has
        no loop that could use it.
    """
    names = [n.split(".")[-1] for n in model.input_names]
    steered = bool(names) and all(n in _FEATURES for n in names)
    if steered and (sensor is not None or model.sensor is not None):
        return closed_loop(model, controller=controller, sensor=sensor, normalise=normalise)
    given = {"controller": controller, "sensor": sensor, "headings": headings}
    unused = [name for name, value in given.items() if value is not None]
    unused += ["normalise=False"] * (not normalise)
    if unused:
        missing = "a sensor" if steered else "inputs that are heading features"
        raise ParameterError(
            f"{' and '.join(unused)}: the model has no polarity loop, for it lacks {missing}; give "
            "a model with one, or leave this out"
        )
    return None


def steering(loop: ClosedLoop | None) -> ClosedLoop:
    """The loop of cells that have one.

    Raises
    ------
    ParameterError
        For cells without.
    """
    if loop is None:
        raise ParameterError("these cells have no polarity loop: nothing is sensed or turned")
    return loop


def commands(loop: ClosedLoop, p: np.ndarray) -> np.ndarray:
    """Inputs of the model (K, n_c) for polarities p (K, 3)."""
    norm = np.hypot(p[:, 0], p[:, 1])
    c, s = p[:, 0] / norm, p[:, 1] / norm
    features = {
        "amplitude": np.ones(len(p)),
        "cos": c,
        "sin": s,
        "cos2": c * c - s * s,
        "sin2": 2 * s * c,
    }
    return np.column_stack([features[n.split(".")[-1]] for n in loop.model.input_names])


def sensed(loop: ClosedLoop, raw: np.ndarray) -> np.ndarray:
    """d (K, 3) as the law uses it, from S_d z (K, 3) without the intercept."""
    d = loop.sensor.K_d[:, 0] + raw
    if not loop.normalise:
        return d
    if loop.sensor.noise:
        return cue_rows(d, loop.sensor.noise)
    return d / np.sqrt(np.einsum("ki,ki->k", d, d) + 1e-300)[:, None]


def turn(law: PolarityLaw, p: np.ndarray, d: np.ndarray, dt: float) -> np.ndarray:
    """Exact step of every polarity with d held; cells near -d leave it as the law says."""
    if not isinstance(law.antiparallel, AntiparallelStay):
        size = np.sqrt(np.einsum("ki,ki->k", p, p) * np.einsum("ki,ki->k", d, d))
        near = (np.einsum("ki,ki->k", p, d) <= law.antiparallel.within * size) & (size > 0)
        if near.any():
            p = p.copy()
            for k in np.flatnonzero(near):
                p[k] = law.step(p[k], d[k], 0.0)
    return exact_steps(p, d, law.kappa, dt)


def rates(law: PolarityLaw, p: np.ndarray, d: np.ndarray) -> np.ndarray:
    """dp/dt (K, 3)."""
    return np.array([rate(a, b, law.kappa) for a, b in zip(p, d, strict=True)])
