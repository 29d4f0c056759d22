"""Poles, zeros, frequency response, margins and robustness of linear systems in state space.

Any `control.StateSpace`, SISO or MIMO, continuous or discrete, or plain arrays; nothing here goes
by way of a polynomial, and `control` is only loaded where a result is handed back as its type.
"""

from cellsys.renamed import old_names
from cellsys.response.frequency import FrequencyResponse, frequency_response
from cellsys.response.margins import Margins, margins
from cellsys.response.norms import SystemNorm, h2_norm, hinf_norm, norm
from cellsys.response.root_locus import RootLocus, root_locus
from cellsys.response.sampling import Tustin, ZeroOrderHold, c2d, d2c
from cellsys.response.sensitivity_functions import (
    ErrorSystem,
    Sensitivity,
    error_system,
    sensitivity,
)
from cellsys.response.timeresponse import (
    TimeResponse,
    forced_response,
    impulse_response,
    step_response,
)
from cellsys.response.truncation import BalancedTruncation, balanced_truncation
from cellsys.spectra import (
    DampingTable,
    Gramian,
    Integrators,
    LyapunovCertificate,
    Participation,
    Pseudospectra,
    Realization,
    RootSet,
    StabilityReport,
    controllability_gramian,
    damping,
    hankel_singular_values,
    observability_gramian,
    participation,
    poles,
    pseudospectra,
    pseudospectral_abscissa,
    realization,
    stability,
    zeros,
)

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
