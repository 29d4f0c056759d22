"""Systems with named parameters, and the derivatives of their runs, forward and adjoint.

    dx/dt = f(t, x, p)        S = dx/dp:  S' = f_x S + f_p        [Hindmarsh et al. 2005, CVODES]

CasADi differentiates the integrator itself: forward for all samples and a few parameters, adjoint
for one number at the end of a run and any number of parameters and initial states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from typing import Annotated as Annotated  # what the inherited __init__ is annotated with

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp  # noqa: F401 (annotates the inherited __init__)

from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.errors import DimensionError, IntegrationError, ParameterError
from cellsys.integrate.record import check_times
from cellsys.integrate.symbolic import integrator_of
from cellsys.kinds import Takes as Takes
from cellsys.system import Block as Block
from cellsys.system import Layout as Layout  # what the inherited __init__ is annotated with
from cellsys.system import Matrix as Matrix
from cellsys.system import OdeSystem, SymbolicForm
from cellsys.units import shaped_array

if TYPE_CHECKING:
    from casadi import DM, Function


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class ParametricSystem(OdeSystem):
    """x' = W_x x + f(t, x, p) with named parameters p.

    Parameters
    ----------
    rate : callable
        ``rate(t, x, p)`` -> f (n,), numpy or CasADi; p maps names to values.
    parameters : mapping of str to float
        Names and values.
    """

    rate: Callable[[Any, Any, Mapping[str, Any]], Any]
    parameters: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in self.parameters.items():
            if not np.isfinite(value):
                raise ParameterError(f"parameter {name!r} must be finite, got {value!r}")

    @property
    def parameter_values(self) -> np.ndarray:
        """Values (n_p,), in the order of their names."""
        return np.array(list(self.parameters.values()), dtype=float)

    def u(self, t: float, x: np.ndarray) -> np.ndarray:
        return np.asarray(self.rate(t, x, self.parameters), dtype=float).reshape(x.shape)

    def casadi(self) -> SymbolicForm:
        """CasADi form (t, x, xdot, eta, p)."""
        import casadi as ca

        kept = self.__dict__.get("_form")
        if kept is None:
            t, x = ca.SX.sym("t"), ca.SX.sym("x", self.states.size)
            p = ca.SX.sym("p", len(self.parameters))
            named = {name: p[k] for k, name in enumerate(self.parameters)}
            value = self.rate(t, x, named)
            value = ca.vcat(list(value)) if isinstance(value, (list, tuple)) else value
            xdot = ca.DM(self.W_x.toarray()) @ x + value
            kept = self.__dict__["_form"] = SymbolicForm(t, x, xdot, ca.SX.zeros(0, 1), p)
        return kept


@checked
@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of a run by parameters.

    Parameters
    ----------
    t, x : (T,), (T, n)
    names : tuple of str
    dx : array (T, n, n_p)
        dx/dp at every sample.
    """

    t: np.ndarray
    x: np.ndarray
    names: tuple[str, ...]
    dx: np.ndarray

    def of(self, name: str) -> np.ndarray:
        """dx/dp (T, n) for one parameter."""
        if name not in self.names:
            raise ParameterError(f"no parameter {name!r}; there are {', '.join(self.names)}")
        return self.dx[:, :, self.names.index(name)]


