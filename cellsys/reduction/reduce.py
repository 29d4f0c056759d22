"""`reduce`: data in, model with its card out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import ClassVar, Protocol, TypeGuard

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import ChoosesOrder, ReducedModel, Reductor, Regression, needs
from cellsys.errors import ParameterError
from cellsys.model.latent import LatentModel
from cellsys.model.sensor import StiffnessSensor, fit_sensor
from cellsys.model.trained_range import TrainedRange
from cellsys.reduction.basis import Basis, ExactSVD, RandomisedSVD, fit_basis, truncated
from cellsys.reduction.certainty import refits
from cellsys.reduction.pcr import PCR
from cellsys.samples.snapshots import Snapshots
from cellsys.threads import one_thread
from cellsys.units import real_number
from cellsys.worth.assessment import Encoded, assess, encode_all, encode_start


@checked
def reduce(
    data: Snapshots,
    *,
    order: int | None = None,
    tol: float | None = None,
    method: Reductor | None = None,
    test: Snapshots | None = None,
    basis: Basis | None = None,
) -> ReducedModel:
    """Learn a reduced model.

    Parameters
    ----------
    data : Snapshots
        Training runs.
    order : int, optional
        m; give this or `tol`.
    tol : float, optional
        Smallest order whose basis leaves at most this share of the snapshots' squared norm.
    method : reductor, optional
        `PCR()` (default), `LeastSquares()`, `Ridge(...)`, `Contractive(...)`, `Equivariant()`.
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
    chosen: Reductor = PCR() if method is None else method
    if order is None:
        share = real_number(tol, "tol")
        if isinstance(chosen, ChoosesOrder):
            order = chosen.order_for(data, share)
        else:
            order, basis = _order_for(data, share, getattr(chosen, "svd", None))
    if not refits_cheaply(chosen):
        return completed(chosen.fit(data, order, test=test, basis=basis), chosen, data, test)
    basis = truncated(basis, order) or fit_basis(data, order, method=chosen.svd)
    basis = basis.with_parts(data)
    model = chosen.fit(data, order, test=test, basis=basis)
    return completed(certain(model, data, chosen, basis), chosen, data, test)


def refits_cheaply(method: Reductor) -> TypeGuard[Regression]:
    """Whether the reductor is a regression in the common basis: its refits cost next to nothing."""
    return isinstance(method, Regression) and not brings_basis(method)


def brings_basis(method: Reductor) -> bool:
    """Whether the reductor learns in coordinates of its own, so that a basis is of no use to it."""
    return bool(getattr(method, "own_basis", False))


