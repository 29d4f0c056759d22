"""`reduce`: data in, model with its card out."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from cellsys.errors import ParameterError
from cellsys.reduction.basis import Basis, fit_basis
from cellsys.reduction.card import assess, encode_start
from cellsys.reduction.model import LatentModel
from cellsys.reduction.pcr import PCR
from cellsys.reduction.sensor import StiffnessSensor, fit_sensor
from cellsys.reduction.snapshots import Snapshots


def reduce(
    data: Snapshots,
    *,
    order: int | None = None,
    tol: float | None = None,
    method: Any = None,
    test: Snapshots | None = None,
    basis: Basis | None = None,
) -> LatentModel:
    """Learn a reduced model.

    Parameters
    ----------
    data : Snapshots
        Training runs.
    order : int, optional
        m; give this or `tol`.
    tol : float, optional
        Smallest order whose basis leaves at most this share of the snapshots' squared norm.
    method : PCR or LeastSquares, optional
        Default `PCR()`.
    test : Snapshots, optional
        Held-out runs; their roll-out errors go on the card.
    basis : Basis, optional
        A basis of at least this order, to be reused over several orders.

    Raises
    ------
    RankError
        When the order is beyond the data's rank.
    """
    if (order is None) == (tol is None):
        raise ParameterError("give either order= or tol=")
    method = PCR() if method is None else method
    if order is None:
        order, basis = _order_for(data, float(tol), getattr(method, "svd", None))
    model = method.fit(data, order, basis)
    model = dataclasses.replace(
        model, z_start=start_of(model, data), sensor=sensor_of(model, data, test)
    )
    return dataclasses.replace(model, card=assess(model, data, test))


def start_of(model: LatentModel, data: Snapshots) -> np.ndarray:
    """Mean over runs of the encoded start."""
    return np.mean([encode_start(model, run) for run in data.runs], axis=0)


def sensor_of(
    model: LatentModel, data: Snapshots, test: Snapshots | None
) -> StiffnessSensor | None:
    """The sensor of a one-cell model whose runs recorded a sensed direction; else None."""
    if any(run.d is None or run.d.shape[1] != 1 for run in data.runs):
        return None

    def samples(of: Snapshots) -> tuple[list[np.ndarray], list[np.ndarray]]:
        latent, directions = [], []
        for run in of.runs:
            ks = run.usable()
            eta = None if run.eta is None else np.asarray(run.eta)[ks]
            latent.append(model.encode(np.asarray(run.x)[ks], eta))
            directions.append(np.asarray(run.d)[ks, 0])
        return latent, directions

    return fit_sensor(*samples(data), *(samples(test) if test is not None else (None, None)))


def _order_for(data: Snapshots, tol: float, svd: Any) -> tuple[int, Basis]:
    if not 0 < tol < 1:
        raise ParameterError(f"tol must be between 0 and 1, got {tol!r}")
    most = min(data.n_samples - 1, data.n_columns)
    order = min(16, most)
    while True:
        basis = fit_basis(data, order, method=svd)
        left = 1.0 - (basis.singular_values**2).cumsum() / basis.total
        if left[-1] <= tol:
            return int((left > tol).sum()) + 1, basis
        if order == most:
            raise ParameterError(
                f"tol = {tol:g} cannot be met: order {most} still leaves {left[-1]:.2g}"
            )
        order = min(2 * order, most)
