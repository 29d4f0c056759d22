"""Models from the full-order equations themselves: linearised at a state and projected."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError
from cellsys.kinds import FILLED, Filled
from cellsys.model.latent import LatentModel
from cellsys.reduction.basis import Basis, ExactSVD, RandomisedSVD, fit_basis
from cellsys.reduction.regression import input_map, learned_model
from cellsys.samples.snapshots import Snapshots
from cellsys.system import Layout, OdeSystem
from cellsys.units import real_array


@checked
@dataclass(frozen=True)
class Jacobian:
    """The full-order model linearised at one state, projected on the states' basis.

        x' = f(x) + u ,  f(x) = W_x x + W_eta eta(x) ;   x ~ mean + S V z ,  V from x alone
        A = V^T S^-1 J S V ,   b = V^T S^-1 (f(x_0) + J (mean - x_0)) ,   J = df/dx at x_0

    The derivative is taken along the columns of S V only, by central differences: J is never
    formed. The model is continuous; u enters as in `PCR`. Nothing in it is fitted, and nothing
    makes it stable: its card tells.

    Parameters
    ----------
    system : OdeSystem
        `cs.build(scene)` or a user's own. Its states may include some that are not in the
        snapshots (a polarity): those are held where they are at `at`.
    at : array (n,), optional
        x_0 in the layout of the system; default its start.
    time : float
        s, where the laws depend on time.
    svd : ExactSVD or RandomisedSVD, optional
        See `fit_basis`.
    """

    system: OdeSystem
    at: Filled[np.ndarray] = FILLED
    time: float = 0.0
    svd: ExactSVD | RandomisedSVD | None = field(default=None, kw_only=True)

    name: ClassVar[str] = "Jacobian"
    own_basis: ClassVar[bool] = True

    def __post_init__(self) -> None:
        x = self.system.x0 if self.at is None else real_array(self.at, "at").copy()
        if x.shape != (self.system.states.size,):
            raise DimensionError(f"at must have shape ({self.system.states.size},), got {x.shape}")
        if not np.all(np.isfinite(x)):
            raise DataError("at holds NaN or inf; give a state of the system")
        object.__setattr__(self, "at", x)

    def __repr__(self) -> str:
        return f"Jacobian({type(self.system).__name__}, time={self.time:g})"

    def fit(
        self,
        data: Snapshots,
        order: int,
        *,
        test: Snapshots | None = None,
        basis: Basis | None = None,
    ) -> LatentModel:
        """Model of order `order` in the basis of the states of `data`.

        `basis`, which regressions share, holds auxiliaries too and is not used.
        """
        alone = states_only(data)
        basis = fit_basis(alone, order, method=self.svd)
        rows = rows_in(self.system, data)
        A, b = linearised(self.system, self.time, self.at, rows, basis)
        weight = basis.inverse_scale()[:, None] * basis.V
        B, b_u, names, explained = input_map(data, weight, 1e-13)
        return learned_model(
            alone,
            basis,
            A,
            B=B,
            offset=b + b_u,
            input_names=names,
            notes={"method": repr(self), "input_share_explained": explained},
        )


def states_only(data: Snapshots) -> Snapshots:
    """The snapshots without their auxiliaries."""
    runs = tuple(dataclasses.replace(r, eta=None, eta_start=None) for r in data.runs)
    empty = sp.csr_array((data.states.size, 0))
    return dataclasses.replace(data, runs=runs, auxiliaries=Layout(), W_eta=empty)


def rows_in(system: OdeSystem, data: Snapshots) -> np.ndarray:
    """Where the states of `data` stand in the state of the system.

    Raises
    ------
    DimensionError
        A block that the system does not have, or has in another shape.
    """
    rows = []
    for block in data.states:
        if block.name not in system.states or system.states[block.name].shape != block.shape:
            raise DimensionError(
                f"the snapshots have a state {block.name!r} of shape {block.shape} that this "
                "system does not have; give the system that made the runs"
            )
        piece = system.states.slice(block.name)
        rows.append(np.arange(piece.start, piece.stop))
    return np.concatenate(rows)


def field_of(system: OdeSystem, t: float, x: np.ndarray) -> np.ndarray:
    """f = W_x x + W_eta eta(t, x), without the exogenous rate.

    Raises
    ------
    DataError
        Where it is not finite: x is outside what the laws allow.
    """
    f = system.W_x @ x + system.W_eta @ system.eta(t, x)
    if not np.all(np.isfinite(f)):
        raise DataError("the laws give NaN or inf at this state; linearise at another one")
    return f


def linearised(
    system: OdeSystem, t: float, x: np.ndarray, rows: np.ndarray, basis: Basis
) -> tuple[np.ndarray, np.ndarray]:
    """A (m, m), b (m,) of z' = A z + b: f linearised at x, projected.

    Central differences along the columns of S V with the largest entry moved by
    (3 eps)^(1/3) = 9e-6 times the largest scale factor: truncation and rounding both near 1e-10.
    """
    S, V = basis.scale, basis.V
    weight = (basis.inverse_scale()[:, None] * V).T
    length = (3.0 * np.finfo(float).eps) ** (1 / 3) * float(S.max())

    def along(direction: np.ndarray) -> np.ndarray:
        size = float(np.abs(direction).max())
        if size == 0.0:
            return np.zeros(len(rows))
        h, ends = length / size, []
        for sign in (1.0, -1.0):
            there = x.copy()
            there[rows] += sign * h * direction
            ends.append(field_of(system, t, there)[rows])
        return (ends[0] - ends[1]) / (2.0 * h)

    A = weight @ np.column_stack([along(column) for column in (S[:, None] * V).T])
    b = weight @ (field_of(system, t, x)[rows] + along(basis.mean - x[rows]))
    return A, b