@checked
def parameter_sensitivities(
    system: ParametricSystem,
    integrator: Integrator,
    t: np.ndarray,
    *,
    parameters: Sequence[str] | None = None,
) -> Sensitivities:
    """Forward sensitivities dx/dp at the times t.

    Parameters
    ----------
    system : ParametricSystem
        Without stop points inside the run.
    integrator : CVODES, IDAS, Collocation or RungeKutta4
    t : array (T,)
        Samples, s.
    parameters : sequence of str, optional
        Which; default all.

    Raises
    ------
    ParameterError
        When the system has no parameters, an unknown one is asked for, or it has stop points.
    IntegrationError
        When the integrator fails.
    """
    import casadi as ca

    names, t = _names(system, parameters), check_times(t)
    F = integrator_of(integrator, system, t, False)
    p = ca.MX.sym("p", len(system.parameters))
    out = F(x0=system.x0, p=p)["xf"]
    derivative = ca.Function("derivative", [p], [out, ca.jacobian(ca.vec(out), p)])
    values, slopes = (np.array(v) for v in _run(derivative, integrator, system, t))
    n = system.states.size
    x = np.vstack([system.x0, values.T])
    dx = np.zeros((len(t), n, len(system.parameters)))
    dx[1:] = slopes.reshape(len(t) - 1, n, -1)
    chosen = [list(system.parameters).index(name) for name in names]
    return Sensitivities(t, x, names, dx[:, :, chosen])


@checked
def end_gradient(
    system: ParametricSystem, integrator: Integrator, t: np.ndarray, weights: np.ndarray
) -> tuple[dict[str, float], np.ndarray]:
    """Adjoint gradient of w . x(t_end): by every parameter, and by the initial state (n,).

    Raises are those of `parameter_sensitivities`; DimensionError when the weights are not (n,).
    """
    import casadi as ca

    names = _names(system, None)
    weights = shaped_array(weights, "weights", system.x0.shape)
    t = check_times(t)[[0, -1]]
    F = integrator_of(integrator, system, t, False)
    p, x0 = ca.MX.sym("p", len(names)), ca.MX.sym("x0", system.states.size)
    goal = ca.dot(ca.DM(weights), F(x0=x0, p=p)["xf"])
    both = ca.Function("adjoint", [p, x0], [ca.gradient(goal, p), ca.gradient(goal, x0)])
    by_p, by_x = _run(both, integrator, system, t, system.x0)
    values = np.array(by_p).ravel()
    return dict(zip(names, map(float, values), strict=True)), np.array(by_x).ravel()


@checked
def pole_sensitivities(A: np.ndarray, dA: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poles of A(p) and their derivatives d pole/dp = w^H dA v/(w^H v), both (n,), 1/s.

    Raises
    ------
    DimensionError, ParameterError
        When the shapes differ, or a pole is defective: it then has no derivative.
    """
    A = shaped_array(A, "A", (None, None))
    dA = shaped_array(dA, "dA", (None, None))
    if A.shape != dA.shape or A.shape[0] != A.shape[1]:
        raise DimensionError(f"A and dA must be square and alike, got {A.shape}, {dA.shape}")
    poles, left, right = sla.eig(A, left=True, right=True)
    scale = np.einsum("ij,ij->j", left.conj(), right)
    if np.any(np.abs(scale) < 1e-10):
        raise ParameterError("a pole is defective to rounding and has no derivative by a parameter")
    return poles, np.einsum("ij,ik,kj->j", left.conj(), dA, right) / scale


def _names(system: ParametricSystem, chosen: Sequence[str] | None) -> tuple[str, ...]:
    known = tuple(getattr(system, "parameters", ()))
    if not known:
        raise ParameterError("sensitivities need a ParametricSystem with at least one parameter")
    unknown = [name for name in chosen or () if name not in known]
    if unknown:
        raise ParameterError(f"no parameter {unknown[0]!r}; there are {', '.join(known)}")
    if system.stop_points():
        raise ParameterError("sensitivities are not carried over stop points; run piece by piece")
    return tuple(chosen) if chosen is not None else known


def _run(
    function: Function,
    integrator: Integrator,
    system: ParametricSystem,
    t: np.ndarray,
    *more: np.ndarray,
) -> tuple[DM, ...]:
    try:
        return function(system.parameter_values, *more)
    except RuntimeError as error:
        raise IntegrationError(
            f"{type(integrator).__name__} failed in its sensitivities: {str(error)[-200:]}",
            time=float(t[0]),
            state_norm=float(np.linalg.norm(system.x0)),
            step=float(t[-1] - t[0]),
        ) from error
