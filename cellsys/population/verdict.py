"""Stability of coupled cells, block by block, for any number of cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.drawable import Drawable
from cellsys.errors import DataError
from cellsys.population.poleset import PoleSet
from cellsys.population.printed.printed_cells import PrintedCells
from cellsys.spectra.certainty import PoleCertainty, side, widened
from cellsys.spectra.integrators import apart_from, longest_chain, said_apart, set_apart
from cellsys.spectra.realization import LARGEST, balancing
from cellsys.spectra.spectrum import backward_error, spectrum


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class CoupledStability(Drawable):
    """What can be said about K coupled cells.

    Attributes
    ----------
    verdict : str
        ``"stable"``, ``"marginal: stable apart from its integrators"``, ``"unstable"`` or
        ``"not decided"``; the first two ``"... for every K"`` with a certificate that does not
        depend on K.
    reason : str
    spectral_abscissa : float
        Largest real part of the poles besides integrators, 1/s: the growth rate when unstable.
    abscissa_error : float
        Largest distance by which it may be wrong.
    numerical_abscissa : float
        Largest eigenvalue of (M + M^T)/2 over the blocks, in the coordinates of `plant()`
        that need no inverse, 1/s.
    integrators : int
        Zero poles set apart: purely matrix directions, and absolute position.
    poles : PoleSet
    route : str
    """

    verdict: str
    reason: str
    spectral_abscissa: float
    abscissa_error: float
    numerical_abscissa: float
    integrators: int
    poles: PoleSet
    route: str

    _figure: ClassVar[str] = "coupled_stability"

    def __str__(self) -> str:
        return (
            f"{self.verdict}: {self.reason}\n"
            f"  largest real part of a pole  {self.spectral_abscissa:.6g} "
            f"+- {self.abscissa_error:.1e} 1/s\n"
            f"  numerical abscissa           {self.numerical_abscissa:.6g} 1/s\n"
            f"  integrators set apart        {self.integrators}\n"
            f"  route                        {self.route}"
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockVerdict:
    """One matrix without its integrators: verdict, abscissa and its error; numerical abscissa of
    the whole; how many integrators, and how long their longest series."""

    verdict: str
    abscissa: float
    error: float
    numerical: float
    integrators: int
    chain: int


def judge(
    M: np.ndarray,
    eigenvalues: np.ndarray | None = None,
    certainty: PoleCertainty | None = None,
    dt: float = 0.0,
) -> BlockVerdict:
    """Verdict on x' = M x, or x+ = M x of a step of `dt` s; integrators set apart.

    From the poles and their error bounds, the larger of rounding and data. `eigenvalues` of M,
    when they are known already. Rates in 1/s in both cases.
    """
    discrete = dt > 0
    if not len(M):
        return BlockVerdict(
            verdict="stable", abscissa=-np.inf, error=0.0, numerical=-np.inf, integrators=0, chain=0
        )
    largest = float(np.abs(M).max())
    if largest > LARGEST:
        raise DataError(
            f"the coupled cells have rates of {largest:.3g}, beyond {LARGEST:g}: their squares are "
            "no doubles; take another unit of time"
        )
    balanced, scale = balancing(M)
    names = ("",) * len(M)
    apart, rest = set_apart(balanced, scale, names, None, discrete=discrete)
    B = rest.T @ balanced @ rest if apart.count else balanced
    chain = 1 + longest_chain(B, None, discrete=discrete) if apart.count else 0
    if discrete:
        numerical = float(np.log(sla.norm(M, 2)) / dt)
    else:
        last = len(M) - 1
        numerical = float(
            sla.eigh(0.5 * (M + M.T), eigvals_only=True, subset_by_index=(last, last))[0]
        )
    if not len(B):
        verdict = "stable" if chain < 2 else "unstable"
        return BlockVerdict(
            verdict=verdict,
            abscissa=-np.inf,
            error=0.0,
            numerical=numerical,
            integrators=apart.count,
            chain=chain,
        )
    found = sla.eigvals(B) if eigenvalues is None or apart.count else eigenvalues
    excess = np.abs(found) - 1.0 if discrete else found.real
    unit = dt if discrete else 1.0  # of a rate: log(1 + excess) = excess near the circle
    with np.errstate(divide="ignore"):  # every pole 0: gone after one step
        top = float(np.log1p(excess.max()) / dt if discrete else excess.max())
    # Cheap sufficient test first: error bounds need the eigenvectors.
    rounding = backward_error(len(M), float(sla.norm(M)))
    contracts = not discrete and numerical < -rounding
    if certainty is None and excess.max() < 0 and chain < 2 and contracts:
        return BlockVerdict(
            verdict="stable",
            abscissa=top,
            error=0.0,
            numerical=numerical,
            integrators=apart.count,
            chain=chain,
        )
    known = widened(spectrum(B, found), certainty, dt)
    where = side(excess, known.bound)
    if chain > 1 or np.any(where > 0):
        verdict = "unstable"
    elif np.all(where < 0):
        verdict = "stable"
    else:
        verdict = "not decided"
    error = float((excess + known.bound).max() - excess.max()) / unit
    return BlockVerdict(
        verdict=verdict,
        abscissa=top,
        error=error,
        numerical=numerical,
        integrators=apart.count,
        chain=chain,
    )


def worst(verdicts: list[str]) -> str:
    """Unstable if any is, else not decided if any is."""
    for name in ("unstable", "not decided"):
        if name in verdicts:
            return name
    return "stable"


def stability_of(cells: PrintedCells) -> CoupledStability:
    """Verdict on `CoupledCells` from its distinct blocks."""
    parts = cells.distinct(drop=False)
    known = cells.eigenvalues
    certainty, said = cells.block_certainty
    open_: Sequence[PoleCertainty | None] = [None] * len(parts) if certainty is None else certainty
    found = [
        judge(M, values, data)
        for (M, _, _, _), values, data in zip(parts, known, open_, strict=True)
    ]
    verdict, scope = worst([f.verdict for f in found]), ""
    top = max(found, key=lambda f: f.abscissa)
    integrators = sum(
        (f.integrators + zeros) * n for f, (_, n, zeros, _) in zip(found, parts, strict=True)
    )
    growing = sum(
        n for f, (_, n, _, _) in zip(found, parts, strict=True) if f.verdict == "unstable"
    )
    if verdict == "unstable" and top.abscissa > 0:
        reason = f"{growing} of {cells.n_cells} blocks grow, the fastest at {top.abscissa:.6g} 1/s"
    elif verdict == "unstable":
        reason = f"{growing} of {cells.n_cells} blocks have integrators in series"
    elif verdict == "stable":
        reason = "every pole has a negative real part by more than its error bound"
        always = _always_stable(cells)
        if always is not None:
            scope, reason = " for every K", always
    else:
        top = max(found, key=lambda f: f.abscissa + f.error)
        reason = f"the largest real part {top.abscissa:.3g} 1/s is known to +- {top.error:.1e} only"
        if certainty is not None:
            reason = f"not decided by the data: {reason} ({said})"
    if cells.doubtful.size:
        doubt = cells.describe_doubt()
        other = worst([judge(M).verdict for M, _, _, _ in cells.distinct(drop=True)])
        if verdict == other:
            reason += f"; the same with directions counted as purely matrix ({doubt})"
        else:
            reason = (
                f"not determined by the data ({doubt}): {verdict}{scope} with these directions, "
                f"{other} with them counted as purely matrix"
            )
            verdict, scope = "not decided", ""
    reason += said_apart(integrators)
    return CoupledStability(
        verdict=apart_from(verdict, integrators) + scope,
        reason=reason,
        spectral_abscissa=top.abscissa,
        abscissa_error=top.error,
        numerical_abscissa=max(f.numerical for f in found),
        integrators=integrators,
        poles=cells.pole_set(),
        route=cells.route,
    )


def _always_stable(cells: PrintedCells) -> str | None:
    """A reason that does not depend on K, or None."""
    A = cells.matrices[0]
    form = cells.coupling
    if cells.graph is not None or form.extra(cells.order) is not None:
        return None
    if form.inverted():
        if cells.rank.purely_field or cells.rank.doubtful.size:
            return None
        return "a similarity transform of isolated cells, each stable: the poles are those of A"
    top = float(sla.eigvalsh(A + A.T)[-1])
    return f"A + A^T < 0 (largest eigenvalue {top:.3g}) and R = I" if top < 0 else None