class DataModel(ReducedModel, Protocol):
    """A reduced model that is a dataclass, so that more can be put on it."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[object]]]


def takes(model: ReducedModel, names: Sequence[str], said: str) -> DataModel:
    """The model, on which these can be put.

    Raises
    ------
    ParameterError
        For one that is no dataclass with these fields.
    """
    fields = {f.name for f in dataclasses.fields(model)} if _is_data(model) else ()
    lacks = [n for n in names if n not in fields]
    if lacks or not _is_data(model):
        raise ParameterError(
            f"{said}, and {', '.join(lacks)} cannot be put on it; return a cs.LatentModel, a "
            "dataclass with these fields, or a model with its card"
        )
    return model


def _is_data(model: ReducedModel) -> TypeGuard[DataModel]:
    return dataclasses.is_dataclass(model)


def certain(model: ReducedModel, data: Snapshots, method: Regression, basis: Basis) -> DataModel:
    """The model with what it becomes without each part of the data, where that can be known."""
    said = f"{described(method)}.fit returned a {type(model).__name__} that may be refitted"
    put = takes(model, ("refits", "left_out"), said)
    found = refits(data, method, model.order, basis)
    return put if found is None else dataclasses.replace(put, refits=found[0], left_out=found[1])


@checked
@one_thread()
def reduce_orders(
    data: Snapshots,
    methods: Sequence[Reductor],
    orders: Sequence[int],
    test: Snapshots | None = None,
    basis: Basis | None = None,
    encoded: tuple[Encoded, Encoded | None] | None = None,
) -> Iterator[ReducedModel]:
    """Models of every method and order in one basis; the data are projected only once.

    Same models and cards as `reduce` with that basis. What `basis` carries of the samples, and
    `encoded`, the runs in it, are reused.
    """
    basis = fit_basis(data, max(orders)) if basis is None else basis
    basis = basis.with_parts(data)
    sensors: dict[int, StiffnessSensor | None] = {}
    for method in methods:
        for order in orders:
            model = method.fit(data, order, test=test, basis=basis)
            if model.card is not None or not in_basis(model, basis):
                yield completed(model, method, data, test)
                continue
            learned: DataModel = model
            within = truncated(basis, order)
            if within is not None and refits_cheaply(method):
                learned = certain(model, data, method, within)
            if encoded is None:
                large = LatentModel(
                    A=np.zeros((basis.V.shape[1],) * 2),
                    V=basis.V,
                    mean=basis.mean,
                    scale=basis.scale,
                    n_states=data.states.size,
                )
                encoded = encode_all(large, data, test)
            # The sensor reads the basis, not the dynamics: one an order serves all methods.
            done = complete(learned, data, test, encoded, sensors.get(order))
            sensors[order] = done.sensor
            yield done


def in_basis(model: ReducedModel, basis: Basis) -> TypeGuard[LatentModel]:
    """Whether the coordinates of a model are the first of a basis."""
    if not isinstance(model, LatentModel):
        return False
    common = (basis.V[:, : model.order], basis.mean, basis.scale)
    own = (model.V, model.mean, model.scale)
    return all(a is not None and np.array_equal(a, b) for a, b in zip(own, common, strict=True))


def completed(
    model: ReducedModel, method: Reductor, data: Snapshots, test: Snapshots | None
) -> ReducedModel:
    """The model of a reductor with its card: its own, or the one that is measured here.

    Raises
    ------
    ParameterError
        When the reductor returned no reduced model, or one that no card can be put on.
    """
    needs(model, ReducedModel, f"what {described(method)}.fit returned")
    if model.card is not None:
        return model
    said = f"{described(method)}.fit returned a {type(model).__name__} without a card"
    return complete(takes(model, ("z_start", "sensor", "notes", "card"), said), data, test)


def name_of(method: Reductor) -> str:
    """What tables call a reductor."""
    return getattr(method, "name", type(method).__name__)


def described(method: Reductor) -> str:
    """A reductor in words: its name and the settings that are not the default ones."""
    name = name_of(method)
    if not dataclasses.is_dataclass(method):
        return name
    fields = dataclasses.fields(method)
    if any(f.default is f.default_factory is dataclasses.MISSING for f in fields):
        return repr(method)
    own = [f.name for f in fields if getattr(method, f.name) != f.default]
    return f"{name}({', '.join(f'{n}={getattr(method, n)!r}' for n in own)})"


def complete(
    model: DataModel,
    data: Snapshots,
    test: Snapshots | None = None,
    encoded: tuple[Encoded, Encoded | None] | None = None,
    sensor: StiffnessSensor | None = None,
) -> ReducedModel:
    """The model with its start, sensor (fitted unless given), card, trained range, longest run."""
    encoded = encode_all(model, data, test) if encoded is None else encoded
    start = np.mean([encode_start(model, run) for run in data.runs], axis=0)
    sensor = sensor_of(model, data, test, encoded) if sensor is None else sensor
    horizon = data.dt * max(len(run.x) - 1 for run in data.runs)
    commands = [data.commands_of(run, model.input_names) for run in data.runs]
    latents = [z[:, : model.order] for z in encoded[0].runs]
    notes = {
        **model.notes,
        "horizon_s": horizon,
        **TrainedRange.of(commands, [*latents, start[None]], horizon).note(),
    }
    model = dataclasses.replace(model, z_start=start, sensor=sensor, notes=notes)
    return dataclasses.replace(model, card=assess(model, data, test, encoded))


def sensor_of(
    model: ReducedModel,
    data: Snapshots,
    test: Snapshots | None,
    encoded: tuple[Encoded, Encoded | None],
) -> StiffnessSensor | None:
    """The sensor of a one-cell model whose runs recorded a sensed direction; else None."""
    if any(run.d is None or run.d.shape[1] != 1 for run in data.runs):
        return None

    def samples(
        of: Snapshots, latents: list[np.ndarray]
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        kept = [run.usable() for run in of.runs]
        return (
            [z[ks, : model.order] for z, ks in zip(latents, kept, strict=True)],
            [np.asarray(run.d)[ks, 0] for run, ks in zip(of.runs, kept, strict=True)],
        )

    aside = encoded[1]
    z_held, d_held = (None, None) if test is None or aside is None else samples(test, aside.runs)
    noise = float(data.geometry.get("sensing.noise", 0.0))
    z, d = samples(data, encoded[0].runs)
    return fit_sensor(z, d, z_held, d_held, noise=noise)


def _order_for(
    data: Snapshots, tol: float, svd: ExactSVD | RandomisedSVD | None
) -> tuple[int, Basis]:
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
