"""Continuous poles of a generator A, of an ODE or of a step, and what is known of their errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.linalg as sla

from cellsys.errors import ParameterError
from cellsys.spectra.certainty import PoleCertainty, data_note, fastest, spread_of, widened
from cellsys.spectra.roots import RootSet, poles_of
from cellsys.spectra.spectrum import Spectrum, spectrum


def _log(step: np.ndarray, dt: float) -> np.ndarray:
    with np.errstate(divide="ignore"):
        log = np.log(step.astype(complex))
    # By parts: -inf (an eigenvalue 0) must not turn the imaginary part into NaN.
    return log.real / dt + 1j * (log.imag / dt)


def continuous_poles(A: np.ndarray, dt: float | None) -> np.ndarray:
    """(m,), 1/s: eig(A), or log(eig(I + dt A))/dt of a step of dt seconds."""
    if dt is None:
        return sla.eigvals(A)
    return _log(sla.eigvals(np.eye(len(A)) + dt * A), dt)


def continuous_spectrum(A: np.ndarray, dt: float | None) -> Spectrum:
    """The same poles with the bounds of rounding, 1/s."""
    if dt is None:
        return spectrum(A)
    found = spectrum(np.eye(len(A)) + dt * A)
    size = np.abs(found.values)
    with np.errstate(divide="ignore"):
        # |log z - log(z + e)| <= -log(1 - |e|/|z|), and not known from |e| = |z| on.
        bound = -np.log1p(-np.minimum(found.bound / np.maximum(size, 1e-300), 1.0)) / dt
    return replace(found, values=_log(found.values, dt), bound=bound)


def certainty_of(
    A: np.ndarray, dt: float | None, refits: np.ndarray, left_out: str, *, discrete: bool
) -> PoleCertainty:
    """How far each pole of A (m, m) moves in the `refits` (k, m, m); see `LatentModel.certainty`.

    Raises
    ------
    ParameterError
        For discrete poles of a continuous model.
    """
    every = np.concatenate([A[None], refits])
    if not discrete:
        own, *others = (continuous_poles(a, dt) for a in every)
        return PoleCertainty(own, spread_of(own, others), left_out)
    if dt is None:
        raise ParameterError("a continuous model has no step of its own")
    own, *others = np.linalg.eigvals(np.eye(len(A)) + dt * every)
    return PoleCertainty(own, spread_of(own, others), left_out, float(dt))


def pole_set(A: np.ndarray, dt: float | None, certainty: PoleCertainty | None) -> RootSet:
    """Continuous poles, 1/s, by falling real part; bounds the larger of rounding and data."""
    found = widened(continuous_spectrum(A, dt), certainty, 0.0)
    return poles_of(found, 0.0, "" if certainty is None else data_note(certainty))


@runtime_checkable
class KnowsCertainty(Protocol):
    """A model that knows what its data leave open of its poles, made by cs.reduce."""

    def certainty(self) -> PoleCertainty | None:
        """How far each pole moves when a part of the data is left out; None where not known."""


def fastest_growth(found: np.ndarray) -> tuple[float, float]:
    """Rate, 1/s, and bound of the pole that most certainly grows; see `LatentModel`.

    Poles that a model of one's own gives as a plain array are taken as they are.
    """
    bound = found.error_bound if isinstance(found, RootSet) else np.zeros(found.shape)
    return fastest(np.asarray(found.real), bound)
