"""Loops as CasADi expressions with names: what shooting, fitting and steering start from.

    x' = M x + D c + b      p_k' = kappa p_k x (d_k x p_k)      d_k = K_d [1; z_k],  z = T x + rest

for one cell (T = I, rest = 0) and for cells coupled in a printed form. Commands c and directions d
are those of the loop; amplitude and heading of each cell can be inputs instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.errors import ParameterError
from cellsys.integrate.symbolic import SymbolicMethod
from cellsys.laws.polarity import heading_features, rate
from cellsys.loop import ClosedLoop
from cellsys.model.sensor_block import latent_names, vector_names
from cellsys.population.headings import steering
from cellsys.population.printed.cells import CoupledCells
from cellsys.population.printed.system import SYMBOLIC_LIMIT, Whole
from cellsys.population.signals import cell_prefixes
from cellsys.samples.commands import feature_of
from cellsys.shown import Shown
from cellsys.units import real_number

if TYPE_CHECKING:
    import casadi as ca

PARAMETERS = ("kappa", "K_d", "A", "B", "offset")
INPUTS = ("amplitude", "heading")


@dataclass(frozen=True, eq=False, kw_only=True)
class SymbolicLoop(Shown):
    """A loop as CasADi expressions. Made by `cs.symbolic`.

    Attributes
    ----------
    states, inputs, parameters, outputs : tuple of str
        Names of the entries of x, u, p and y.
    x, u, p : casadi.MX
        Symbols.
    rhs, y : casadi.MX
        dx/dt and the outputs z, p, d of every cell.
    x0, u0, p0 : arrays
        The loop's own start, inputs (amplitude 1, heading at the start) and parameters.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    x: ca.MX
    u: ca.MX
    p: ca.MX
    rhs: ca.MX
    y: ca.MX
    x0: np.ndarray
    u0: np.ndarray
    p0: np.ndarray

    def function(self) -> ca.Function:
        """(x, u, p) -> (rhs, y)."""
        import casadi as ca

        names = (["x", "u", "p"], ["rhs", "y"])
        return ca.Function("loop", [self.x, self.u, self.p], [self.rhs, self.y], *names)

    def integrator(self, method: Integrator, step: float) -> ca.Function:
        """CasADi's integrator over `step` seconds with u and p held: ``F(x0=, u=, p=)["xf"]``.

        Raises
        ------
        ParameterError
            For a method without derivatives: CVODES, IDAS, Collocation and RungeKutta4 have them.
        """
        import casadi as ca

        if not isinstance(method, SymbolicMethod):
            raise ParameterError(
                f"{type(method).__name__} has no derivatives; use CVODES, IDAS, Collocation or "
                "RungeKutta4"
            )
        h = _seconds(step)
        problem = {"x": self.x, "u": self.u, "p": self.p, "ode": self.rhs}
        return ca.integrator("loop", method.plugin, problem, 0.0, h, method.options(h))

    def rk4(self, step: float) -> ca.Function:
        """One step of the classical Runge-Kutta method, (x, u, p) -> x a step later."""
        import casadi as ca

        f, h = ca.Function("f", [self.x, self.u, self.p], [self.rhs]), _seconds(step)
        k1 = f(self.x, self.u, self.p)
        k2 = f(self.x + h / 2 * k1, self.u, self.p)
        k3 = f(self.x + h / 2 * k2, self.u, self.p)
        k4 = f(self.x + h * k3, self.u, self.p)
        after = self.x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return ca.Function("rk4", [self.x, self.u, self.p], [after], ["x", "u", "p"], ["xf"])

    def __str__(self) -> str:
        return (
            f"symbolic loop: {len(self.states)} states, inputs {list(self.inputs)}, parameters "
            f"{list(self.parameters)}"
        )


def _seconds(step: float) -> float:
    h = real_number(step, "step")
    if not (np.isfinite(h) and h > 0):
        raise ParameterError(f"step must be > 0 s, got {step!r}")
    return h


def _known(wanted: Sequence[str], known: Sequence[str], what: str) -> tuple[str, ...]:
    wrong = [name for name in wanted if name not in known]
    if wrong or len(set(wanted)) < len(wanted):
        raise ParameterError(
            f"{what} must be different ones of {', '.join(known)}, got {list(wanted)}"
        )
    return tuple(wanted)


