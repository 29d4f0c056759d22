"""`EquivariantModel`: a reduced cell that respects rotations and mirror images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.cell.charges import harmonic_names
from cellsys.cell.dynamics import CellDynamics, CellState
from cellsys.cell.file import read_parts, write_parts
from cellsys.cell.forecast import ErrorBands, Forecast, ValidityMonitor
from cellsys.cell.port import PortSites
from cellsys.cell.representation import CellRepresentation, ChargeModes
from cellsys.errors import DataError, DimensionError, FileFormatError
from cellsys.model.affine import AffineModel
from cellsys.model.card import Card
from cellsys.model.hold import check_roll_out
from cellsys.model.latent import LatentModel
from cellsys.model.network_sensor import LocalSensor
from cellsys.model.sensor import StiffnessSensor
from cellsys.system import Layout


@dataclass(frozen=True, eq=False)
class Pole:
    """One pole of a charge: 1/s, and how often it occurs in the real plant."""

    value: complex
    charge: int
    multiplicity: int


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class EquivariantModel(AffineModel):
    """A cell as azimuthal charges; see `CellDynamics` [notes: theory, equivariant cell].

    z = [x_0, Re x_1, Im x_1, ..., centroid x, centroid y]; a step model of `dt` seconds whose
    matrices follow a clock that starts at contact. `A`, `B`, `offset` are those frozen at the end
    of the training runs; `at(t)` gives the model frozen at another time. There is no basis
    matrix; `cellsys.model.basis_of` refuses it by name.

    Parameters
    ----------
    dynamics : CellDynamics
    representation : CellRepresentation
    modes : ChargeModes
    sites : PortSites
        Matrix nodes that the load acts on.
    states, auxiliaries : Layout
        Of the snapshots; `encode` reads the cell's blocks from them.
    cell : str
        Name of the cell the layout is read for.
    horizon : float
        Length of the training runs, s.
    bands : ErrorBands, optional
        Half widths that `forecast` returns.
    monitor : ValidityMonitor, optional
        Trained ranges that `forecast` checks.
    refits, left_out : optional
        As of a `LatentModel`: A of the models behind the error bands.
    """

    dynamics: CellDynamics
    representation: CellRepresentation
    modes: ChargeModes
    sites: PortSites
    states: Layout
    auxiliaries: Layout
    cell: str = field(default="cell1", kw_only=True)
    horizon: float = field(default=1500.0, kw_only=True)
    z_start: np.ndarray | None = field(default=None, kw_only=True)
    sensor: StiffnessSensor | None = field(default=None, kw_only=True)
    card: Card | None = field(default=None, kw_only=True)
    notes: Mapping[str, object] = field(default_factory=dict, kw_only=True)
    bands: ErrorBands | None = field(default=None, kw_only=True)
    monitor: ValidityMonitor | None = field(default=None, kw_only=True)
    refits: np.ndarray | None = field(default=None, kw_only=True)
    left_out: str = field(default="run", kw_only=True)
    A: np.ndarray = field(init=False, repr=False)
    B: np.ndarray = field(init=False, repr=False)
    offset: np.ndarray = field(init=False, repr=False)
    dt: float = field(init=False)
    input_names: tuple[str, ...] = field(init=False)

    _figure: ClassVar[str] = "equivariant_model"

    def __post_init__(self) -> None:
        horizon, dt = float(self.horizon), self.dynamics.dt
        A, B, b = self.dynamics.step_matrices(horizon)
        # The checks of a plain model hold for the frozen one.
        frozen = LatentModel(
            A=(A - np.eye(len(A))) / dt,
            B=B / dt,
            offset=b / dt,
            dt=dt,
            input_names=harmonic_names(self.cell),
            z_start=self.z_start,
            refits=self.refits,
        )
        notes = {"method": "Equivariant", **self.notes, "horizon_s": horizon}
        for name in ("A", "B", "offset", "dt", "input_names", "z_start", "refits"):
            object.__setattr__(self, name, getattr(frozen, name))
        object.__setattr__(self, "horizon", horizon)
        object.__setattr__(self, "notes", notes)

    # Frozen models and poles

    def at(self, t: float) -> LatentModel:
        """The model frozen at time t (s since contact), as a plain `LatentModel`."""
        A, B, b = self.dynamics.step_matrices(float(t))
        dt = self.dynamics.dt
        return LatentModel(
            A=(A - np.eye(len(A))) / dt,
            B=B / dt,
            offset=b / dt,
            dt=dt,
            input_names=self.input_names,
            z_start=self.z_start,
            sensor=self._linear_sensor(),
            card=self.card,
            notes={**self.notes, "frozen_at_s": float(t)},
        )

    def _linear_sensor(self) -> StiffnessSensor | None:
        """The sensor as a plain model can hold it: linear about the start."""
        if isinstance(self.sensor, LocalSensor) and self.z_start is not None:
            return self.sensor.frozen(self.z_start)
        return self.sensor

    def labelled_poles(self, t: float | None = None) -> list[Pole]:
        """Continuous poles log(eig A_q)/dt of every charge, frozen at t (default: the end).

        Every pole of a charge above 0 occurs twice in the real plant, by symmetry. The two
        integrators of the centroid are not listed.
        """
        w = self.dynamics.clock.weights(self.horizon if t is None else float(t))
        out = []
        for q, block in enumerate(self.dynamics.blocks):
            with np.errstate(divide="ignore"):
                logs = np.log(sla.eigvals(block.at(w)[0]).astype(complex)) / self.dt
            out += [Pole(complex(v), q, 1 if q == 0 else 2) for v in logs]
        return sorted(out, key=lambda p: -p.value.real)

    # Coordinates

    def encode(self, x: np.ndarray, eta: np.ndarray | None = None) -> np.ndarray:
        """z (m + 2,) or (T, m + 2) from full-order states, and auxiliaries for the load.

        Without `eta` the load part is taken as zero, which holds at contact.
        """
        x = np.asarray(x, dtype=float)
        if x.shape[-1] != self.states.size:
            raise DimensionError(f"x must have {self.states.size} entries, got {x.shape[-1]}")
        flat = np.atleast_2d(x)
        nodes = self.states.view(flat, f"{self.cell}.position")
        loads = None
        if eta is not None:
            eta = np.atleast_2d(np.asarray(eta, dtype=float))
            if eta.shape != (len(flat), self.auxiliaries.size):
                raise DimensionError(
                    f"eta must be ({len(flat)}, {self.auxiliaries.size}), got {eta.shape}"
                )
            loads = [
                self.sites.under(n.mean(axis=0), self.representation.port).load(force)
                for n, force in zip(nodes, self.load_of(eta), strict=True)
            ]
        z = self.encode_cell(nodes, loads)
        return z.reshape(*x.shape[:-1], -1)

    def load_of(self, eta: np.ndarray) -> np.ndarray:
        """Node forces (T, N, 3), pN, of this cell on the matrix among auxiliaries (T, n_eta)."""
        names = [
            b.name
            for b in self.auxiliaries
            if b.name.startswith("matrix.") and b.name.endswith(f".{self.cell}") and b.unit == "pN"
        ]
        return sum((self.auxiliaries.view(eta, n) for n in names), start=np.zeros(()))

    def encode_cell(
        self, nodes: np.ndarray, loads: list[dict[int, np.ndarray]] | None
    ) -> np.ndarray:
        """z (T, m + 2) from node positions (T, n, 3) and load charges."""
        centre, features = self.representation.features(nodes, loads)
        x = self.modes.encode(features)
        parts = tuple(x[q] for q in range(len(self.dynamics.blocks)))
        return self.dynamics.join(CellState(parts, centre[:, :2]))

    def _features(self, z: np.ndarray) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        z = np.asarray(z, dtype=float)
        if z.shape[-1] != self.order:
            raise DimensionError(f"z must have {self.order} entries, got {z.shape[-1]}")
        state = self.dynamics.split(z)
        return state.place, self.modes.decode(dict(enumerate(state.x)))

    def reconstruct(self, z: np.ndarray) -> np.ndarray:
        """Node positions of the cell, (3 n,) or (T, 3 n) node-major, um."""
        nodes = self.nodes(z)
        return nodes.reshape(*nodes.shape[:-2], -1)

    def nodes(self, z: np.ndarray) -> np.ndarray:
        """Node positions (n, 3) or (T, n, 3), um."""
        return self.representation.nodes(*self._features(z))

    def reconstruct_load(self, z: np.ndarray) -> dict[int, np.ndarray]:
        """Charges of the load density, pN/um."""
        return self.representation.load(self._features(z)[1])

    def matrix_forces(self, z: np.ndarray) -> np.ndarray:
        """Forces (N, 3), pN, of the cell on the matrix nodes, from one z (m,)."""
        out = np.zeros(self.states["matrix.displacement"].shape)
        under = self.sites.under(np.asarray(z, dtype=float)[-2:], self.representation.port)
        out[under.nodes] = under.scatter(self.reconstruct_load(z))
        return out

    # Roll-out

    def predict(self, z0: np.ndarray, u: np.ndarray | None, t: np.ndarray) -> np.ndarray:
        """z (T, m + 2) at the times t (s since contact, on the grid of the step).

        `u` (T - 1, n_c) or (n_c,) are the harmonics of `input_names`, held over each interval;
        None commands amplitude 0.
        """
        z0, t, commands, steps = check_roll_out(
            self.order, len(self.input_names), self.dt, z0, u, t
        )
        z = np.empty((len(t), self.order))
        z[0] = z0
        for k, repeats in enumerate(steps):
            now = z[k]
            for i in range(repeats):
                A, B, b = self.dynamics.step_matrices(t[k] + i * self.dt)
                now = A @ now + B @ commands[k] + b
            z[k + 1] = now
        if not np.all(np.isfinite(z)):
            raise DataError("the roll-out left the finite numbers; its commands are too large")
        return z

    def simulate_commands(
        self, z0: np.ndarray, amplitude: np.ndarray, heading: np.ndarray, t0: float = 0.0
    ) -> np.ndarray:
        """z (K + 1, m + 2) under amplitude and heading (K,) held over steps of the model.

        The same as `predict`, charge by charge: m^2 instead of (sum m)^2 operations.
        """
        dynamics, K = self.dynamics, len(amplitude)
        features = dynamics.features(np.asarray(amplitude, float), np.asarray(heading, float))
        w = dynamics.clock.weights(t0 + self.dt * np.arange(K))
        state = dynamics.split(np.asarray(z0, dtype=float))
        xs = []
        for q, block in enumerate(dynamics.blocks):
            A = np.tensordot(w, block.A, 1)
            drive = np.einsum("kij,kj->ki", np.tensordot(w, block.B, 1), features[q])
            x = np.empty((K + 1, block.size), complex if q else float)
            x[0] = state.x[q]
            for k in range(K):
                x[k + 1] = A[k] @ x[k] + drive[k]
            xs.append(x)
        middle = 0.5 * (xs[1][1:] + xs[1][:-1])
        step = np.sum(middle * (w @ dynamics.alone.R_z), axis=1)
        step = step + np.sum(features[1] * (w @ dynamics.alone.R_u), axis=1)
        path = np.concatenate([[0.0], np.cumsum(step)])
        place = state.place + np.stack([path.real, path.imag], axis=-1)
        return dynamics.join(CellState(tuple(xs), place))

    def forecast(
        self,
        amplitude: np.ndarray,
        heading: np.ndarray,
        *,
        z0: np.ndarray | None = None,
        t0: float = 0.0,
        level: float = 0.95,
    ) -> Forecast:
        """Roll-out under amplitude and heading (K,) with error bands and validity flags.

        `level` is one of the bands' levels; widths are NaN for a model without bands.
        """
        start = self.z_start if z0 is None else np.asarray(z0, dtype=float)
        if start is None:
            raise DataError("the model has no start; pass z0=")
        amplitude, heading = np.asarray(amplitude, float), np.asarray(heading, float)
        if amplitude.ndim != 1 or amplitude.shape != heading.shape or not len(amplitude):
            raise DimensionError(
                f"amplitude and heading must be (K,), got {amplitude.shape} and {heading.shape}"
            )
        if not (np.all(np.isfinite(amplitude)) and np.all(np.isfinite(heading))):
            raise DataError("amplitude or heading holds NaN or inf")
        z = self.simulate_commands(start, amplitude, heading, t0)
        t = t0 + self.dt * np.arange(len(z))
        width = np.full((len(z), 3), np.nan)
        if self.bands is not None:
            width[:, :2] = self.bands.at("plane", t, level)[:, None]
            width[:, 2] = self.bands.at("height", t, level)
        flags = () if self.monitor is None else self.monitor.check(self, t, z, amplitude, heading)
        return Forecast(
            t=t, z=z, nodes=self.nodes(z), half_width=width, level=level, flags=tuple(flags)
        )

    # Files

    def save(self, path: str | Path) -> Path:
        """Write arrays, names and card to an npz, atomically; never pickle."""
        return write_parts(self, path)

    @classmethod
    def load(cls, path: str | Path) -> EquivariantModel:
        """The same as `read`; `LatentModel.load` reads models of any kind."""
        return cls.read(path)

    @classmethod
    def read(cls, path: str | Path) -> EquivariantModel:
        """Read back; the contraction certificate is checked again.

        Raises
        ------
        FileFormatError
            Anything else than a whole equivariant model, or one whose norm exceeds 1.
        """
        parts = read_parts(path)
        try:
            model = cls(**parts._asdict())
        except (KeyError, TypeError, ValueError) as error:
            raise FileFormatError(f"{Path(path).name!r} is damaged: {error}") from error
        certified = bool(model.notes.get("contractive", True))
        if certified and model.dynamics.norm() > 1.0 + 1e-12:
            raise FileFormatError(
                f"{Path(path).name!r} claims contraction and has norm "
                f"{model.dynamics.norm():.6g} > 1; it was changed after it was written"
            )
        return model

    def __str__(self) -> str:
        orders = ", ".join(f"{q}: {b.size}" for q, b in enumerate(self.dynamics.blocks))
        head = (
            f"EquivariantModel: order {self.order} (charges {orders}; centroid 2), step of "
            f"{self.dt:g} s, contraction norm {self.dynamics.norm():.6f}"
        )
        return head if self.card is None else f"{head}\n{self.card}"
