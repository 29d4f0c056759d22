"""How certain the poles of a model are: refit with a part of the data left out.

The parts are the runs; groups of them where there are more than `GROUPS`; of a single run eight
stretches of equal length.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TypeGuard

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import LinearModel, ReducedModel, Reductor, Regression
from cellsys.errors import CellsysError, DataError, ParameterError
from cellsys.kinds import kind_of
from cellsys.model.poles import certainty_of
from cellsys.reduction.basis import Basis, fit_basis, truncated
from cellsys.samples.snapshots import RunData, Snapshots
from cellsys.spectra.certainty import PoleCertainty
from cellsys.threads import one_thread

GROUPS = 20
STRETCHES = 8


@checked
@one_thread()
def pole_certainty(
    data: Snapshots,
    method: Reductor,
    order: int,
    basis: Basis | None = None,
) -> PoleCertainty:
    """Poles of a reductor and how far each moves when a part of the data is left out.

    Models are refitted in one basis. Poles are matched by the assignment with the least total
    distance, not by sorting.

    Parameters
    ----------
    data : Snapshots
    method : reductor
    order : int
    basis : Basis, optional
        Of at least that order, to be reused.

    Raises
    ------
    DataError
        Where what is left over is too little to learn from.
    """
    if isinstance(method, Regression):
        basis = truncated(basis, order) or fit_basis(data, order, method=method.svd)
        basis = basis.with_parts(data)
    model = linear(method.fit(data, order, basis=basis))
    known = refits(data, method, order, basis)
    if known is None:
        raise DataError(
            f"the data are too few to be learned from in parts: {data.n_samples} samples of "
            f"{len(data.runs)} runs for order {order}; add runs or lower the order"
        )
    A, left_out = known
    return certainty_of(model.A, model.dt, A, left_out, discrete=False)


def linear(model: ReducedModel) -> LinearModel:
    """A linear model, as it is.

    Raises
    ------
    ParameterError
        For one without matrices: it has no poles.
    """
    if not _is_linear(model):
        raise ParameterError(f"a {type(model).__name__} has no matrix A, and so no poles to follow")
    return model


def _is_linear(model: ReducedModel) -> TypeGuard[LinearModel]:
    return kind_of(LinearModel).fault(model) is None


def refits(
    data: Snapshots,
    method: Reductor,
    order: int,
    basis: Basis | None,
) -> tuple[np.ndarray, str] | None:
    """A (k, m, m) of the model learned without each part of the data, and what a part is.

    None where what is left over is too little to learn from.
    """
    left_out = "run" if len(data.runs) > 1 else "stretch"
    if len(data.runs) > GROUPS:
        left_out = "group of runs"
    found = []
    try:
        if isinstance(method, Regression):
            for kept in _kept_samples(data):
                found.append(method.refit(data, basis, kept))
        else:
            for rest in _kept_runs(data):
                found.append(linear(method.fit(rest, order, basis=basis)).A)
    except CellsysError:
        return None
    return np.array(found), left_out


def _dealt(count: int) -> list[np.ndarray]:
    """Numbers of the runs of each group."""
    return [np.arange(count)[k::GROUPS] for k in range(min(count, GROUPS))]


def _stretches(usable: np.ndarray) -> list[np.ndarray]:
    return np.array_split(usable, STRETCHES) if len(usable) >= 2 * STRETCHES else []


def _kept_samples(data: Snapshots) -> Iterator[np.ndarray]:
    """Masks (n_samples,) of what is kept, one for each part left out."""
    runs = data.run_ids
    if len(data.runs) > 1:
        for group in _dealt(len(data.runs)):
            yield ~np.isin(runs, group)
        return
    samples = data.runs[0].usable()
    parts = _stretches(samples)
    if not parts:
        raise DataError(f"{len(samples)} samples are too few to leave some out")
    for part in parts:
        yield ~np.isin(samples, part)


def _kept_runs(data: Snapshots) -> Iterator[Snapshots]:
    """The data without each part."""
    if len(data.runs) > 1:
        for group in _dealt(len(data.runs)):
            rest = tuple(r for i, r in enumerate(data.runs) if i not in group)
            yield replace(data, runs=rest)
        return
    run: RunData = data.runs[0]
    parts = _stretches(run.usable())
    if not parts:
        raise DataError(f"{run.n_pairs} samples are too few to leave some out")
    for part in parts:
        yield replace(data, runs=(replace(run, skip=(*run.skip, *(int(k) for k in part))),))
