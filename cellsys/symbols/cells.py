"""Symbolic form of loops in continuous time: one cell, printed couplings, cells on one field.

x' = M x + D c + b      p_k' = kappa p_k x (d_k x p_k)      d_k = K_d [1; z_k],  z = T x + rest
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cellsys.errors import ParameterError
from cellsys.laws.polarity import rate
from cellsys.loop import ClosedLoop
from cellsys.model.sensor_block import latent_names, vector_names
from cellsys.population.headings import steering
from cellsys.population.ported.linear_cells import PortedCells
from cellsys.population.ported.plant import point_names, read_points
from cellsys.population.ported.ported_run import initial, ported_loop
from cellsys.population.printed.cells import CoupledCells
from cellsys.population.printed.forms import Feedback, Superposition
from cellsys.population.printed.system import SYMBOLIC_LIMIT, Whole
from cellsys.population.signals import cell_prefixes
from cellsys.symbols.form import SymbolicLoop
from cellsys.symbols.parts import (
    OF_A_CELL,
    PLANT,
    SymbolicParameters,
    ToldInputs,
    cell_values,
    commands_of,
    direction_of,
    heading_of,
    known_names,
)

if TYPE_CHECKING:
    import casadi as ca


@dataclass(frozen=True, eq=False, kw_only=True)
class SymbolicRequest:
    """What a form is asked for; see `cs.symbolic`."""

    parameters: tuple[str, ...]
    inputs: tuple[str, ...]
    per_cell: bool
    points: np.ndarray | None
    place: np.ndarray | None


@dataclass(frozen=True, eq=False, kw_only=True)
class AffineCells:
    """x' = M x + D c + b + L l and z = T x + rest, numbers or expressions, of K cells."""

    M: np.ndarray | ca.MX
    D: np.ndarray | ca.MX
    b: np.ndarray | ca.MX
    T: np.ndarray | ca.MX
    rest: np.ndarray | ca.MX
    L: np.ndarray
    loads: tuple[str, ...] = ()


def single_form(loop: ClosedLoop, wanted: SymbolicRequest) -> SymbolicLoop:
    """Of one cell."""

    known_names(wanted.parameters, (*OF_A_CELL, *PLANT), "parameters")
    refuse_points(wanted)
    A, B, b = loop.model.continuous_matrices()
    m = loop.order
    values = cell_values(loop.controller.kappa, loop.sensor) | {
        "A": A,
        "B": B,
        "offset": b[:, None],
    }
    known = SymbolicParameters(wanted.parameters, values, [""], per_cell=False)
    parts: dict[str, np.ndarray | ca.MX] = {
        name: known.value(name) if (name, "") in known.symbols else value
        for name, value in (("A", A), ("B", B), ("offset", b))
    }
    whole = AffineCells(
        M=parts["A"],
        D=parts["B"],
        b=parts["offset"],
        T=np.eye(m),
        rest=np.zeros(m),
        L=np.zeros((m, 0)),
    )
    return _form(loop, whole, known, wanted, [""], loop.system.x0, latent_names(m))


def printed_form(cells: CoupledCells, wanted: SymbolicRequest) -> SymbolicLoop:
    """Of cells in a printed form of coupling."""
    loop, K, m = steering(cells.loop), cells.n_cells, cells.order
    affine = isinstance(cells.coupling, (Superposition, Feedback))
    known_names(wanted.parameters, (*OF_A_CELL, *["coupling"] * affine), "parameters")
    refuse_points(wanted)
    if K * m > SYMBOLIC_LIMIT:
        raise ParameterError(f"a symbolic loop has K m <= {SYMBOLIC_LIMIT}, and this has {K * m}")
    whole, each = Whole(cells), cell_prefixes(K)
    M, D, push, T = whole.matrices()
    rest = whole.offset.ravel()
    values = cell_values(loop.controller.kappa, loop.sensor) | {"coupling": np.ones((1, 1))}
    known = SymbolicParameters(wanted.parameters, values, each, per_cell=wanted.per_cell)
    found = AffineCells(M=M, D=D, b=push, T=T, rest=rest, L=np.zeros((K * m, 0)))
    if "coupling" in wanted.parameters:
        found = _scaled(cells, found, known.value("coupling"))
    x0 = cells.system.x0
    return _form(loop, found, known, wanted, each, x0, latent_names(m, each, "x"))


def _scaled(cells: CoupledCells, full: AffineCells, factor: ca.MX) -> AffineCells:
    """The same with every weight of the interaction times `factor`: affine in it."""
    import casadi as ca

    K, (A, B, b) = cells.n_cells, cells.matrices
    n = K * cells.order
    alone = {
        "M": np.kron(np.eye(K), A),
        "D": np.kron(np.eye(K), B),
        "b": np.tile(b, K),
        "T": np.eye(n),
        "rest": np.zeros(n),
    }
    if isinstance(cells.coupling, Superposition) and not np.allclose(
        np.asarray(full.M), alone["M"], rtol=0, atol=1e-12 * max(1.0, float(np.abs(A).max()))
    ):
        raise ParameterError(
            "parameters: 'coupling' changes which directions are dropped here (some are purely "
            "matrix, 1 - lambda = 0), so that nothing is smooth in it; use Feedback()"
        )
    made = {
        name: ca.DM(value) + factor * (ca.DM(np.asarray(getattr(full, name))) - ca.DM(value))
        for name, value in alone.items()
    }
    return AffineCells(
        M=made["M"], D=made["D"], b=made["b"], T=made["T"], rest=made["rest"], L=full.L
    )


