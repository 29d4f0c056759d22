"""`Equivariant`: the default on a homogeneous matrix [notes: theory, equivariant cell]."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.cell.certificate import card_of, sensor_of
from cellsys.cell.charges import N_FEATURES, command_features
from cellsys.cell.dynamics import CellDynamics, ChargeBlock, ReadOut
from cellsys.cell.forecast import ValidityMonitor, conformal_bands, residuals
from cellsys.cell.model import EquivariantModel
from cellsys.cell.port import PolarPort, PortSites
from cellsys.cell.records import CellRecord, read_records, sites_of
from cellsys.cell.representation import (
    CHARGES,
    CellRepresentation,
    ChargeModes,
    fit_modes,
    smallest_order,
)
from cellsys.cell.schedule import Clock
from cellsys.cell.shape import ShapeBasis
from cellsys.cell.training import (
    ChargeData,
    ChargeParameters,
    one_step,
    port_gain,
    roll_out,
    train,
)
from cellsys.cell.worth import roll_record
from cellsys.errors import DataError, ParameterError
from cellsys.model.sensor import ridge_weights
from cellsys.samples.snapshots import Snapshots
from cellsys.threads import one_thread
from cellsys.trajectory import cell_names


@checked
@dataclass(frozen=True, kw_only=True)
class Equivariant:
    """Charges of shape and load, contractive blocks on a clock, trained on whole roll-outs.

    Parameters
    ----------
    step : float
        Step of the model, s; a multiple of the sampling interval.
    clock : Clock
        Vertices of the schedule; ``Clock(vertices=1)`` gives a time-invariant model.
    iterations : int
        Steps of projected Adam on the roll-out loss; 0 keeps the one-step fit.
    rate : float
        First step size.
    ridge : float
        Penalty of the one-step start, relative to the regressors' variance.
    margin : float or None
        Every vertex is kept at ||A||_2 <= 1 - margin (whitened); then a roll-out stays below
        |x_0| + sup |input| / margin. None trains without the constraint.
    load_share : float
        Rms of the load's coordinates over that of the shape's.
    degree : int
        Of the spherical harmonics.
    port : PolarPort
    read_ridge : float
        Penalty of the centroid's read-out.
    folds : int
        Parts the runs are split into for the error bands; 0 makes none.
    """

    step: float = 10.0
    clock: Clock = field(default_factory=Clock)
    iterations: int = 450
    rate: float = 6e-3
    ridge: float = 1e-4
    margin: float | None = 1e-3
    load_share: float = 0.3
    degree: int = 10
    port: PolarPort = field(default_factory=PolarPort)
    read_ridge: float = 1e-3
    folds: int = 8

    own_basis: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name in ("step", "rate", "load_share", "ridge", "read_ridge"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ParameterError(f"Equivariant.{name} must be > 0, got {value!r}")
        if self.margin is not None and not 0 < self.margin < 1:
            raise ParameterError(
                f"Equivariant.margin must be between 0 and 1 (or None), got {self.margin!r}"
            )
        if self.folds < 0 or self.folds == 1:
            raise ParameterError(f"Equivariant.folds must be 0 or >= 2, got {self.folds!r}")
        if self.iterations < 0:
            raise ParameterError(f"Equivariant.iterations must be >= 0, got {self.iterations!r}")

    @property
    def name(self) -> str:
        """Name in tables and cards."""
        return "Equivariant"

    def order_for(self, data: Snapshots, tol: float) -> int:
        """Smallest order whose modes leave at most `tol` of the features' squared norm."""
        if not 0 < tol < 1:
            raise ParameterError(f"tol must be between 0 and 1, got {tol!r}")
        records = read_records(data, self.step, self.port, sites_of(data))
        _, features = self._represent(records)
        return smallest_order([f for _, f in features], tol) + 2

    @one_thread()
    def fit(
        self,
        data: Snapshots,
        order: int,
        *,
        test: Snapshots | None = None,
        basis: object = None,
    ) -> EquivariantModel:
        """Learn a model of `order` real states, two of which are the centroid.

        It comes with its sensor, error bands, validity monitor and card, measured on `test`.
        Error bands take `folds` further fits, each without some of the runs; fewer than three
        runs give none, and the card says so. `basis`, which regressions share, is not used.

        Raises
        ------
        DataError, RankError, ParameterError
            Runs without commands, loads or rest places; an order that the data do not carry; a
            step that does not fit the sampling.
        """
        sites = sites_of(data)
        records = read_records(data, self.step, self.port, sites)
        held = [] if test is None else read_records(test, self.step, self.port, sites_of(test))
        model = self.fit_records(records, data, order, sites)
        bands = None
        if self.folds and len(data.runs) >= 3:
            misses, others = self.left_out(records, data, order, sites)
            bands = conformal_bands(misses, self.step, min(self.folds, len(data.runs)))
            part = "run" if len(others) == len(data.runs) else "group of runs"
            model = replace(model, refits=np.array(others), left_out=part)
        model = replace(model, bands=bands, monitor=ValidityMonitor.of(model, records))
        model = replace(model, sensor=sensor_of(model, data, records, test, held))
        return replace(model, card=card_of(model, data, records, held, test))

    @one_thread()
    def fit_records(
        self,
        records: Sequence[CellRecord],
        data: Snapshots,
        order: int,
        sites: PortSites,
        began: float | None = None,
    ) -> EquivariantModel:
        """The bare model, from records already read (several fits on subsets of the same runs)."""
        began = time.perf_counter() if began is None else began
        if not records:
            raise DataError("an equivariant model needs at least one run with a cell")
        representation, features = self._represent(records)
        modes = fit_modes([f for _, f in features], order - 2)
        trained, history = {}, {}
        for q in CHARGES:
            rows = self._rows(q, records, features, representation, modes)
            best, losses = self._train(rows)
            trained[q], history[str(q)] = (best, rows), losses
        modes = modes.in_norm({q: p.norm for q, (p, _) in trained.items()})
        blocks = []
        for q, (p, rows) in trained.items():
            p = replace(p, gamma=port_gain(p, rows))
            C = modes.decoder[q][-representation.load_size(q) :] / representation.load_weight
            blocks.append(ChargeBlock(p.A, p.norm @ p.B, p.gamma, C))
            if q == 1:
                alone, riding = self._read_outs(records, features, *in_norm(p, rows))
        dynamics = CellDynamics(
            blocks=tuple(blocks), clock=self.clock, dt=self.step, alone=alone, riding=riding
        )
        last = max(len(run.x) for run in data.runs) - 1
        model = EquivariantModel(
            dynamics=dynamics,
            representation=representation,
            modes=modes,
            sites=sites,
            states=data.states,
            auxiliaries=data.auxiliaries,
            cell=cell_names(data.states)[0],
            horizon=last * data.dt,
            notes={
                "contractive": self.margin is not None,
                "loss": {q: [v[0], v[-1]] for q, v in history.items() if v},
                "tail": {str(q): v for q, v in modes.tail.items()},
                "fit_seconds": time.perf_counter() - began,
            },
        )
        start = np.mean([model.encode_cell(r.nodes[:1], r.loads[:1])[0] for r in records], axis=0)
        return replace(model, z_start=start)

    @one_thread()
    def left_out(
        self, records: Sequence[CellRecord], data: Snapshots, order: int, sites: PortSites
    ) -> tuple[list[dict[str, np.ndarray]], list[np.ndarray]]:
        """Residuals of every record under a model that saw none of its run, and each model's A."""
        runs = sorted({r.run for r in records})
        folds = min(self.folds, len(runs))
        misses, generators = [], []
        for fold in range(folds):
            out = set(runs[fold::folds])
            kept = [r for r in records if r.run not in out]
            model = self.fit_records(kept, data, order, sites)
            generators.append(model.A)
            misses += [residuals(model, r, roll_record(model, r)) for r in records if r.run in out]
        return misses, generators

    def _represent(
        self, records: Sequence[CellRecord]
    ) -> tuple[CellRepresentation, list[tuple[np.ndarray, dict[int, np.ndarray]]]]:
        """Coordinates whose load part has `load_share` of the shape's rms, and all features."""
        first = records[0].nodes[0]
        shape = ShapeBasis.of(first, self.degree)
        height = float(shape.coefficients(first)[0][2])
        plain = CellRepresentation(shape, self.port, height, 1.0)
        features = [plain.features(r.nodes, r.loads) for r in records]
        power = np.zeros(2)
        for _, each in features:
            for q, values in each.items():
                for i, part in enumerate(plain.split(q, values)):
                    power[i] += float(np.sum(np.abs(part) ** 2))
        if not power.min() > 0:
            raise DataError(
                f"the cells of these runs {'do not move' if power[0] == 0 else 'carry no load'}; "
                "there is nothing to learn"
            )
        weight = self.load_share * float(np.sqrt(power[0] / power[1]))
        final = CellRepresentation(shape, self.port, height, weight)
        for _, each in features:
            for q in CHARGES:
                size = final.load_size(q)
                if size:
                    each[q][:, -size:] *= weight
        return final, features

    def _rows(
        self,
        q: int,
        records: Sequence[CellRecord],
        features: list[tuple[np.ndarray, dict[int, np.ndarray]]],
        representation: CellRepresentation,
        modes: ChargeModes,
    ) -> ChargeData:
        """Samples, commands and port velocities of one charge, whitened."""
        D, E = modes.decoder[q], modes.encoder[q]
        C = D[len(D) - representation.load_size(q) :] / representation.load_weight
        x = [f[q] @ E.T for _, f in features]
        u = [command_features(r.amplitude, r.heading, q) for r in records]
        v = [np.array([y[q] for y in r.velocity]) @ C for r in records]
        clock = self.clock.weights(self.step * np.arange(max(len(a) for a in u)))
        return charge_data(q, x, u, v, clock, modes.variance[q])

    def _train(self, rows: ChargeData) -> tuple[ChargeParameters, list[float]]:
        m, H = rows.x.shape[2], self.clock.vertices
        bound = None if self.margin is None else 1.0 - self.margin
        if not m:
            empty = np.zeros((H, 0, 0)), np.zeros((H, 0, N_FEATURES))
            return ChargeParameters(*empty, 0.0, np.zeros((0, 0))), []
        start = one_step(rows, self.ridge, np.inf if bound is None else bound)
        best, losses = train(start, rows, iterations=self.iterations, rate=self.rate, bound=bound)
        return best if best.S is not None else replace(best, S=np.eye(m)), losses

    def _read_outs(
        self,
        records: Sequence[CellRecord],
        features: list[tuple[np.ndarray, dict[int, np.ndarray]]],
        p: ChargeParameters,
        rows: ChargeData,
    ) -> tuple[ReadOut, ReadOut]:
        """Centroid read-outs, fitted to whole paths of the simulated charge 1."""
        K, H = len(rows.u), rows.w.shape[1]
        m, hats = rows.x.shape[2], self.port.n_hats
        n = m + N_FEATURES
        alone = roll_out(replace(p, gamma=0.0), rows)
        riding = roll_out(p, rows)
        ridden = _stack(
            [np.array([y[1][hats : 2 * hats] for y in r.velocity]) for r in records], K, 1
        )
        path = _stack(
            [(c[:, :1] + 1j * c[:, 1:2]) - (c[0, 0] + 1j * c[0, 1]) for c, _ in features], K + 1, 1
        )[1:, :, 0]
        there = rows.counts[1:] > 0

        def regress(x: np.ndarray, velocity: np.ndarray | None) -> ReadOut:
            middle = 0.5 * (x[1:] + x[:-1])
            scheduled = np.concatenate([middle, rows.u], axis=2)
            table = (rows.w[:, None, :, None] * scheduled[:, :, None, :]).reshape(
                *middle.shape[:2], -1
            )
            if velocity is not None:
                table = np.concatenate([table, velocity], axis=2)
            X = np.cumsum(table, axis=0)[there]
            solution = ridge_weights(X, path[there], self.read_ridge)
            by_vertex = solution[: H * n].reshape(H, n)
            R_y = np.zeros(hats) if velocity is None else solution[H * n :]
            return ReadOut(by_vertex[:, :m].copy(), by_vertex[:, m:].copy(), R_y)

        return regress(alone, None), regress(riding, ridden)


