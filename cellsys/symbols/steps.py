"""Symbolic step of loops that step themselves: on a clock, and on a field by steps of the cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellsys.cell.dynamics import CellDynamics
from cellsys.errors import ParameterError
from cellsys.laws.polarity import heading_features, symbolic_step
from cellsys.loop import AntiparallelTurn, PolarityLaw, ScheduledLoop
from cellsys.model.network_sensor import LocalSensor
from cellsys.model.sensor import StiffnessSensor
from cellsys.model.sensor_block import latent_names, vector_names
from cellsys.model.sensor_symbols import unit_symbols
from cellsys.population.headings import steering
from cellsys.population.ported.equivariant_cells import EquivariantCells
from cellsys.population.ported.linear_cells import PortedCells
from cellsys.population.ported.plant import point_names, read_points
from cellsys.population.ported.ported_run import initial, ported_loop
from cellsys.population.signals import cell_prefixes
from cellsys.symbols.cells import SymbolicRequest, place_outputs, refuse_points
from cellsys.symbols.form import SymbolicLoop
from cellsys.symbols.parts import (
    OF_A_CELL,
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

STEERED = ("kappa", "K_d", "sensor.gain")


def scheduled_form(loop: ScheduledLoop, wanted: SymbolicRequest) -> SymbolicLoop:
    """The step of a `ScheduledLoop` (see `ScheduledSystem.turned`)."""
    import casadi as ca

    known_names(wanted.parameters, STEERED, "parameters")
    refuse_points(wanted)
    m, dt, law, sensor = loop.order, loop.model.dt, loop.controller, loop.sensor
    known = SymbolicParameters(
        wanted.parameters, cell_values(law.kappa, sensor), [""], per_cell=False
    )
    told = ToldInputs(wanted.inputs, [""], ca.MX.sym("u", len(wanted.inputs)))
    x, t = ca.MX.sym("x", m + 3), ca.MX.sym("t")
    z, p, kappa = x[:m], x[m:], known.value("kappa")
    plant, a = _clocked(loop.model.dynamics), told.amplitude(0)

    def sensed(state: ca.MX) -> ca.MX:
        return direction_of(sensor, state, known, "", normalise=True)

    before = sensed(z)
    ahead = plant(z, told.pointed(0, turned(law, p, before, kappa, 0.5 * dt)), a, t)
    mean = 0.5 * (before + sensed(ahead))
    if not sensor.noise:
        mean = ca.if_else(ca.dot(mean, mean) > 0, unit_symbols(mean), before)
    drive = told.pointed(0, turned(law, p, mean, kappa, 0.5 * dt))
    moved = plant(z, drive, a, t)
    names, p_names = latent_names(m), vector_names("p")
    x0 = loop.system.x0
    return SymbolicLoop(
        states=(*names, *p_names),
        inputs=tuple(told.names),
        parameters=known.labels,
        outputs=(*names, *p_names, *vector_names("d"), "x", "y"),
        x=x,
        u=told.u,
        p=known.p,
        t=t,
        rhs=ca.vertcat(moved, turned(law, p, mean, kappa, dt)),
        y=ca.vertcat(x, before, z[-2:]),
        dt=dt,
        place=z[-2:],
        moved=moved,
        wide=isinstance(sensor, LocalSensor),
        x0=x0,
        u0=told.start(heading_of(x0[None, m:])),
        p0=known.p0,
    )


def turned(law: PolarityLaw, p: ca.MX, d: ca.MX, kappa: ca.MX, h: float) -> ca.MX:
    """`PolarityLaw.step` with kappa as a symbol, the turn off the antipode included."""
    import casadi as ca

    off = law.antiparallel
    if isinstance(off, AntiparallelTurn):
        side = 1.0 if np.random.default_rng(off.seed).random() < 0.5 else -1.0
        c, s = float(np.cos(off.angle)), side * float(np.sin(off.angle))
        scale = ca.sqrt(ca.dot(p, p) * ca.dot(d, d) + 1e-300)
        leaving = ca.logic_and(ca.dot(d, d) > 0, ca.dot(p, d) <= off.within * scale)
        aside = ca.vertcat(c * p[0] - s * p[1], s * p[0] + c * p[1], p[2])
        p = ca.if_else(leaving, aside, p)
    return symbolic_step(p, d, kappa, h)


def _clocked(dynamics: CellDynamics) -> ca.Function:
    """(z, p, amplitude, t) -> z a step later: `CellDynamics.advance` and `moved`, alone."""
    import casadi as ca

    sizes, starts = [b.size for b in dynamics.blocks], dynamics.starts()
    m = starts[-1] + sizes[-1] * (2 if len(sizes) > 1 else 1)
    z, p, a, t = (ca.SX.sym(n, k) for n, k in (("z", m + 2), ("p", 3), ("a", 1), ("t", 1)))
    clock = dynamics.clock
    s = (1.0 - ca.exp(-ca.fmax(t, 0.0) / clock.tau)) * (clock.vertices - 1)
    w = [ca.fmax(1.0 - ca.fabs(s - h), 0.0) for h in range(clock.vertices)]
    if clock.vertices == 1:
        w = [ca.SX(1.0)]

    def mean(table: np.ndarray) -> ca.SX:
        return sum((w[h] * ca.DM(table[h]) for h in range(len(w))), ca.SX(0))

    more, waves = a - 1.0, heading_features(p, max(len(sizes) - 1, 1))
    powers, out, read = ca.vertcat(1.0, more, more * more), [], dynamics.alone
    R_z, R_u = mean(read.R_z), mean(read.R_u)
    moved = []
    for q, block in enumerate(dynamics.blocks):
        A, push = mean(block.A), ca.mtimes(mean(block.B), powers)
        for part in range(1 if q == 0 else 2):
            i = starts[q] + part * sizes[q]
            now, wave = z[i : i + sizes[q]], 1.0 if q == 0 else waves[2 * (q - 1) + part]
            after = ca.mtimes(A, now) + push * wave
            out.append(after)
            if q == 1:
                moved.append(0.5 * ca.dot(R_z, now + after) + ca.dot(R_u, powers) * wave)
    place = z[-2:] + ca.vertcat(*moved)
    return ca.Function("plant", [z, p, a, t], [ca.vertcat(*out, place)])


def stepped_form(cells: PortedCells, wanted: SymbolicRequest) -> SymbolicLoop:
    """The step of linear cells with a step of their own on a linear field (`PortedSteps`)."""
    import casadi as ca

    loop, cell, K, m = steering(ported_loop(cells)), cells.model, cells.n_cells, cells.order
    known_names(wanted.parameters, OF_A_CELL, "parameters")
    (M, G), each = cells.whole, cell_prefixes(K)
    U, n = read_points(cells.coupling.field, wanted.points), len(cells.whole[0])
    values = cell_values(loop.controller.kappa, loop.sensor)
    known = SymbolicParameters(wanted.parameters, values, each, per_cell=wanted.per_cell)
    loads = point_names("load", U)
    told = ToldInputs(wanted.inputs, each, ca.MX.sym("u", K * len(wanted.inputs) + len(loads)))
    x, dt = ca.MX.sym("x", n + 3 * K), float(cells.model.dt or 0.0)
    driven, ahead, sensed = [], [], []
    for k, name in enumerate(each):
        p = x[n + 3 * k : n + 3 * k + 3]
        push = told.amplitude(k), known.value("force", name)
        driven.append(commands_of(loop.model.input_names, told.pointed(k, p), *push))
        own = x[k * m : (k + 1) * m]
        d = direction_of(loop.sensor, own, known, name, normalise=loop.normalise)
        sensed.append(d)
        ahead.append(turned(loop.controller, p, d, known.value("kappa", name), dt))
    drive = ca.mtimes(ca.DM(G @ np.kron(np.eye(K), cell.B)), ca.vertcat(*driven))
    moved = ca.mtimes(ca.DM(M), x[:n]) + drive + ca.DM(G @ np.tile(cell.offset, K))
    if loads:
        moved = moved + ca.mtimes(ca.DM(cells.given_loads @ U.T), told.u[-len(loads) :])
    x0 = initial(cells, loop, None, None, None)
    z_names, p_names = latent_names(m, each), vector_names("p", each)
    places, place_names = place_outputs(x[: K * m], wanted.place, each, m)
    return SymbolicLoop(
        states=(*z_names, *(f"field_q[{i}]" for i in range(n - K * m)), *p_names),
        inputs=(*told.names, *loads),
        parameters=known.labels,
        outputs=(*z_names, *p_names, *vector_names("d", each), *place_names),
        x=x,
        u=told.u,
        p=known.p,
        t=ca.MX.sym("t"),
        rhs=ca.vertcat(moved, *ahead),
        moved=moved,
        y=ca.vertcat(x[: K * m], x[n:], *sensed, *places),
        dt=dt,
        place=ca.vertcat(*places) if places else None,
        x0=x0,
        u0=np.concatenate([told.start(heading_of(x0[n:].reshape(K, 3))), np.zeros(len(loads))]),
        p0=known.p0,
    )


def equivariant_form(cells: EquivariantCells, wanted: SymbolicRequest) -> SymbolicLoop:
    """The step of equivariant cells on a field, frozen and linear as in their `plant`.

    States are those of the plant, centroids behind the field, and the polarities; each turns by
    half a step towards what its cell senses before and after the step, as in a run.
    """
    import casadi as ca

    sensor, law, K = cells.sensor, cells.controller, cells.n_cells
    if sensor is not None and not isinstance(sensor, StiffnessSensor):
        raise ParameterError(
            f"a symbolic loop has sensors of the cell's own state, and this one a "
            f"{type(sensor).__name__}, which reads the field; give couple(sensor=model.sensor)"
        )
    steered = sensor is not None and law is not None
    known_names(wanted.parameters, STEERED if steered else (), "parameters")
    plant, each = cells.plant(commands="harmonics", points=wanted.points), cell_prefixes(K)
    A, B = np.asarray(plant.A), np.asarray(plant.B)
    n, m, names = len(A), cells.order, cells.model.input_names
    loads = [name for name in plant.input_labels if name.startswith("load")]
    values = cell_values(0.0 if law is None else law.kappa, sensor)
    known = SymbolicParameters(wanted.parameters, values, each, per_cell=wanted.per_cell)
    told = ToldInputs(wanted.inputs, each, ca.MX.sym("u", K * len(wanted.inputs) + len(loads)))
    x, half = ca.MX.sym("x", n + 3 * K), 0.5 * cells.dt

    def latent(y: ca.MX, k: int) -> ca.MX:
        return ca.vertcat(y[k * (m - 2) : (k + 1) * (m - 2)], y[n - 2 * K + 2 * k :][:2])

    def turn(p: ca.MX, y: ca.MX, k: int) -> ca.MX:
        if sensor is None or law is None:
            return p
        kappa = known.value("kappa", each[k])
        d = direction_of(sensor, latent(y, k), known, each[k], normalise=cells.normalise)
        return turned(law, p, d, kappa, half)

    ps = [turn(x[n + 3 * k : n + 3 * k + 3], x[:n], k) for k in range(K)]
    ps = [told.pointed(k, p) for k, p in enumerate(ps)]
    driven = [commands_of(names, p, told.amplitude(k), ca.MX(1.0)) for k, p in enumerate(ps)]
    extra = [told.u[-len(loads) :]] if loads else []
    moved = ca.mtimes(ca.DM(A), x[:n]) + ca.mtimes(ca.DM(B), ca.vertcat(*driven, *extra, 1.0))
    commanded = "heading" in wanted.inputs
    ahead = ps if commanded else [turn(p, moved, k) for k, p in enumerate(ps)]
    p_names = vector_names("p", each)
    start = np.zeros(n + 3 * K)
    z_start = cells.model.z_start
    if z_start is not None:
        start[: K * (m - 2)] = np.tile(z_start[:-2], K)
    start[n - 2 * K : n] = np.asarray(cells.coupling.positions)[:, :2].ravel()
    theta = np.asarray(cells.coupling.headings)
    start[n:] = np.column_stack([np.cos(theta), np.sin(theta), 0 * theta]).ravel()
    C = np.asarray(plant.C)
    shown = [i for i, name in enumerate(plant.output_labels) if "_p_" not in name]
    return SymbolicLoop(
        states=(*plant.state_labels, *p_names),
        inputs=(*told.names, *loads),
        parameters=known.labels,
        outputs=(*(plant.output_labels[i] for i in shown), *p_names),
        x=x,
        u=told.u,
        p=known.p,
        t=ca.MX.sym("t"),
        rhs=ca.vertcat(moved, *ahead),
        moved=moved,
        y=ca.vertcat(ca.mtimes(ca.DM(C[shown]), x[:n]), x[n:]),
        place=x[n - 2 * K : n],
        dt=cells.dt,
        wide=isinstance(sensor, LocalSensor),
        x0=start,
        u0=np.concatenate([told.start(theta), np.zeros(len(loads))]),
        p0=known.p0,
    )
