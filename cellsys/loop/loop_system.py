"""A closed loop as the systems that integrators take: states [z; p], and its linear part."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from cellsys.contracts import LinearModel, ReducedModel
from cellsys.integrate.semilinear import Semilinear
from cellsys.laws.polarity import heading_rows, rate_rows
from cellsys.laws.sensing import cue_rows
from cellsys.loop.polarity import PolarityLaw
from cellsys.model.sensor import StiffnessSensor
from cellsys.system import OdeSystem, SymbolicForm

_NAMES = ("cos", "sin", "cos2", "sin2", "amplitude")


class PolarLoop(Protocol):
    """A loop of a plant that is the same at all times, made by cs.closed_loop(model)."""

    @property
    def model(self) -> LinearModel:
        """The plant."""

    @property
    def controller(self) -> PolarityLaw:
        """The law of the heading."""

    @property
    def sensor(self) -> StiffnessSensor:
        """K_d."""

    @property
    def normalise(self) -> bool:
        """Whether |d| = 1."""

    @property
    def order(self) -> int:
        """m of the plant."""

    @property
    def semilinear(self) -> Semilinear:
        """See `semilinear_of`; made once."""

    @property
    def system(self) -> OdeSystem:
        """The loop as a system."""

    def sensed(self, z: np.ndarray) -> np.ndarray:
        """d as the law uses it."""


class ClosedLoopSystem(OdeSystem):
    """State [z; p]; reports p and d with every sample."""

    loop: PolarLoop

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


def sensed_rows(loop: PolarLoop, z: np.ndarray) -> np.ndarray:
    """`loop.sensed` for rows of latent states: (..., m) -> (..., 3)."""
    return _scaled(loop, loop.sensor.K_d[:, 0] + z @ loop.sensor.S_d.T)


def _scaled(loop: PolarLoop, raw: np.ndarray) -> np.ndarray:
    if not loop.normalise:
        return raw
    if loop.sensor.noise:
        return cue_rows(raw, loop.sensor.noise)
    return raw / np.sqrt(np.vecdot(raw, raw) + 1e-300)[..., None]


def semilinear_of(loop: PolarLoop) -> Semilinear:
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


def model_error(model: ReducedModel) -> dict[str, float]:
    """The model's part of a run's error: relative roll-out errors on its card, by block."""
    card = model.card
    if card is None:
        return {}
    rows, where = (card.held_out, "held out") if card.held_out else (card.training, "in training")
    return {f"{block}, {where}": float(row["model"]) for block, row in rows.items()}


class LoopCopies(OdeSystem):
    """Cells that do not feel each other: states [z_1 .. z_K; p_1 .. p_K] of one loop.

    Built by `loop_copies`. Printed superposition (thesis eq. 36) is this up to an output mixing.
    """

    loop: PolarLoop
    cells: int

    def u(self, t: float, x: np.ndarray) -> np.ndarray:
        form, m = self.loop.semilinear, self.loop.order
        z, p = x[: self.cells * m].reshape(self.cells, m), x[self.cells * m :].reshape(-1, 3)
        out = np.empty_like(x)
        out[: z.size] = (form.commands(p) @ form.B.T + form.b).ravel()
        out[z.size :] = form.rate(p, form.s + z @ form.S.T).ravel()
        return out

    def rhs(self, t: float, x: np.ndarray) -> np.ndarray:
        """dx/dt, one product for all cells instead of a block-diagonal matrix."""
        size = self.cells * self.loop.order
        out = self.u(t, x)
        out[:size] += (x[:size].reshape(self.cells, -1) @ self.loop.semilinear.A.T).ravel()
        return out

    def casadi(self) -> SymbolicForm:
        """CasADi form of all cells, one after the other."""
        kept = self.__dict__.get("_symbolic_form")
        if kept is None:
            import casadi as ca

            one, m, K = self.loop.system.casadi(), self.loop.order, self.cells
            rate = ca.Function("rate", [one.t, one.x], [one.xdot])
            t, x = ca.SX.sym("t"), ca.SX.sym("x", self.states.size)
            each = [
                rate(t, ca.vertcat(x[k * m : (k + 1) * m], x[K * m + 3 * k : K * m + 3 * k + 3]))
                for k in range(K)
            ]
            xdot = ca.vcat([*(r[:m] for r in each), *(r[m:] for r in each)])
            kept = self.__dict__["_symbolic_form"] = SymbolicForm(t, x, xdot, ca.SX.zeros(0, 1))
        return kept

    def observe(self, t: float, x: np.ndarray) -> dict[str, np.ndarray]:
        return {k: v[0] for k, v in self.observe_rows(np.array([t]), x[None]).items()}

    def observe_rows(self, t: np.ndarray, x: np.ndarray) -> dict[str, np.ndarray]:
        """`observe` for all samples of a run."""
        size = self.cells * self.loop.order
        z = x[:, :size].reshape(len(x), self.cells, -1)
        p = x[:, size:].reshape(len(x), self.cells, 3)
        return {"p": p.copy(), "d": sensed_rows(self.loop, z)}

    def semilinear(self) -> Semilinear:
        """One linear plant and one slow heading for each cell."""
        form, m, K = self.loop.semilinear, self.loop.order, self.cells
        kept = self.__dict__.get("_form")
        if kept is None:
            kept = replace(
                form,
                fast=np.arange(K * m).reshape(K, m),
                slow=K * m + np.arange(3 * K).reshape(K, 3),
            )
            # The factorisation of the plant does not depend on the number of cells.
            kept.__dict__["modal"], kept.__dict__["tables"] = form.modal, form.tables
            self.__dict__["_form"] = kept
        return kept