def ported_form(cells: PortedCells, wanted: SymbolicRequest) -> SymbolicLoop:
    """Of linear cells in continuous time on one field, which is linear about rest."""
    loop, cell, K, m = steering(ported_loop(cells)), cells.model, cells.n_cells, cells.order
    known_names(wanted.parameters, OF_A_CELL, "parameters")
    (M, G), each = cells.whole, cell_prefixes(K)
    U = read_points(cells.coupling.field, wanted.points)
    known = SymbolicParameters(
        wanted.parameters,
        cell_values(loop.controller.kappa, loop.sensor),
        each,
        per_cell=wanted.per_cell,
    )
    n, size = len(M), K * m
    whole = AffineCells(
        M=M,
        D=G @ np.kron(np.eye(K), cell.B),
        b=G @ np.tile(cell.offset, K),
        T=np.eye(size, n),
        rest=np.zeros(size),
        L=cells.given_loads @ U.T,
        loads=tuple(point_names("load", U)),
    )
    names = [*latent_names(m, each), *(f"field_q[{i}]" for i in range(n - size))]
    x0 = initial(cells, loop, None, None, None)
    return _form(loop, whole, known, wanted, each, x0, names)


def refuse_points(wanted: SymbolicRequest) -> None:
    """Loads at points need a matrix."""
    if wanted.points is not None:
        raise ParameterError(
            "points are places on a matrix that is part of the loop: couple(..., LoadPorts(...))"
        )


def place_outputs(
    z: ca.MX, place: np.ndarray | None, each: Sequence[str], m: int
) -> tuple[list[ca.MX], list[str]]:
    """Places of all cells from z of all: ``cell1_x, cell1_y``, um; none without a map."""
    import casadi as ca

    if place is None:
        return [], []
    P = ca.DM(place)
    found = [ca.mtimes(P[:, 1:], z[k * m : (k + 1) * m]) + P[:, 0] for k in range(len(each))]
    return found, [f"{cell}{axis}" for cell in each for axis in "xy"]


def _form(
    loop: ClosedLoop,
    whole: AffineCells,
    known: SymbolicParameters,
    wanted: SymbolicRequest,
    each: Sequence[str],
    x0: np.ndarray,
    names: Sequence[str],
) -> SymbolicLoop:
    import casadi as ca

    K, m, n = len(each), loop.order, len(names)
    told = ToldInputs(
        wanted.inputs, each, ca.MX.sym("u", K * len(wanted.inputs) + len(whole.loads))
    )
    x, t = ca.MX.sym("x", n + 3 * K), ca.MX.sym("t")
    M, D, b, T, rest = (_mx(v) for v in (whole.M, whole.D, whole.b, whole.T, whole.rest))
    z = ca.mtimes(T, x[:n]) + rest
    driven, turned, sensed = [], [], []
    for k, cell in enumerate(each):
        p = x[n + 3 * k : n + 3 * k + 3]
        strength = told.amplitude(k), known.value("force", cell)
        driven.append(commands_of(loop.model.input_names, told.pointed(k, p), *strength))
        own = z[k * m : (k + 1) * m]
        d = direction_of(loop.sensor, own, known, cell, normalise=loop.normalise)
        sensed.append(d)
        turned.append(rate(p, d, known.value("kappa", cell)))
    push = ca.mtimes(D, ca.vertcat(*driven)) + b
    if whole.loads:
        push = push + ca.mtimes(_mx(whole.L), told.u[-len(whole.loads) :])
    places, place_names = place_outputs(z, wanted.place, each, m)
    p_names = vector_names("p", each)
    start = heading_of(x0[n:].reshape(K, 3))
    return SymbolicLoop(
        states=(*names, *p_names),
        inputs=(*told.names, *whole.loads),
        parameters=known.labels,
        outputs=(*latent_names(m, each), *p_names, *vector_names("d", each), *place_names),
        x=x,
        u=told.u,
        p=known.p,
        t=t,
        rhs=ca.vertcat(ca.mtimes(M, x[:n]) + push, *turned),
        y=ca.vertcat(z, x[n:], *sensed, *places),
        place=ca.vertcat(*places) if places else None,
        linear=whole.M if isinstance(whole.M, np.ndarray) else None,
        rest=push,
        x0=x0,
        u0=np.concatenate([told.start(start), np.zeros(len(whole.loads))]),
        p0=known.p0,
    )


def _mx(value: np.ndarray | ca.MX) -> ca.MX:
    import casadi as ca

    return value if isinstance(value, ca.MX) else ca.MX(ca.sparsify(ca.DM(value)))
