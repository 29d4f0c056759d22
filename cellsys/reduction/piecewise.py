"""Trajectory piecewise linear models (Rewienski & White 2003)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Literal, overload

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.drawable import Drawable
from cellsys.errors import DataError, DimensionError, IntegrationError, ParameterError
from cellsys.kinds import FILLED, Filled
from cellsys.model.card import Card
from cellsys.model.hold import check_roll_out
from cellsys.model.latent import LatentModel
from cellsys.model.plant import Offset
from cellsys.model.poles import fastest_growth, pole_set
from cellsys.model.sensor import StiffnessSensor
from cellsys.model.trained_range import Flag, TrainedRange
from cellsys.reduction.basis import Basis, ExactSVD, RandomisedSVD, fit_basis
from cellsys.reduction.jacobian import linearised, rows_in, states_only
from cellsys.reduction.regression import input_map, learned_model
from cellsys.samples.snapshots import Snapshots
from cellsys.spectra.roots import RootSet
from cellsys.system import OdeSystem
from cellsys.units import shaped_array

if TYPE_CHECKING:
    import control

_SHARP = 25.0  # beta of Rewienski & White: the nearest point weighs most
_GAMMA = 1.0 + np.sqrt(0.5)  # ROS2: L-stable


@checked
@dataclass(frozen=True)
class TPWL:
    """Linearisations at several states of a training run, blended by nearness.

        z' = sum_i w_i(z) (A_i z + b_i) + B c ,   w_i ~ exp(-25 d_i / min d) ,  d_i = |z - z_i|

    Points are taken along the first run (then the next ones) wherever the state is farthest from
    those already taken, in z.

    Parameters
    ----------
    system : OdeSystem
        See `Jacobian`.
    points : int
        Linearisation points, >= 1; 1 is a `Jacobian` at the start.
    svd : ExactSVD or RandomisedSVD, optional
        See `fit_basis`.
    """

    system: OdeSystem
    points: int = 10
    svd: ExactSVD | RandomisedSVD | None = field(default=None, kw_only=True)

    name: ClassVar[str] = "TPWL"
    own_basis: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.points < 1:
            raise ParameterError(f"TPWL.points must be >= 1, got {self.points!r}")

    def __repr__(self) -> str:
        return f"TPWL({type(self.system).__name__}, points={self.points})"

    def fit(
        self,
        data: Snapshots,
        order: int,
        *,
        test: Snapshots | None = None,
        basis: Basis | None = None,
    ) -> PiecewiseModel:
        """Model of order `order` in the basis of the states; `basis` is not used."""
        alone = states_only(data)
        basis = fit_basis(alone, order, method=self.svd)
        rows = rows_in(self.system, data)
        weight = basis.inverse_scale()[:, None] * basis.V
        places = [(i, k) for i, run in enumerate(data.runs) for k in range(len(run.x))]
        z = np.concatenate([(np.asarray(run.x) - basis.mean) @ weight for run in data.runs])
        taken = farthest_points(z, self.points)
        A, b = [], []
        for i, k in (places[j] for j in taken):
            x = np.array(self.system.x0)
            x[rows] = data.runs[i].x[k]
            one = linearised(self.system, k * data.dt, x, rows, basis)
            A.append(one[0])
            b.append(one[1])
        B, b_u, names, explained = input_map(data, weight, 1e-13)
        frozen = learned_model(
            alone,
            basis,
            A[0],
            B=B,
            offset=b[0] + b_u,
            input_names=names,
            notes={"method": repr(self), "input_share_explained": explained},
        )
        return PiecewiseModel(
            frozen=frozen, points=z[taken], A=np.array(A), offset=np.array(b) + b_u, step=data.dt
        )


def farthest_points(z: np.ndarray, count: int) -> list[int]:
    """Rows of z (N, m): the first, then always the one farthest from those taken."""
    taken, distance = [0], np.linalg.norm(z - z[0], axis=1)
    while len(taken) < min(count, len(z)) and distance.max() > 0:
        taken.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(z - z[taken[-1]], axis=1))
    return taken


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class PiecewiseModel(Drawable):
    """z' = sum_i w_i(z) (A_i z + b_i) + B c, with the coordinates of a `LatentModel`.

    Parameters
    ----------
    frozen : LatentModel
        Coordinates and inputs; its A, b are those of the first point.
    points : (p, m)
        z_i.
    A, offset : (p, m, m), (p, m)
    step : float
        Largest step of its integration, s.
    """

    frozen: LatentModel
    points: np.ndarray
    A: np.ndarray
    offset: np.ndarray
    step: float
    card: Card | None = None
    sensor: StiffnessSensor | None = None
    z_start: np.ndarray | None = None
    notes: Filled[Mapping[str, object]] = FILLED

    _figure: ClassVar[str] = "latent_model"

    def __post_init__(self) -> None:
        p, m = shaped_array(self.points, "points", (None, None)).shape
        if self.A.shape != (p, m, m) or self.offset.shape != (p, m) or m != self.frozen.order:
            raise DimensionError(
                f"{p} points of order {m} need A ({p}, {m}, {m}) and offset ({p}, {m}), got "
                f"{self.A.shape} and {self.offset.shape}"
            )
        if not all(np.all(np.isfinite(a)) for a in (self.points, self.A, self.offset)):
            raise DataError("a piecewise model holds NaN or inf")
        if self.notes is None:
            object.__setattr__(self, "notes", dict(self.frozen.notes))

    @property
    def order(self) -> int:
        """m."""
        return self.frozen.order

    @property
    def dt(self) -> None:
        """None: the model is continuous."""
        return None

    @property
    def B(self) -> np.ndarray:
        """Input map (m, n_c)."""
        return self.frozen.B

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the commands."""
        return self.frozen.input_names

    def encode(self, x: np.ndarray, eta: np.ndarray | None = None) -> np.ndarray:
        """z (m,) or (T, m) from states; `eta` is not used."""
        return self.frozen.encode(x)

    def reconstruct(self, z: np.ndarray) -> np.ndarray:
        """x from z; see `LatentModel.reconstruct`."""
        return self.frozen.reconstruct(z)

    def weights(self, z: np.ndarray) -> np.ndarray:
        """w_i (p,) at z, summing to 1."""
        d = np.linalg.norm(self.points - z, axis=1)
        least = d.min()
        w = (d == 0).astype(float) if least == 0 else np.exp(-_SHARP * (d - least) / least)
        return w / w.sum()

    def at(self, z: float | np.ndarray) -> LatentModel:
        """The blend of linearisations at z (m,) as a `LatentModel`: its poles, its plant.

        At a time, s, it is the blend at the training start: the model follows no clock.
        """
        w = self.weights(self._start() if np.ndim(z) == 0 else np.asarray(z, dtype=float))
        return dataclasses.replace(
            self.frozen, A=np.tensordot(w, self.A, 1), offset=w @ self.offset, notes={}
        )

    def poles(self, z: np.ndarray | None = None) -> np.ndarray:
        """Poles (m,), 1/s, of the blend at z; default the training start, else the first point."""
        return self.at(self._start() if z is None else z).poles()

    def _start(self) -> np.ndarray:
        return self.points[0] if self.z_start is None else self.z_start

    def step_matrices(self, dt: float | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(A_d, B_d, b_d) over a step of dt seconds of the blend at the training start."""
        return self.at(0.0).step_matrices(dt)

    @overload
    def plant(self, *, offset: Literal["input", "drop"] = "input") -> control.StateSpace: ...

    @overload
    def plant(self, *, offset: Literal["shifted"]) -> tuple[control.StateSpace, np.ndarray]: ...

    def plant(
        self, *, offset: Offset = "input"
    ) -> control.StateSpace | tuple[control.StateSpace, np.ndarray]:
        """The blend at the training start as `control.StateSpace`; see `LatentModel.plant`."""
        blend = self.at(0.0)
        return blend.plant(offset="shifted") if offset == "shifted" else blend.plant(offset=offset)

    def validity(self, t: np.ndarray, z: np.ndarray, u: np.ndarray | None = None) -> list[Flag]:
        """Flags where a roll-out leaves the trained range; see `LatentModel.validity`."""
        return TrainedRange.kept(self).check(t, z, u, self.input_names)

    def growth(self) -> float:
        """Largest spectral abscissa of all linearisations, 1/s."""
        return max(float(sla.eigvals(A).real.max()) for A in self.A)

    def pole_set(self) -> RootSet:
        """Poles of the linearisation that most certainly grows, with bounds of rounding."""
        every = [pole_set(A, None, None) for A in self.A]
        return max(every, key=lambda found: np.subtract(*fastest_growth(found)))

    # Overflow ends in inf or NaN, which is turned into an error.
    @np.errstate(over="ignore", invalid="ignore")
    def predict(self, z0: np.ndarray, u: np.ndarray | None, t: np.ndarray) -> np.ndarray:
        """z (T, m) at the times t (T,); commands u (T - 1, n_c), (n_c,) or None are held.

        ROS2 (Verwer et al. 1999), L-stable and of order 2 although the derivative of the weights
        is left out, in steps of at most `step`.

        Raises
        ------
        IntegrationError
            Where the model leaves all bounds; time, norm and step are given.
        """
        z, t, c, _ = check_roll_out(self.order, self.B.shape[1], None, z0, u, t)
        steps = np.diff(t)
        out = np.empty((len(t), self.order))
        out[0] = z
        limit = 1e150 * max(1.0, float(np.abs(z).max(initial=0.0)))
        for k, whole in enumerate(steps):
            n, drive = max(1, int(np.ceil(whole / self.step - 1e-9))), self.B @ c[k]
            for _ in range(n):
                z = self._step(z, drive, whole / n)
            if not float(np.abs(z).max()) < limit:
                raise IntegrationError(
                    f"the piecewise linear model diverges: spectral abscissa up to "
                    f"{self.growth():.3g} 1/s; take more points or a lower order",
                    time=float(t[k + 1]),
                    state_norm=float(np.linalg.norm(out[k])),
                    step=float(whole / n),
                )
            out[k + 1] = z
        return out

    def _step(self, z: np.ndarray, drive: np.ndarray, h: float) -> np.ndarray:
        def blend(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            w = self.weights(z)
            near = np.flatnonzero(w > 1e-12)
            return np.tensordot(w[near], self.A[near], 1), w[near] @ self.offset[near] + drive

        if not np.all(np.isfinite(z)):
            return z
        A, b = blend(z)
        factors = sla.lu_factor(np.eye(len(z)) - h * _GAMMA * A, check_finite=False)
        k1 = sla.lu_solve(factors, A @ z + b, check_finite=False)
        there = z + h * k1
        if not np.all(np.isfinite(there)):
            return there
        A, b = blend(there)
        k2 = sla.lu_solve(factors, A @ there + b - 2.0 * k1, check_finite=False)
        return z + h * (1.5 * k1 + 0.5 * k2)

    def __str__(self) -> str:
        head = f"PiecewiseModel: order {self.order}, {len(self.points)} points"
        return head if self.card is None else f"{head}\n{self.card}"
