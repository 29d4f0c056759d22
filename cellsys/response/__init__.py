"""Poles, zeros, frequency response, margins and robustness of linear systems in state space.

Any `control.StateSpace`, SISO or MIMO, continuous or discrete, or plain arrays; nothing here goes
by way of a polynomial, and `control` is only loaded where a result is handed back as its type.
"""

from cellsys.response.damping import DampingTable, damping
from cellsys.response.frequency import FrequencyResponse, frequency_response
from cellsys.response.margins import Margins, margins
from cellsys.response.poles import poles
from cellsys.response.pseudospectra import (
    Pseudospectra,
    pseudospectra,
    pseudospectral_abscissa,
)
from cellsys.response.realization import Realization, realization
from cellsys.response.roots import RootSet
from cellsys.response.stability import StabilityReport, stability
from cellsys.response.zeros import zeros

__all__ = [
    "DampingTable",
    "FrequencyResponse",
    "Margins",
    "Pseudospectra",
    "Realization",
    "RootSet",
    "StabilityReport",
    "damping",
    "frequency_response",
    "margins",
    "poles",
    "pseudospectra",
    "pseudospectral_abscissa",
    "realization",
    "stability",
    "zeros",
]
