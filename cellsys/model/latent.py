"""`LatentModel`: a reduced affine model z' = A z + B c + b with its basis and its card."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import ReducedModel
from cellsys.errors import (
    DataError,
    DimensionError,
    FileFormatError,
    ParameterError,
    RepresentationError,
)
from cellsys.kinds import FILLED, Filled, Takes
from cellsys.model.affine import AffineModel
from cellsys.model.card import Card
from cellsys.model.file import ARRAYS, kind_of_file, load_model, save_model
from cellsys.model.hold import check_roll_out, roll
from cellsys.model.sensor import StiffnessSensor
from cellsys.system import Layout
from cellsys.units import real_array, real_number


def _row_indices(name: str, rows: Sequence[int] | np.ndarray) -> np.ndarray:
    found = np.asarray(list(rows))
    if found.size and (found.ndim != 1 or found.dtype.kind not in "iu"):
        raise DataError(f"blocks[{name!r}] must list whole row numbers, got {found.dtype}")
    return found.astype(int)


class _Rows(NamedTuple):
    """The basis, mean and scale of the rows [x; eta], and how many of them are states."""

    V: np.ndarray
    mean: np.ndarray
    scale: np.ndarray
    n: int


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class LatentModel(AffineModel):
    """A reduced model, continuous or the generator of a step.

        dt is None :  z' = A z + B c + b
        dt given   :  z+ = z + dt (A z + B c + b)          [thesis eq. 24]

    with z = V^T S^-1 (x~ - mean) and x~ = [x; eta] ~ mean + S V z [notes: theory, regression].

    Parameters
    ----------
    A : (m, m), 1/s
    B : (m, n_c), optional
        Input map of the commands c.
    offset : (m,), optional
        b, 1/s.
    V : (n + n_eta, m), optional
        Orthonormal basis; rows of the states first.
    mean, scale : (n + n_eta,), optional
        Centre and scale factors; a scale of 0 marks a dropped column.
    singular_values : (m,), optional
    dt : float, optional
        Step of a step model, s.
    n_states : int, optional
        n; the remaining rows of V belong to eta.
    blocks : mapping of str to indices, optional
        Rows of V by role: ``component`` (cells) and ``field`` (matrix).
    states, auxiliaries : Layout, optional
        Names of the rows of V.
    input_names : sequence of str, optional
    z_start : (m,), optional
        Latent state at the start of the training runs (their mean).
    sensor : StiffnessSensor, optional
    card : Card, optional
        What the model is worth; see `cellsys.model.card`.
    refits : (k, m, m), optional
        A of the same model learned without a part of the data, 1/s; `left_out` says what a part
        is ("run", "group of runs", "stretch"). See `certainty`.

    Raises
    ------
    DataError, DimensionError
        NaN or inf, or arrays that do not fit together.
    """

    A: np.ndarray
    B: Filled[np.ndarray] = FILLED
    offset: Filled[np.ndarray] = FILLED
    V: np.ndarray | None = None
    mean: np.ndarray | None = None
    scale: np.ndarray | None = None
    singular_values: np.ndarray | None = None
    dt: float | None = None
    n_states: int | None = None
    blocks: Annotated[Mapping[str, np.ndarray], Takes(Mapping[str, Sequence[int]])] = field(
        default_factory=dict
    )
    states: Layout | None = None
    auxiliaries: Layout | None = None
    input_names: Filled[tuple[str, ...]] = FILLED
    z_start: np.ndarray | None = None
    sensor: StiffnessSensor | None = None
    card: Card | None = None
    notes: Mapping[str, Any] = field(default_factory=dict)
    refits: np.ndarray | None = None
    left_out: str = "run"

    _figure: ClassVar[str] = "latent_model"

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        for name in ARRAYS:
            if getattr(self, name) is not None or name == "A":
                put(name, real_array(getattr(self, name), name).copy())
        A = np.atleast_2d(self.A)
        m = A.shape[0]
        if A.shape != (m, m) or m == 0:
            raise DimensionError(f"A must be square and not empty, got {A.shape}")
        put("A", A)
        B = np.zeros((m, 0)) if self.B is None else self.B
        put("B", B.reshape(m, -1) if B.ndim < 2 and B.size % m == 0 else B)
        put("offset", np.zeros(m) if self.offset is None else self.offset)
        V = self.V
        if V is not None and V.ndim != 2:
            raise DimensionError(f"V must be a matrix, got shape {V.shape}")
        shapes: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
            "B": (self.B.shape, (m, *self.B.shape[-1:])),
            "offset": (self.offset.shape, (m,)),
        }
        if self.z_start is not None:
            shapes["z_start"] = (self.z_start.shape, (m,))
        if self.refits is not None:
            shapes["refits"] = (self.refits.shape, (*self.refits.shape[:1], m, m))
        if V is not None:
            rows = len(V)
            mean = np.zeros(rows) if self.mean is None else self.mean
            scale = np.ones(rows) if self.scale is None else self.scale
            n = rows if self.n_states is None else int(self.n_states)
            put("mean", mean)
            put("scale", scale)
            put("n_states", n)
            shapes |= {
                "V": (V.shape, (rows, m)),
                "mean": (mean.shape, (rows,)),
                "scale": (scale.shape, (rows,)),
            }
            if np.any(scale < 0):
                raise DataError("scale holds a negative factor; 0 marks a dropped column")
            if not 0 <= n <= rows:
                raise DimensionError(f"n_states must be between 0 and {rows}, got {n}")
        for name, (got, expected) in shapes.items():
            if got != expected:
                raise DimensionError(f"{name} must have shape {expected}, got {got}")
        for name in ARRAYS:
            value = getattr(self, name)
            if value is None:
                continue
            if not np.all(np.isfinite(value)):
                raise DataError(f"{name} holds NaN or inf; a model cannot be made from it")
            # A may hold any rate: its growth is what a roll-out is refused for.
            if name not in ("A", "refits") and np.abs(value).max(initial=0.0) > 1e150:
                raise DataError(
                    f"{name} holds {np.abs(value).max():.3g}, beyond 1e150: its squares are no "
                    "doubles; take other units"
                )
            value.setflags(write=False)
        if self.dt is not None and not real_number(self.dt, "dt") > 0:
            raise ParameterError(
                f"dt must be > 0 s (or None for a continuous model), got {self.dt!r}"
            )
        if not real_number(self.notes.get("horizon_s", 1.0), "notes['horizon_s']") > 0:
            raise ParameterError("notes['horizon_s'] must be > 0 s")
        names = self.input_names
        if names is None:
            names = tuple(f"c[{i}]" for i in range(self.B.shape[1]))
        if len(names) != self.B.shape[1]:
            raise DimensionError(f"{len(names)} input names for {self.B.shape[1]} inputs")
        put("input_names", tuple(names))
        put("blocks", {k: _row_indices(k, v) for k, v in dict(self.blocks).items()})
        for name, rows_of in self.blocks.items():
            if V is None or np.any(rows_of < 0) or np.any(rows_of >= len(V)):
                raise DimensionError(f"block {name!r} names rows that V does not have")

    # Shape and parts

    def _basis(self, name: str) -> _Rows:
        V, mean, scale, n = self.V, self.mean, self.scale, self.n_states
        if V is None or mean is None or scale is None or n is None:
            raise RepresentationError(
                f"this model was given without a basis, so it has no {name}; pass V=..."
            )
        return _Rows(V, mean, scale, n)

    @property
    def V_x(self) -> np.ndarray:
        """Rows of V that belong to the states (n, m)."""
        rows = self._basis("V_x")
        return rows.V[: rows.n]

    @property
    def V_eta(self) -> np.ndarray:
        """Rows of V that belong to the auxiliaries (n_eta, m)."""
        rows = self._basis("V_eta")
        return rows.V[rows.n :]

    # Coordinates

    def encode(self, x: np.ndarray, eta: np.ndarray | None = None) -> np.ndarray:
        """z of one sample (n,) or of many (T, n).

        With `eta` the projection V^T S^-1 (x~ - mean). Without, the least-squares z that
        reproduces x (minimum norm; directions below 1e-8 of the largest are left at zero). A
        model of states alone, V (n, m), does not look at `eta`.
        """
        V, mean, scale, n = self._basis("encode")
        x = np.asarray(x, dtype=float)
        if x.shape[-1] != n:
            raise DimensionError(f"x must have {n} entries, got {x.shape[-1]}")
        inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
        centred = (x - mean[:n]) * inverse[:n]
        if n == len(V):
            return centred @ V
        if eta is None:
            flat = np.atleast_2d(centred)
            z = sla.lstsq(V[:n], flat.T, cond=1e-8)[0].T
            return z.reshape(*x.shape[:-1], self.order)
        eta = np.asarray(eta, dtype=float)
        if eta.shape[-1] != len(V) - n:
            raise DimensionError(f"eta must have {len(V) - n} entries, got {eta.shape[-1]}")
        return centred @ V[:n] + ((eta - mean[n:]) * inverse[n:]) @ V[n:]

    def reconstruct(self, z: np.ndarray) -> np.ndarray:
        """x (n,) or (T, n) from z (m,) or (T, m)."""
        V, mean, scale, n = self._basis("reconstruct")
        return mean[:n] + (np.asarray(z) @ V[:n].T) * scale[:n]

    def reconstruct_eta(self, z: np.ndarray) -> np.ndarray:
        """eta (n_eta,) or (T, n_eta) from z."""
        V, mean, scale, n = self._basis("reconstruct_eta")
        return mean[n:] + (np.asarray(z) @ V[n:].T) * scale[n:]

    # Dynamics

    def predict(self, z0: np.ndarray, u: np.ndarray | None, t: np.ndarray) -> np.ndarray:
        """Roll the model out from z0 (m,) at the times t (T,); returns z (T, m).

        Parameters
        ----------
        u : array (T - 1, n_c) or (n_c,) or None
            Commands, held over each interval; None for zero.
        t : array (T,)
            s. For a step model on its grid, otherwise refused.

        Raises
        ------
        IntegrationError
            When the model grows beyond 1e150 times its start: time, norm and rate are given.
        """
        z0, t, c, repeats = check_roll_out(self.order, self.B.shape[1], self.dt, z0, u, t)
        matrices = (lambda dt: self.step_matrices()) if self.dt is not None else self.step_matrices
        return roll(z0, c, t, repeats, matrices, self.growth)

    def at(self, t: float) -> LatentModel:
        """The model frozen at time t, s: itself, its matrices follow no clock."""
        return self

    # Files

    def save(self, path: str | Path) -> Path:
        """Write arrays, names and card to an npz (schema version 1), atomically; never pickle."""
        return save_model(self, path)

    @classmethod
    def load(cls, path: str | Path) -> AffineModel:
        """Read back a saved model of any kind; FileFormatError for anything else."""
        if cls is LatentModel:
            return kind_of_file(path).read(path)
        return cls.read(path)

    @classmethod
    def read(cls, path: str | Path) -> LatentModel:
        """Read back a model of this very kind."""
        values, sensor = load_model(path)
        try:
            return cls(**values, sensor=None if sensor is None else StiffnessSensor(**sensor))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise FileFormatError(f"{Path(path).name!r} is damaged: {error}") from error

    def __str__(self) -> str:
        kind = "continuous" if self.dt is None else f"step of {self.dt:g} s"
        head = (
            f"LatentModel: order {self.order}, {kind}, {len(self.input_names)} inputs, "
            f"spectral abscissa {self.growth():.3g} 1/s"
        )
        return head if self.card is None else f"{head}\n{self.card}"


def with_basis(model: object, what: str) -> tuple[LatentModel, np.ndarray]:
    """The model and its V (n + n_eta, m) where its coordinates have a basis; else refused by name.

    Parameters
    ----------
    model : object
    what : str
        What needs V, for the message.

    Raises
    ------
    RepresentationError
        A model of another kind, or a `LatentModel` given without V.
    """
    if not isinstance(model, LatentModel) or model.V is None:
        raise RepresentationError(
            f"{what} needs the rows of V, and this {type(model).__name__} has none; use LoadPorts, "
            "or a model reduced with PCR or LeastSquares (a LatentModel made from arrays: pass V=)"
        )
    return model, model.V


@checked
def basis_of(model: ReducedModel, what: str) -> np.ndarray:
    """V alone; see `with_basis`."""
    return with_basis(model, what)[1]
