"""Sensitivity functions of a loop, and the error system of two models."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import DimensionError, ParameterError
from cellsys.response.frequency import FrequencyResponse, frequency_response
from cellsys.response.norms import SystemNorm, h2_norm, hinf_norm
from cellsys.spectra.realization import Realization, realization, same_time


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Sensitivity(Drawable):
    """S = (I + L)^-1 and T = I - S with their peaks.

    Attributes
    ----------
    S, T : Realization
        ``.state_space()`` for python-control.
    peak_S, peak_T : SystemNorm
        H-infinity norms with their frequencies; inf when the closed loop is not stable.
    response_S, response_T : FrequencyResponse
        On a common grid, for drawing.
    """

    _figure: ClassVar[str] = "sensitivity"
    S: Realization
    T: Realization
    peak_S: SystemNorm
    peak_T: SystemNorm
    response_S: FrequencyResponse
    response_T: FrequencyResponse

    def __str__(self) -> str:
        return f"peak of S: {self.peak_S}\npeak of T: {self.peak_T}"


@checked
def sensitivity(sys: LinearSystem, omega: np.ndarray | None = None) -> Sensitivity:
    """Sensitivity and complementary sensitivity of the negative feedback loop 1 + L.

        S = (I + L)^-1,  T = L (I + L)^-1,  S + T = I

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays
        Return ratio L, square.
    omega : array, optional
        Grid of the two responses, rad/s; default automatic.

    Returns
    -------
    Sensitivity

    Raises
    ------
    DimensionError
        L is not square.
    ParameterError
        I + D is singular: an algebraic loop.
    DataError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Astrom and Murray, Feedback Systems (2021), section 12.1.
    """
    L = realization(sys).dense()
    m = L.n_inputs
    if m != L.n_outputs:
        raise DimensionError(f"a return ratio must be square, got {L.n_outputs} x {m}")
    F = np.eye(m) + L.D
    if m and sla.svdvals(F)[-1] < 1e-14 * max(1.0, float(sla.norm(L.D))):
        raise ParameterError("I + D is singular: the loop is algebraic and has no solution")
    K = sla.solve(F, np.hstack([L.C, np.eye(m)])) if m else np.zeros((0, L.n_states))
    C, E = K[:, : L.n_states], K[:, L.n_states :]
    S = replace(L, A=L.A - L.B @ C, B=L.B @ E, C=-C, D=E, inputs=L.outputs, outputs=L.outputs)
    T = replace(S, C=C, D=np.eye(m) - E)
    response = frequency_response(S, omega)
    return Sensitivity(
        S=S,
        T=T,
        peak_S=hinf_norm(S),
        peak_T=hinf_norm(T),
        response_S=response,
        response_T=frequency_response(T, response.omega),
    )


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class ErrorSystem(Drawable):
    """Full minus reduced model.

    Attributes
    ----------
    system : Realization
        States of both; ``.state_space()`` for python-control.
    h2, hinf : SystemNorm
        Norms of the error.
    relative_h2, relative_hinf : float
        Divided by the norms of the full model; nan where those are 0 or infinite.
    response : FrequencyResponse
        Of the error.
    """

    _figure: ClassVar[str] = "error_system"
    system: Realization
    h2: SystemNorm
    hinf: SystemNorm
    relative_h2: float
    relative_hinf: float
    response: FrequencyResponse

    def __str__(self) -> str:
        return (
            f"error: {self.h2}, relative {self.relative_h2:.3g}; "
            f"{self.hinf}, relative {self.relative_hinf:.3g}"
        )


@checked
def error_system(
    full: LinearSystem, reduced: LinearSystem, omega: np.ndarray | None = None
) -> ErrorSystem:
    """The system full minus reduced, with its norms.

        A = diag(A_1, A_2),  B = [B_1; B_2],  C = [C_1, -C_2],  D = D_1 - D_2

    Parameters
    ----------
    full, reduced : control.StateSpace or tuple of arrays
        Same inputs, outputs and sampling time.
    omega : array, optional
        Grid of the response, rad/s; default automatic.

    Returns
    -------
    ErrorSystem

    Raises
    ------
    DimensionError
        Different numbers of inputs or outputs.
    ParameterError
        Different sampling times.
    DataError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Antoulas, Approximation of Large-Scale Dynamical Systems (2005), section 5.
    """
    one, two = realization(full).dense(), realization(reduced).dense()
    dt = same_time(one, two)
    if one.D.shape != two.D.shape:
        raise DimensionError(
            f"full model {one.D.shape} and reduced model {two.D.shape} (outputs, inputs) differ"
        )
    names = tuple(f"full.{s}" for s in one.states) + tuple(f"reduced.{s}" for s in two.states)
    system = Realization(
        sla.block_diag(one.A, two.A) if one.n_states + two.n_states else np.zeros((0, 0)),
        np.vstack([one.B, two.B]),
        np.hstack([one.C, -two.C]),
        one.D - two.D,
        dt=dt,
        states=names,
        inputs=one.inputs,
        outputs=one.outputs,
    )
    h2, hinf = h2_norm(system), hinf_norm(system)
    return ErrorSystem(
        system=system,
        h2=h2,
        hinf=hinf,
        relative_h2=_ratio(h2, h2_norm(one)),
        relative_hinf=_ratio(hinf, hinf_norm(one)),
        response=frequency_response(system, omega),
    )


def _ratio(error: SystemNorm, full: SystemNorm) -> float:
    usable = np.isfinite(full.value) and full.value > 0
    return error.value / full.value if usable else float("nan")