@checked
def symbolic(
    loop: ClosedLoop | CoupledCells,
    *,
    parameters: Sequence[str] = ("kappa",),
    inputs: Sequence[str] = (),
) -> SymbolicLoop:
    """The loop as CasADi expressions with named states, inputs, parameters and outputs.

    Parameters
    ----------
    loop : ClosedLoop or CoupledCells
        One cell, or cells coupled in a printed form (with K m <= 1000).
    parameters : sequence of {"kappa", "K_d", "A", "B", "offset"}
        What is kept as a symbol; entries of arrays are named as ``K_d[0,3]``. The last three are
        those of the continuous plant of one cell: coupled cells have not got them.
    inputs : sequence of {"amplitude", "heading"}
        What becomes an input of each cell: amplitude (1), which scales the commands by its power,
        and the heading (rad) that commands are given for, instead of the polarity.

    Raises
    ------
    ParameterError
        An unknown name, or cells without a polarity loop or above the limit.
    """
    import casadi as ca

    single = isinstance(loop, ClosedLoop)
    known = PARAMETERS if single else PARAMETERS[:2]
    parameters = _known(parameters, known, "parameters")
    inputs = _known(inputs, INPUTS, "inputs")
    one = loop if isinstance(loop, ClosedLoop) else steering(loop.loop)
    K, m = (1 if isinstance(loop, ClosedLoop) else loop.n_cells), one.order
    n, each = K * m, [""] if isinstance(loop, ClosedLoop) else cell_prefixes(K)
    if n > SYMBOLIC_LIMIT:
        raise ParameterError(f"a symbolic loop has K m <= {SYMBOLIC_LIMIT}, and this has {n}")
    values = {"kappa": np.array([[one.controller.kappa]]), "K_d": one.sensor.K_d}
    if isinstance(loop, ClosedLoop):
        A, B, b = one.model.continuous_matrices()
        values |= {"A": A, "B": B, "offset": b[:, None]}
        x_rate, mixing, rest = (A, B, b), np.eye(m), np.zeros(m)
    else:
        whole = Whole(loop)
        M, D, push, mixing = whole.matrices()
        x_rate, rest = (M, D, push), whole.offset.ravel()
    ends = np.cumsum([0, *(values[name].size for name in parameters)]).tolist()
    p_all, symbols = ca.MX.sym("p", ends[-1]), {}
    for i, name in enumerate(parameters):  # row by row, as the labels
        part = ca.reshape(p_all[ends[i] : ends[i + 1]], *values[name].shape[::-1])
        symbols[name] = part.T

    def value(name: str) -> ca.MX:
        return symbols[name] if name in symbols else ca.MX(ca.DM(values[name]))

    x, u = ca.MX.sym("x", n + 3 * K), ca.MX.sym("u", K * len(inputs))
    names = one.model.input_names
    z = ca.mtimes(ca.DM(mixing), x[:n]) + ca.DM(rest)
    driven, turned, sensed = [], [], []
    for k in range(K):
        own = {name: u[k * len(inputs) + i] for i, name in enumerate(inputs)}
        p = x[n + 3 * k : n + 3 * k + 3]
        told = own.get("heading")
        command = p if told is None else ca.vertcat(ca.cos(told), ca.sin(told), 0)
        driven.append(_commands(names, command, own.get("amplitude", ca.MX(1.0))))
        K_d = value("K_d")
        d = ca.mtimes(K_d[:, 1:], z[k * m : (k + 1) * m]) + K_d[:, 0]
        if one.normalise:
            d = d / ca.sqrt(ca.dot(d, d) + 1e-300)
        sensed.append(d)
        turned.append(rate(p, d, value("kappa")))
    c = ca.vertcat(*driven)
    if single:
        moved = ca.mtimes(value("A"), x[:n]) + ca.mtimes(value("B"), c) + value("offset")
    else:
        moved = ca.mtimes(ca.DM(x_rate[0]), x[:n]) + ca.mtimes(ca.DM(x_rate[1]), c)
        moved = moved + ca.DM(x_rate[2])
    x0 = loop.system.x0
    start = x0[n:].reshape(K, 3)
    usual = {"amplitude": np.ones(K), "heading": np.arctan2(start[:, 1], start[:, 0])}
    z_names, p_names = latent_names(m, each), vector_names("p", each)
    return SymbolicLoop(
        states=(*latent_names(m, each, "z" if single else "x"), *p_names),
        inputs=tuple(f"{cell}{name}" for cell in each for name in inputs),
        parameters=tuple(label for name in parameters for label in _labels(name, values[name])),
        outputs=(*z_names, *p_names, *vector_names("d", each)),
        x=x,
        u=u,
        p=p_all,
        rhs=ca.vertcat(moved, *turned),
        y=ca.vertcat(z, x[n:], *sensed),
        x0=x0,
        u0=np.column_stack([usual[name] for name in inputs]).ravel() if inputs else np.zeros(0),
        p0=np.concatenate([np.zeros(0), *(values[name].ravel() for name in parameters)]),
    )


def _commands(names: Sequence[str], p: ca.MX, amplitude: ca.MX) -> ca.MX:
    import casadi as ca

    parts = [feature_of(name) for name in names]
    waves = heading_features(p, max((q for _, q, _ in parts), default=1) or 1)
    return ca.vertcat(
        *(
            amplitude**power
            * (1.0 if kind == "amplitude" else waves[2 * (q - 1) + (kind == "sin")])
            for kind, q, power in parts
        )
    )


def _labels(name: str, value: np.ndarray) -> list[str]:
    rows, columns = value.shape
    if rows * columns == 1 and name == "kappa":
        return [name]
    if name == "offset":
        return [f"offset[{i}]" for i in range(rows)]
    return [f"{name}[{i},{j}]" for i in range(rows) for j in range(columns)]
