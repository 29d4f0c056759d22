"""Linear state space of a bond graph about a point."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from cellsys.bondgraph.elements import Start
from cellsys.bondgraph.state_equations import StateEquations
from cellsys.errors import DimensionError, NotSymbolicError, ParameterError
from cellsys.state_space import state_space

if TYPE_CHECKING:
    import control


def linearize(
    equations: StateEquations,
    x0: np.ndarray | Mapping[str, Start] | None = None,
    *,
    t: float = 0.0,
    outputs: Sequence[str] | None = None,
) -> control.StateSpace:
    """Linear model of deviations from (t, x0),

        A = W_x + W_eta d eta/dx ,    B = W_s + W_eta d eta/ds

    Derivatives are CasADi's where the laws are symbolic, else central differences with step
    6e-6 (1 + |x|), whose error is of order 1e-10 relative.

    Parameters
    ----------
    x0 : array (n,) or mapping from state names, optional
        Default the graph's initial state; states left out of a mapping keep theirs.
    t : float
        Time at which the sources are evaluated, s.
    outputs : sequence of str, optional
        State names, or ``"element.e"`` / ``"element.f"`` for the effort or flow at a port, or
        the name of a bond with ``.e`` / ``.f``. Default: all states.

    Returns
    -------
    control.StateSpace
        With dt = 0 and the graph's names for states, inputs and outputs; python-control allows
        no dot in a name, so ``rotor.f`` becomes ``rotor_f``. A graph of one state without sources
        gets an input ``none`` of zeros, because python-control cannot hold a B of shape (1, 0).

    Raises
    ------
    ParameterError
        Unknown state or output name.
    DimensionError
        x0 of another length.
    """
    S = equations.structure
    x = _point(equations, x0)
    s = np.asarray(equations.laws.sources(t), dtype=float)
    J_x, J_s = _jacobians(equations, t, x, s)
    A = equations.W_x.toarray() + equations.W_eta @ J_x
    B = equations.W_s.toarray() + equations.W_eta @ J_s
    names = equations.states.names
    chosen = list(outputs) if outputs is not None else list(names)
    Y_x, Y_s = S.Y_x + S.Y_eta @ J_x, S.Y_s + S.Y_eta @ J_s
    C_rows, D_rows, labels = [], [], []
    for label in chosen:
        if label in names or label in equations.states:
            block = label in equations.states
            rows = (
                np.arange(x.size)[equations.states.slice(label)] if block else [names.index(label)]
            )
            C_rows.append(np.eye(x.size)[rows])
            D_rows.append(np.zeros((len(rows), s.size)))
        else:
            row = _bond_rows(equations, label)
            C_rows.append(np.asarray(row @ Y_x))
            D_rows.append(np.asarray(row @ Y_s))
        n = len(C_rows[-1])
        labels += [label] if n == 1 else [f"{label}[{i}]" for i in range(n)]
    inputs = equations.inputs.names
    return state_space(
        A,
        B,
        np.vstack(C_rows) if C_rows else np.zeros((0, x.size)),
        np.vstack(D_rows) if D_rows else np.zeros((0, B.shape[1])),
        0,
        states=_signals(names),
        inputs=_signals(inputs) or None,
        outputs=_signals(labels) or None,
        name=_signals([equations.graph.name])[0] or None,
    )


def _signals(names: Sequence[str]) -> list[str]:
    return [name.replace(".", "_") for name in names]


def _point(equations: StateEquations, x0: np.ndarray | Mapping[str, Start] | None) -> np.ndarray:
    x = np.array(equations.x0, dtype=float)
    if isinstance(x0, Mapping):
        for name, value in x0.items():
            if name not in equations.states:
                raise ParameterError(
                    f"no state {name!r}; states: {', '.join(b.name for b in equations.states)}"
                )
            x[equations.states.slice(name)] = np.ravel(value)
    elif x0 is not None:
        x = np.asarray(x0, dtype=float)
    if x.shape != equations.x0.shape:
        raise DimensionError(f"x0 must have shape {equations.x0.shape}, got {x.shape}")
    return x


def _bond_rows(equations: StateEquations, label: str) -> np.ndarray:
    S, graph = equations.structure, equations.graph
    head, _, quantity = label.rpartition(".")
    bonds = {b.name: i for i, b in enumerate(graph.joined)} | {p.name: p.bond for p in graph.ports}
    for name, at in graph.junction_bonds.items():
        bonds.setdefault(name, at[0][0])
    if quantity not in ("e", "f") or head not in bonds:
        raise ParameterError(
            f"no output {label!r}; give a state ({', '.join(b.name for b in equations.states)}), "
            "or an element, junction or bond followed by .e or .f"
        )
    source = S.effort if quantity == "e" else S.flow
    return source[S.bond_place[bonds[head]]].toarray()


def _jacobians(
    equations: StateEquations, t: float, x: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    laws = equations.laws
    if not laws.size:
        return np.zeros((0, x.size)), np.zeros((0, s.size))
    try:
        import casadi as ca

        X, U = ca.SX.sym("x", x.size), ca.SX.sym("s", s.size)
        with warnings.catch_warnings():
            # CasADi warns where a law calls a numpy function on its symbols; the result is checked
            # below, and where there is none the differences take over.
            warnings.simplefilter("ignore", FutureWarning)
            eta = laws.eta(t, X, U)
        f = ca.Function("jacobians", [X, U], [ca.jacobian(eta, X), ca.jacobian(eta, U)])
        J_x, J_s = (np.array(J.full()) for J in f(x, s))
    except (NotSymbolicError, TypeError, ValueError, NotImplementedError, RuntimeError):
        pass  # a law is numeric only: differences below
    else:
        if np.all(np.isfinite(J_x)) and np.all(np.isfinite(J_s)):
            return J_x, J_s
    return (
        _differences(lambda v: np.asarray(laws.eta(t, v, s)), x),
        _differences(lambda v: np.asarray(laws.eta(t, x, v)), s),
    )


def _differences(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray) -> np.ndarray:
    columns = []
    for j in range(at.size):
        step = np.zeros(at.size)
        step[j] = 6e-6 * (1.0 + abs(at[j]))
        columns.append((function(at + step) - function(at - step)) / (2.0 * step[j]))
    return np.array(columns).T if columns else np.zeros((np.size(function(at)), 0))
