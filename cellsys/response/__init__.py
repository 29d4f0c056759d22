"""Poles, zeros, frequency response, margins and robustness of linear systems in state space.

Any `control.StateSpace`, SISO or MIMO, continuous or discrete, or plain arrays; nothing here goes
by way of a polynomial, and `control` is only loaded where a result is handed back as its type.
"""

from cellsys.renamed import old_names
from cellsys.response.feedback import bandwidth, dcgain, feedback
from cellsys.response.frequency import FrequencyResponse, frequency_response
from cellsys.response.margins import Margins, margins
from cellsys.response.measured import MeasuredMargins
from cellsys.response.norms import SystemNorm, h2_norm, hinf_norm, norm
from cellsys.response.root_locus import RootLocus, root_locus
from cellsys.response.sampling import Tustin, ZeroOrderHold, c2d, d2c
from cellsys.response.sampling_rules import FirstOrderHold, ImpulseInvariance, MatchedPoles
from cellsys.response.sensitivity_functions import (
    ErrorSystem,
    Sensitivity,
    error_system,
    sensitivity,
)
from cellsys.response.step_info import StepFigures, step_info
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
    MinimalForm,
    Participation,
    Pseudospectra,
    Realization,
    RootSet,
    StabilityReport,
    StabilitySplit,
    controllability_gramian,
    damping,
    hankel_singular_values,
    minreal,
    observability_gramian,
    participation,
    poles,
    pseudospectra,
    pseudospectral_abscissa,
    realization,
    stability,
    stabsep,
    zeros,
)

__getattr__ = old_names(__name__)

__all__ = [
    "BalancedTruncation",
    "DampingTable",
    "ErrorSystem",
    "FirstOrderHold",
    "FrequencyResponse",
    "Gramian",
    "ImpulseInvariance",
    "Integrators",
    "LyapunovCertificate",
    "Margins",
    "MatchedPoles",
    "MeasuredMargins",
    "MinimalForm",
    "Participation",
    "Pseudospectra",
    "Realization",
    "RootLocus",
    "RootSet",
    "Sensitivity",
    "StabilityReport",
    "StabilitySplit",
    "StepFigures",
    "SystemNorm",
    "TimeResponse",
    "Tustin",
    "ZeroOrderHold",
    "balanced_truncation",
    "bandwidth",
    "c2d",
    "controllability_gramian",
    "d2c",
    "damping",
    "dcgain",
    "error_system",
    "feedback",
    "forced_response",
    "frequency_response",
    "h2_norm",
    "hankel_singular_values",
    "hinf_norm",
    "impulse_response",
    "margins",
    "minreal",
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
    "stabsep",
    "step_info",
    "step_response",
    "zeros",
]
