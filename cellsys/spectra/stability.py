"""Stability report: verdict, abscissae, transient growth, distance to instability, certificate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import ParameterError
from cellsys.spectra.certainty import PoleCertainty, data_note, side, widened
from cellsys.spectra.growth import kreiss_lower, sampled_growth
from cellsys.spectra.integrators import (
    Integrators,
    apart_from,
    longest_chain,
    said_apart,
    set_apart,
)
from cellsys.spectra.lyapunov import LyapunovCertificate, certificate
from cellsys.spectra.poles import poles
from cellsys.spectra.pseudospectra import Pseudospectra, abscissa, pseudospectra
from cellsys.spectra.realization import balancing, realization
from cellsys.spectra.roots import RootSet, poles_of
from cellsys.spectra.singular import distance_to_boundary, schur_matrix
from cellsys.spectra.spectrum import Spectrum, backward_error, spectrum


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class StabilityReport(Drawable):
    """What can be said about the stability of x' = A x (x+ = A x) at working precision.

    Integrators are set apart: everything but `poles` is about the rest of the state.

    Attributes
    ----------
    verdict : str
        ``"stable"``, ``"marginal: stable apart from its integrators"``, ``"unstable"`` or
        ``"not decided"``.
    reason : str
        Why, in words.
    spectral_abscissa : float
        Largest Re of the poles, 1/s; in discrete time the largest modulus. -inf (0) without poles.
    abscissa_error : float
        Largest distance by which it may be wrong.
    numerical_abscissa : float
        Largest eigenvalue of (A + A^T)/2, 1/s: the growth rate of |x| at once. In discrete time
        |A|_2, the growth of one step.
    growth_lower, growth_upper : float
        Bounds of max |exp(A t)|_2 over t >= 0 (of max |A^k|_2); inf when unstable.
    growth_time : float
        Time of the largest sample behind `growth_lower`, s (steps in discrete time).
    kreiss_lower : float
        Lower bound of the Kreiss constant.
    distance : float
        Distance to instability: smallest |E|_2 that puts a pole of A + E on the boundary; 0 when
        unstable.
    distance_lower : float
        Certified lower bound of it.
    distance_point : complex
        Where on the boundary that pole appears.
    pseudospectral_abscissa : dict of float to float
        epsilon -> largest Re (modulus) of the epsilon-pseudospectrum.
    certificate : LyapunovCertificate
    integrators : Integrators
        Null directions of A, with the names of their states.
    poles : RootSet
        All of them.
    coordinates : str
        ``"given"``, or ``"balanced"`` when the states' scales differ so much (over 1e6) that
        norms in the given coordinates mean nothing.
    dt : float
    A : array
        The matrix the norms are about.
    """

    _figure: ClassVar[str] = "stability"
    verdict: str
    reason: str
    spectral_abscissa: float
    abscissa_error: float
    numerical_abscissa: float
    growth_lower: float
    growth_upper: float
    growth_time: float
    kreiss_lower: float
    distance: float
    distance_lower: float
    distance_point: complex
    pseudospectral_abscissa: dict[float, float]
    certificate: LyapunovCertificate
    integrators: Integrators
    poles: RootSet
    coordinates: str
    dt: float
    A: np.ndarray

    @cached_property
    def pseudospectra(self) -> Pseudospectra:
        """Pseudospectra of `A` on a grid of 50 x 50 points, worked out on first use."""
        n = len(self.A)
        return pseudospectra(
            (self.A, np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0)), self.dt), points=50
        )

    def __str__(self) -> str:
        which = "modulus" if self.dt > 0 else "real part"
        lines = [
            f"{self.verdict}: {self.reason}",
            f"  largest {which} of a pole  {self.spectral_abscissa:.6g} "
            f"+- {self.abscissa_error:.1e}",
            f"  numerical abscissa        {self.numerical_abscissa:.6g}",
            f"  transient growth          {self.growth_lower:.4g} .. {self.growth_upper:.4g}",
            f"  distance to instability   {self.distance:.4g} at {self.distance_point:.4g}",
            f"  Lyapunov certificate      {self.certificate}",
            f"  integrators set apart     {self.integrators}",
        ]
        lines += [
            f"  abscissa at epsilon {e:.1e}  {a:.6g}"
            for e, a in self.pseudospectral_abscissa.items()
        ]
        return "\n".join(lines)


def _excess(found: Spectrum, *, discrete: bool) -> np.ndarray:
    return np.abs(found.values) - 1 if discrete else found.values.real


def _verdict(
    found: Spectrum, known: Spectrum, low: float, delta: float, *, discrete: bool, chain: int
) -> tuple[str, str]:
    """Verdict and reason from the poles with bounds and the distance in balanced coordinates.

    `found` has the bounds of rounding alone, `known` the larger ones of rounding and data;
    `chain` is the length of the longest series of integrators.
    """
    n = len(found.values)
    if n == 0:
        return "stable", "no poles besides integrators" if chain else "no poles"
    excess = _excess(found, discrete=discrete)
    i = int(np.argmax(excess))
    axis = "the unit circle" if discrete else "the imaginary axis"
    where = side(excess, known.bound)
    bad = where > 0
    if np.any(bad):
        j = int(np.argmax(np.where(bad, excess, -np.inf)))
        return "unstable", (
            f"{int(np.count_nonzero(bad))} poles beyond {axis} by more than their error bound, "
            f"the worst {complex(known.values[j]):.6g} +- {known.bound[j]:.1e}"
        )
    if chain > 1:
        at, growth = (1, "k") if discrete else (0, "t")
        power = growth if chain == 2 else f"{growth}^{chain - 1}"
        return "unstable", (
            f"a chain of {chain} integrators in series (a defective pole at {at}): grows like "
            f"{power}, without bound"
        )
    if np.all(where < 0):
        return "stable", f"every pole lies inside {axis} by more than its error bound"
    open_ = (where == 0) & (known.bound > found.bound)
    if np.any(open_):
        j = int(np.argmax(np.where(open_, excess, -np.inf)))
        return "not decided", (
            f"not decided by the data: {int(np.count_nonzero(open_))} poles may lie on either side "
            f"of {axis}, among them {complex(known.values[j]):.6g} +- {known.bound[j]:.1e}"
        )
    if excess[i] < 0 and low > 2 * delta:
        return "stable", (
            f"no perturbation up to {low:.1e} reaches {axis}, and rounding is at most {delta:.1e}"
        )
    return "not decided", (
        f"a perturbation of the size of rounding, {delta:.1e}, can put a pole on {axis}; "
        f"the computed {complex(found.values[i]):.6g} is known to +- {found.bound[i]:.1e} only"
    )


@checked
def stability(
    sys: LinearSystem,
    *,
    epsilon: tuple[float, ...] = (),
    integrator_tol: float | None = None,
    certainty: PoleCertainty | None = None,
) -> StabilityReport:
    """Stability report that also holds for non-normal A.

        stable: every pole of every A + E, |E| <= delta, lies inside the boundary,
        delta = (10 + sqrt n) eps |A|_F in balanced coordinates

    shown by the error bounds of the poles or by the distance to instability; *marginal: stable
    apart from its integrators* where that holds for what is left of the state. *Unstable*: a pole
    lies outside by more than its error bound, or integrators stand in series. Otherwise *not
    decided*: the matrix is not known well enough in double precision.

    Parameters
    ----------
    sys : control.StateSpace or what `poles` takes (a square array is A alone)
    epsilon : tuple of float
        Perturbation sizes for the epsilon-pseudospectral abscissa.
    integrator_tol : float, optional
        Singular values of the balanced A (of A - I) up to this count as integrators, 1/s; default
        10 n eps |A|_F. A learned model whose absolute position drifts slowly needs a larger one.
    certainty : PoleCertainty, optional
        What the data leave open of the poles (``model.certainty()``): bounds are then the larger
        of the two, and a pole that the data leave on either side makes the verdict not decided.

    Returns
    -------
    StabilityReport

    Raises
    ------
    DataError, DimensionError, ParameterError, MemoryBudgetError
        As for `poles`; ParameterError for an epsilon <= 0.

    References
    ----------
    Trefethen and Embree, Spectra and Pseudospectra (2005), sections 14-17 and 49; Byers (1988).
    """
    for e in epsilon:
        if not (np.isfinite(e) and e > 0):
            raise ParameterError(f"epsilon must be > 0 and finite, got {e!r}")
    if integrator_tol is not None and not integrator_tol >= 0:
        raise ParameterError(f"integrator_tol must be >= 0 1/s, got {integrator_tol!r}")
    system = realization(sys).dense()
    discrete = system.is_discrete
    balanced, scale = balancing(system.A)
    apart, rest = set_apart(balanced, scale, system.states, integrator_tol, discrete=discrete)
    B = rest.T @ balanced @ rest
    # What is left may hold integrators of the integrators.
    chain = 1 + longest_chain(B, integrator_tol, discrete=discrete) if apart.count else 0
    alone = spectrum(B)
    found = widened(alone, certainty, system.dt)
    delta = backward_error(len(balanced), float(sla.norm(balanced)) if len(balanced) else 0.0)
    T = schur_matrix(B)
    low, high, point = distance_to_boundary(B, found.values, discrete=discrete, T=T)
    verdict, reason = _verdict(alone, found, low, delta, discrete=discrete, chain=chain)
    verdict = apart_from(verdict, apart.count)
    reason += said_apart(apart.count) if chain == 1 else ""
    excess = _excess(found, discrete=discrete)
    i = int(np.argmax(excess + found.bound)) if len(excess) else -1
    top = float(excess.max(initial=-np.inf))

    coordinates, A = "balanced", B
    spread = scale.max(initial=1.0) / scale.min(initial=1.0)
    if spread <= 1e6:
        coordinates, A = "given", _quotient(system.A, scale, apart.basis)
        if spread > 1:
            T = schur_matrix(A)
            low, high, point = distance_to_boundary(A, found.values, discrete=discrete, T=T)
    # The matrix as given grows, whether or not the data behind it decide that.
    outside = verdict == "unstable" or bool(np.any(side(excess, alone.bound) > 0))
    if outside:
        low, high, growth, kreiss, when = 0.0, 0.0, np.inf, np.inf, np.nan
        proof = certificate(A, max(top, 0.0), discrete=discrete)
        upper = np.inf
    else:
        proof = certificate(A, top, discrete=discrete)
        slow = -np.log1p(top) if discrete and top > -1 else -top
        growth, when = sampled_growth(A, discrete=discrete, slowest=float(slow))
        kreiss, _ = kreiss_lower(T, found.values, discrete=discrete)
        growth = max(growth, kreiss)
        upper = np.sqrt(proof.condition)
        if top <= 0 and len(A):
            vectors = sla.svdvals(sla.eig(A)[1])
            upper = min(upper, float(vectors[0] / vectors[-1]) if vectors[-1] > 0 else np.inf)
        upper = max(upper, growth) if np.isfinite(upper) else np.inf
    return StabilityReport(
        verdict=verdict,
        reason=reason,
        spectral_abscissa=top + 1.0 if discrete else top,
        abscissa_error=float((excess + found.bound)[i] - top) if i >= 0 else 0.0,
        numerical_abscissa=_numerical(A, discrete=discrete),
        growth_lower=float(growth),
        growth_upper=float(upper),
        growth_time=float(when) * (system.dt if discrete else 1.0),
        kreiss_lower=float(kreiss),
        distance=float(high),
        distance_lower=float(low),
        distance_point=point,
        pseudospectral_abscissa={
            float(e): abscissa(A, float(e), found.values, discrete=discrete) for e in epsilon
        },
        certificate=proof,
        integrators=apart,
        poles=poles(system, certainty=certainty)
        if apart.count
        else poles_of(found, system.dt, "" if certainty is None else data_note(certainty)),
        coordinates=coordinates,
        dt=system.dt,
        A=A,
    )


def _numerical(A: np.ndarray, *, discrete: bool) -> float:
    if not len(A):
        return 0.0 if discrete else -np.inf
    return float(sla.svdvals(A)[0] if discrete else sla.eigvalsh(0.5 * (A + A.T))[-1])


def _quotient(A: np.ndarray, scale: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """A on the orthogonal complement, in given coordinates, of the integrators' directions."""
    if basis.shape[1] == 0:
        return A
    Q = sla.qr(basis * scale[:, None])[0][:, basis.shape[1] :]
    return Q.T @ A @ Q
