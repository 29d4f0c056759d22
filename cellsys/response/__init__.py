"""Poles, zeros, frequency response, margins and robustness of linear systems in state space.

Any `control.StateSpace`, SISO or MIMO, continuous or discrete, or plain arrays; nothing here goes
by way of a polynomial, and `control` is only loaded where a result is handed back as its type.
"""

from cellsys.renamed import old_names
from cellsys.response.damping import DampingTable, damping
from cellsys.response.frequency import FrequencyResponse, frequency_response
from cellsys.response.gramians import (
    Gramian,
    controllability_gramian,
    hankel_singular_values,
    observability_gramian,
)
from cellsys.response.integrators import Integrators
from cellsys.response.lyapunov import LyapunovCertificate
from cellsys.response.margins import Margins, margins
from cellsys.response.norms import SystemNorm, h2_norm, hinf_norm, norm
from cellsys.response.participation import Participation, participation
from cellsys.response.poles import poles
from cellsys.response.pseudospectra import Pseudospectra, pseudospectra, pseudospectral_abscissa
from cellsys.response.realization import Realization, realization
from cellsys.response.root_locus import RootLocus, root_locus
from cellsys.response.roots import RootSet
from cellsys.response.sampling import Tustin, ZeroOrderHold, c2d, d2c
from cellsys.response.sensitivity_functions import (
    ErrorSystem,
    Sensitivity,
    error_system,
    sensitivity,
)
from cellsys.response.stability import StabilityReport, stability
from cellsys.response.timeresponse import (
    TimeResponse,
    forced_response,
    impulse_response,
    step_response,
)
from cellsys.response.truncation import BalancedTruncation, balanced_truncation
from cellsys.response.zeros import zeros

__getattr__ = old_names(__name__)

__all__ = [
    "BalancedTruncation",
    "DampingTable",
    "ErrorSystem",
    "FrequencyResponse",
    "Gramian",
    "Integrators",
    "LyapunovCertificate",
    "Margins",
    "Participation",
    "Pseudospectra",
    "Realization",
    "RootLocus",
    "RootSet",
    "Sensitivity",
    "StabilityReport",
    "SystemNorm",
    "TimeResponse",
    "Tustin",
    "ZeroOrderHold",
    "balanced_truncation",
    "c2d",
    "controllability_gramian",
    "d2c",
    "damping",
    "error_system",
    "forced_response",
    "frequency_response",
    "h2_norm",
    "hankel_singular_values",
    "hinf_norm",
    "impulse_response",
    "margins",
    "norm",
    "observability_gramian",
    "participation",
    "poles",
    "pseudospectra",
    "pseudospectral_abscissa",
    "realization",
    "root_locus",
    "sensitivity",
    "stability",
    "step_response",
    "zeros",
]
