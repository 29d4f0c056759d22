"""Poles of a linear system."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.spectra.certainty import PoleCertainty, data_note, widened
from cellsys.spectra.realization import balancing, realization
from cellsys.spectra.roots import RootSet, order
from cellsys.spectra.spectrum import Spectrum, spectrum


@checked
def poles(sys: LinearSystem, *, certainty: PoleCertainty | None = None) -> RootSet:
    """Poles: eigenvalues of A, with condition numbers, error bounds and clusters.

        det(s I - A) = 0                    (all of them, also unobservable or uncontrollable ones)

    The matrix is balanced first. A pole of multiplicity k is only known to about eps^(1/k): the
    k computed ones form a cluster whose bound says so. See `Spectrum` for the bounds.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction (SISO), tuple of arrays or matrix A
    certainty : PoleCertainty, optional
        What the data leave open of these poles (``model.certainty()``): each bound is then the
        larger of the two.

    Returns
    -------
    RootSet
        Complex array (n,), falling real part; 1/s in continuous time.

    Raises
    ------
    DataError, DimensionError, ParameterError, MemoryBudgetError
        NaN or inf in a matrix, sizes that do not fit, not a linear system, sparse and too large.

    References
    ----------
    Wilkinson, The Algebraic Eigenvalue Problem (1965), section 2; LAPACK geev.
    """
    system = realization(sys).dense()
    A = balancing(system.A)[0]
    values = sla.eigvals(A) if A.size else np.zeros(0, complex)
    values = values[order(values)]

    def detail(values: np.ndarray) -> Spectrum:
        return widened(spectrum(A, values), certainty, system.dt)

    note = "" if certainty is None else data_note(certainty)
    return RootSet(values, kind="pole", dt=system.dt, detail=detail, note=note)
