"""What a linear system's matrices say of themselves: poles, zeros, damping, stability, Gramians.

Any `control.StateSpace`, or plain arrays, continuous or discrete; nothing here goes by way of a
polynomial. How a system answers an input stands one floor up, in `response`.
"""

from cellsys.spectra.damping import DampingTable, damping
from cellsys.spectra.gramians import (
    Gramian,
    controllability_gramian,
    hankel_singular_values,
    observability_gramian,
)
from cellsys.spectra.integrators import Integrators
from cellsys.spectra.lyapunov import LyapunovCertificate
from cellsys.spectra.minimal import MinimalForm, StabilitySplit, minreal, stabsep
from cellsys.spectra.participation import Participation, participation
from cellsys.spectra.poles import poles
from cellsys.spectra.pseudospectra import Pseudospectra, pseudospectra, pseudospectral_abscissa
from cellsys.spectra.realization import Realization, realization
from cellsys.spectra.roots import RootSet
from cellsys.spectra.stability import StabilityReport, stability
from cellsys.spectra.zeros import zeros

__all__ = [
    "DampingTable",
    "Gramian",
    "Integrators",
    "LyapunovCertificate",
    "MinimalForm",
    "Participation",
    "Pseudospectra",
    "Realization",
    "RootSet",
    "StabilityReport",
    "StabilitySplit",
    "controllability_gramian",
    "damping",
    "hankel_singular_values",
    "minreal",
    "observability_gramian",
    "participation",
    "poles",
    "pseudospectra",
    "pseudospectral_abscissa",
    "realization",
    "stability",
    "stabsep",
    "zeros",
]