def in_norm(p: ChargeParameters, rows: ChargeData) -> tuple[ChargeParameters, ChargeData]:
    """Parameters and rows in the coordinates S x, where the norm of A is the plain one."""
    S = p.norm
    moved = replace(
        rows,
        x=rows.x @ S.T,
        v=sla.solve(S.T, rows.v.reshape(-1, len(S)).T).T.reshape(rows.v.shape),
    )
    return ChargeParameters(p.A, S @ p.B, p.gamma), moved


def charge_data(
    q: int,
    x: list[np.ndarray],
    u: list[np.ndarray],
    v: list[np.ndarray],
    w: np.ndarray,
    weight: np.ndarray,
) -> ChargeData:
    """Rows of all records; a complex charge gives two real rows each, shorter runs are padded."""
    K = len(w)
    counts = _stack([np.ones((len(a), 1)) + (1j if q else 0) for a in x], K + 1, q)
    return ChargeData(
        x=_stack(x, K + 1, q),
        u=_stack(u, K, q),
        v=_stack(v, K, q),
        w=w,
        weight=weight,
        counts=counts[..., 0],
    )


def _stack(arrays: list[np.ndarray], length: int, q: int) -> np.ndarray:
    """(length, rows, columns) from (T_i, columns); real parts first, then imaginary ones."""
    out = np.zeros((length, len(arrays), arrays[0].shape[1]), complex if q else float)
    for i, a in enumerate(arrays):
        out[: len(a), i] = a
    return np.concatenate([out.real, out.imag], axis=1) if q else out
