"""A closed loop as the systems that integrators take: states [z; p], and its linear part."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellsys.integrate.semilinear import Semilinear
from cellsys.laws.polarity import heading_rows, rate_rows
from cellsys.system import OdeSystem

_NAMES = ("cos", "sin", "cos2", "sin2", "amplitude")


class ClosedLoopSystem(OdeSystem):
    """State [z; p]; reports p and d with every sample."""

    loop: Any

    def observe(self, t: float, x: np.ndarray) -> dict[str, np.ndarray]:
        loop = self.loop
        return {"p": x[None, loop.order :].copy(), "d": loop.sensed(x[: loop.order])[None]}

    def observe_rows(self, t: np.ndarray, x: np.ndarray) -> dict[str, np.ndarray]:
        """`observe` for all samples of a run: x (T, m + 3)."""
        m = self.loop.order
        return {"p": x[:, None, m:].copy(), "d": sensed_rows(self.loop, x[:, None, :m])}

    def semilinear(self) -> Semilinear:
        """The loop as `Exponential` takes it apart: a linear plant and a slow heading."""
        return self.loop.semilinear


def sensed_rows(loop: Any, z: np.ndarray) -> np.ndarray:
    """`loop.sensed` for rows of latent states: (..., m) -> (..., 3)."""
    return _scaled(loop, loop.sensor.K_d[:, 0] + z @ loop.sensor.S_d.T)


def _scaled(loop: Any, raw: np.ndarray) -> np.ndarray:
    if not loop.normalise:
        return raw
    return raw / np.sqrt(np.vecdot(raw, raw) + 1e-300)[..., None]


def semilinear_of(loop: Any) -> Semilinear:
    """z' = A z + B c(p) + b and p' = kappa p x (d x p), with d from K_d [1; z]."""
    A, B, b = loop.model.continuous_matrices()
    chosen = [_NAMES.index(name.split(".")[-1]) for name in loop.model.input_names]
    # The amplitude is 1: its column joins the offset.
    turning = [k for k, index in enumerate(chosen) if index < 4]
    steady = [k for k, index in enumerate(chosen) if index == 4]
    picked = [chosen[k] for k in turning]
    kappa, m = loop.controller.kappa, loop.order

    def commands(p: np.ndarray) -> np.ndarray:
        features = heading_rows(p)
        return features if picked == [0, 1, 2, 3] else features[..., picked]

    return Semilinear(
        A=A,
        B=B[:, turning],
        b=b + B[:, steady].sum(axis=1),
        S=loop.sensor.S_d,
        s=loop.sensor.K_d[:, 0],
        commands=commands,
        rate=lambda p, raw: rate_rows(p, _scaled(loop, raw), kappa),
        fast=np.arange(m)[None],
        slow=np.arange(m, m + 3)[None],
    )


def model_error(model: Any) -> dict[str, float]:
    """The model's part of a run's error: relative roll-out errors on its card, by block."""
    card = model.card
    if card is None:
        return {}
    rows, where = (card.held_out, "held out") if card.held_out else (card.training, "in training")
    return {f"{block}, {where}": float(row["model"]) for block, row in rows.items()}
