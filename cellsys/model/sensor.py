"""The sensor: the sensed cue by ridge regression on the latent state.

    d ~ K_d [1; z]        |d| = 1 after normalisation                     [thesis eq. 84]
    g ~ K_d [1; z]        d = (g/g0) x/(1 + x^2),  x = |g|/g0             graded cue

Of runs with a graded cue (`cellsys.laws.sensing`) the contrast g is learned, not the direction
g/|g|, which a network without contrast fills with noise.

The thesis's regressors [P_F z; P_c z] are linear in z and rank-deficient together, so z itself
is used [notes: theory, sensor].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.laws.sensing import cue_rows, ungraded
from cellsys.model.sensor_block import sensor_block
from cellsys.units import real_array

if TYPE_CHECKING:
    from control import NonlinearIOSystem

_ERRORS = ("training_error", "held_out_error", "constant_error")


@checked
@dataclass(frozen=True, eq=False)
class StiffnessSensor:
    """Linear read-out of the sensed direction.

    Parameters
    ----------
    K_d : (3, 1 + m)
        Intercept first.
    ridge : float
        Penalty on standardised regressors, chosen by leaving out one run at a time.
    training_error, held_out_error, constant_error : float
        On training runs, on held-out runs (NaN when there were none), and of the best constant
        on the same runs: mean angle error in deg, of a graded cue the rms error of g.
    noise : float
        g0 of a graded cue: K_d [1; z] is then a contrast g. 0: it is a direction.
    strength : float
        Mean |g|/g0 of the training runs: how far the cue stands out of the network's noise.
    """

    K_d: np.ndarray
    _: KW_ONLY
    ridge: float = 0.0
    training_error: float = float("nan")
    held_out_error: float = float("nan")
    constant_error: float = float("nan")
    noise: float = 0.0
    strength: float = float("nan")

    def __post_init__(self) -> None:
        K_d = real_array(self.K_d, "K_d").copy()
        if K_d.ndim != 2 or K_d.shape[0] != 3 or K_d.shape[1] < 2:
            raise DimensionError(f"K_d must be (3, 1 + m), got {K_d.shape}")
        if not np.all(np.isfinite(K_d)):
            raise DataError("K_d holds NaN or inf")
        if np.abs(K_d).max() > 1e150:
            raise DataError("K_d holds numbers beyond 1e150: their squares are no doubles")
        object.__setattr__(self, "K_d", K_d)
        for name in (*_ERRORS, "ridge", "noise", "strength"):
            object.__setattr__(self, name, float(getattr(self, name)))
        if not (np.isfinite(self.noise) and self.noise >= 0.0):
            raise ParameterError(f"noise must be finite and >= 0, got {self.noise!r}")

    @property
    def error_unit(self) -> str:
        """Of the errors: "deg" of a direction, "of g" of a graded cue."""
        return "of g" if self.noise else "deg"

    @property
    def S_d(self) -> np.ndarray:
        """K_d without its intercept column (3, m)."""
        return self.K_d[:, 1:]

    def raw(self, z: np.ndarray) -> np.ndarray:
        """K_d [1; z], not normalised: (3,) or (T, 3)."""
        return self.K_d[:, 0] + np.asarray(z) @ self.S_d.T

    def direction(self, z: np.ndarray) -> np.ndarray:
        """Unit direction, or graded cue; a raw value of zero stays zero (nothing then turns)."""
        d = self.raw(z)
        if self.noise:
            return cue_rows(d, self.noise)
        norm = np.linalg.norm(d, axis=-1, keepdims=True)
        return np.divide(d, norm, out=np.zeros_like(d), where=norm > 0)

    def block(self, cells: Sequence[str] = ("",), *, normalise: bool = True) -> NonlinearIOSystem:
        """The sensor as a static block of python-control: inputs z[i], outputs d_x, d_y, d_z.

        Parameters
        ----------
        cells : sequence of str
            What the signals of each cell begin with, such as ``("cell1_", "cell2_")``.
        normalise : bool
            Scale d to unit length, as `direction`, or not, as `raw`.
        """
        read = self.direction if normalise else self.raw
        return sensor_block(read, self.S_d.shape[1], cells)

    def arrays(self) -> Mapping[str, np.ndarray]:
        """Plain arrays for a file."""
        return {
            "K_d": self.K_d,
            "ridge": np.array(self.ridge),
            "training_error": np.array(self.training_error),
            "held_out_error": np.array(self.held_out_error),
            "constant_error": np.array(self.constant_error),
            "noise": np.array(self.noise),
            "strength": np.array(self.strength),
        }


def angle_error(predicted: np.ndarray, true: np.ndarray) -> float:
    """Mean angle between rows, deg; a zero prediction counts as 90 deg."""
    norm = np.linalg.norm(predicted, axis=1) * np.linalg.norm(true, axis=1)
    cosine = np.divide(
        (predicted * true).sum(axis=1), norm, out=np.zeros(len(true)), where=norm > 0
    )
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).mean())


def vector_error(predicted: np.ndarray, true: np.ndarray) -> float:
    """Root of the mean squared distance between rows, in their unit."""
    return float(np.sqrt(np.mean(((predicted - true) ** 2).sum(axis=1))))


def contrasts(directions: Sequence[np.ndarray], noise: float) -> list[np.ndarray]:
    """What is learned of recorded cues, lists of (T_i, 3): g of graded ones, else d itself."""
    if not noise:
        return list(directions)
    return [np.column_stack([ungraded(d[:, :2], noise), 0.0 * d[:, 2]]) for d in directions]


def mean_strength(targets: Sequence[np.ndarray], noise: float) -> float:
    """Mean |g|/g0; NaN of directions."""
    if not noise:
        return float("nan")
    return float(np.linalg.norm(np.concatenate(targets), axis=1).mean()) / noise


@checked
def fit_sensor(
    latent: list[np.ndarray],
    directions: list[np.ndarray],
    test_latent: list[np.ndarray] | None = None,
    test_directions: list[np.ndarray] | None = None,
    ridges: tuple[float, ...] = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0),
    *,
    literal: bool = False,
    maps: tuple[np.ndarray, np.ndarray] | None = None,
    noise: float = 0.0,
) -> StiffnessSensor:
    """Ridge regression of d on [1; z], the penalty chosen by leaving out one run at a time.

    Parameters
    ----------
    latent : list of (T_i, m)
        Latent samples of each run.
    directions : list of (T_i, 3)
        Sensed cues d at the same samples.
    test_latent, test_directions : optional
        Held-out runs for the reported error.
    ridges : tuple of float
        Penalties tried, relative to the number of samples.
    literal : bool
        As printed [84]: regressors [P_F z; P_c z], the matrix forces and the cell's centre, by
        least squares (of least norm, for the 2 m regressors have rank m at most).
    maps : (m, m) and (m, m), optional
        P_F and P_c of the literal form, such as `P_F_phi(model)` and `P_c(model)`.
    noise : float
        g0 of graded cues; 0: the directions have length 1.
    """
    if literal != (maps is not None):
        raise ParameterError("literal=True and maps=(P_F, P_c) go together")
    if maps is not None:
        if noise:
            raise ParameterError("the literal sensor reads directions of length 1; leave noise out")
        return _literal(latent, directions, test_latent, test_directions, maps)
    if not latent or len(latent) != len(directions):
        raise DataError("a sensor needs as many runs of latent samples as of directions")
    for i, (z, d) in enumerate(zip(latent, directions, strict=True)):
        if np.ndim(z) != 2 or np.shape(d) != (len(z), 3):
            raise DimensionError(
                f"run {i} needs latent samples (T, m) and directions (T, 3), got {np.shape(z)} and "
                f"{np.shape(d)}"
            )
        if not (np.all(np.isfinite(z)) and np.all(np.isfinite(d))):
            raise DataError(f"run {i} of the sensor's samples holds NaN or inf")

    if not ridges:
        raise ParameterError("ridges must hold at least one number")
    error = vector_error if noise else angle_error
    directions = contrasts(directions, noise)
    if test_directions:
        test_directions = contrasts(test_directions, noise)
    total = np.zeros(len(ridges))
    for i in range(len(latent)):
        others = [k for k in range(len(latent)) if k != i] or [i]
        tried = ridge_maps([latent[k] for k in others], [directions[k] for k in others], ridges)
        total += [error(_predict(K, latent[i]), directions[i]) for K in tried]
    best = ridges[int(np.argmin(total))]
    K_d = ridge_maps(latent, directions, (best,))[0]
    mean = np.concatenate(directions).mean(axis=0)
    shown_z, shown_d = (
        (test_latent, test_directions) if test_latent and test_directions else (latent, directions)
    )
    truth = np.concatenate(shown_d)
    return StiffnessSensor(
        K_d=K_d,
        ridge=best,
        training_error=error(_predict(K_d, np.concatenate(latent)), np.concatenate(directions)),
        held_out_error=error(_predict(K_d, np.concatenate(shown_z)), truth)
        if test_latent
        else float("nan"),
        constant_error=error(np.tile(mean, (len(truth), 1)), truth),
        noise=noise,
        strength=mean_strength(directions, noise),
    )


def _literal(
    latent: list[np.ndarray],
    directions: list[np.ndarray],
    test_latent: list[np.ndarray] | None,
    test_directions: list[np.ndarray] | None,
    maps: tuple[np.ndarray, np.ndarray],
) -> StiffnessSensor:
    """The sensor on [P_F z; P_c z], its map written back on z."""
    both = np.vstack([real_array(part, "maps") for part in maps])
    m = both.shape[1]
    if both.shape != (2 * m, m) or not latent or any(np.shape(z)[-1] != m for z in latent):
        raise DimensionError(f"maps must be two (m, m) for latent samples (T, m), got {both.shape}")
    seen = [np.asarray(z) @ both.T for z in latent]
    tests = None if test_latent is None else [np.asarray(z) @ both.T for z in test_latent]
    found = fit_sensor(seen, directions, tests, test_directions, (0.0,))
    K_d = np.column_stack([found.K_d[:, 0], found.S_d @ both])
    return replace(found, K_d=K_d)


def _predict(K_d: np.ndarray, z: np.ndarray) -> np.ndarray:
    return K_d[:, 0] + z @ K_d[:, 1:].T


def ridge_maps(
    latent: list[np.ndarray], directions: list[np.ndarray], ridges: tuple[float, ...]
) -> list[np.ndarray]:
    """K_d (3, 1 + m) for each penalty ridge * samples: standardised regressors, intercept free.

    One singular value decomposition X = U S V^T serves all: K = V S (S^2 + ridge n)^-1 U^T D.
    """
    Z, D = np.concatenate(latent), np.concatenate(directions)
    center, spread = Z.mean(axis=0), Z.std(axis=0)
    spread[spread == 0] = 1.0
    X, mean = (Z - center) / spread, D.mean(axis=0)
    U, s, Vt = sla.svd(X, full_matrices=False)
    seen = U.T @ (D - mean)
    out = []
    for ridge in ridges:
        # A ridge of 0 leaves out what the samples do not determine.
        strength = s**2 + ridge * len(X)
        known = strength > (1e-13 * s.max(initial=0.0)) ** 2
        weight = np.divide(s, strength, out=np.zeros_like(s), where=known)
        slope = ((Vt.T @ (weight[:, None] * seen)) / spread[:, None]).T
        out.append(np.column_stack([mean - slope @ center, slope]))
    return out


def ridge_weights(X: np.ndarray, y: np.ndarray, ridge: float) -> np.ndarray:
    """Weights (n,) of columns scaled to rms 1, without intercept; penalty ridge * samples."""
    size = np.sqrt(np.mean(X**2, axis=0))
    size[size == 0] = 1.0
    penalty = np.sqrt(ridge * len(y)) * np.eye(len(size))
    rows = np.vstack([X / size, penalty])
    return sla.lstsq(rows, np.concatenate([y, np.zeros(len(size))]))[0] / size
