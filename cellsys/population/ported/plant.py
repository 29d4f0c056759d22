"""Cells on one field as a named `control.StateSpace`: commands and loads in, read-outs out.

x+ = M x + G (B u + b) + L l        x = [z_1 .. z_K, q]           (or x')
c_k+ = c_k + R_z (x_1 + x_1+)/2 + R_u u_k + R_y E_k (q+ - q)/dt    centroids, of charges alone
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from cellsys.cell.charged import ChargedModel
from cellsys.contracts import MatrixField
from cellsys.errors import DimensionError, ParameterError
from cellsys.model.plant import ONE
from cellsys.model.sensor_block import latent_names, vector_names
from cellsys.population.ported.placement import Placement
from cellsys.population.signals import Constant, cell_prefixes, check_offset, command_names
from cellsys.ports.capabilities import ModalField
from cellsys.ports.ports import CellPort
from cellsys.samples.commands import feature_of, harmonic
from cellsys.state_space import state_space
from cellsys.system import is_sparse
from cellsys.units import real_array

if TYPE_CHECKING:
    import control


class LinearCells(Protocol):
    """Linear cells on one field, such as `PortedCells`, whose attributes these are."""

    @property
    def model(self) -> CellPort:
        """One cell."""

    @property
    def coupling(self) -> Placement:
        """Field, positions and headings."""

    @property
    def gathers(self) -> np.ndarray:
        """E_k of every cell, (K, n_f, order)."""

    @property
    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """(M, G)."""

    @property
    def given_loads(self) -> np.ndarray:
        """L (n, order)."""


def read_points(field: MatrixField, points: np.ndarray | None) -> np.ndarray:
    """U (3 P, order) of the surface nodes nearest to the points (P, 2) or (P, 3), um."""
    if points is None:
        return np.zeros((0, int(field.order)))
    places = real_array(points, "points")
    if places.ndim != 2 or places.shape[1] not in (2, 3) or not np.all(np.isfinite(places)):
        raise DimensionError(
            f"points must be finite, (P, 2) or (P, 3) in um, got shape {places.shape}"
        )
    surface = np.asarray(field.surface)
    far = np.asarray(field.nodes)[surface][:, : places.shape[1]]
    nearest = [surface[int(np.argmin(np.linalg.norm(far - x, axis=1)))] for x in places]
    rows = (3 * np.array(nearest, dtype=int)[:, None] + np.arange(3)).ravel()
    if isinstance(field, ModalField):
        modes = field.modes[rows]
        return np.asarray(modes.toarray() if is_sparse(modes) else modes)
    unit = np.zeros((len(rows), np.size(field.nodes)))
    unit[np.arange(len(rows)), rows] = 1.0
    return np.asarray(field.project(unit.reshape(len(rows), -1, 3)))


def point_names(name: str, U: np.ndarray) -> list[str]:
    """``load1_x, load1_y, ...`` of the rows of U."""
    return vector_names("", [f"{name}{i}" for i in range(1, len(U) // 3 + 1)])


def linear_plant(
    cells: LinearCells, points: np.ndarray | None, offset: Constant
) -> control.StateSpace:
    """The plant of `PortedCells`: cells stand where they are; outputs are the states, and U q."""
    check_offset(offset)
    (M, G), cell, field = cells.whole, cells.model, cells.coupling.field
    K, m = len(cells.coupling.positions), cell.order
    U = read_points(field, points)
    B = np.hstack([G @ np.kron(np.eye(K), cell.B), cells.given_loads @ U.T])
    inputs = [*command_names(cell.input_names, K), *point_names("load", U)]
    if offset == "input":
        B = np.column_stack([B, G @ np.tile(cell.offset, K)])
        inputs.append(ONE)
    states = latent_names(m, cell_prefixes(K))
    states += [f"field_q[{i}]" for i in range(int(field.order))]
    C = np.vstack([np.eye(len(M)), np.hstack([np.zeros((len(U), K * m)), U])])
    return state_space(
        M,
        B,
        C,
        np.zeros((len(C), B.shape[1])),
        0 if cell.dt is None else cell.dt,
        states=states,
        inputs=inputs,
        outputs=[*states, *point_names("matrix", U)],
        name=f"ported_cells_K{K}",
    )


class SteeredInputs:
    """How the commands of one cell drive it: u = slope c + rest, in harmonics u.

    Parameters
    ----------
    names : tuple of str
        Harmonics.
    heading : float
        rad, about which commands are taken linear; amplitude 1.
    exact : bool
        The commands are the harmonics themselves.
    """

    def __init__(self, names: tuple[str, ...], heading: float, *, exact: bool) -> None:
        n, c, s = len(names), float(np.cos(heading)), float(np.sin(heading))
        if exact:
            self.slope, self.rest = np.eye(n), np.zeros(n)
            # Of a command, the polarity is what the unit harmonic says.
            unit = {harmonic(name): i for i, name in enumerate(names)}
            self.polarity, self.still = np.zeros((2, n)), np.zeros(2)
            for row, kind in enumerate(("cos", "sin")):
                self.polarity[row, unit[kind, 1, 0]] = 1.0
            return
        value, turned, grown = np.zeros(n), np.zeros(n), np.zeros(n)
        for i, name in enumerate(names):
            kind, q, power = feature_of(name)
            wave = {"cos": np.cos(q * heading), "sin": np.sin(q * heading)}
            turn = {"cos": -q * np.sin(q * heading), "sin": q * np.cos(q * heading)}
            value[i], turned[i] = wave.get(kind, 1.0), turn.get(kind, 0.0)
            grown[i] = power * value[i]
        self.slope = np.column_stack([grown, turned])
        self.rest = value - grown - heading * turned
        self.polarity = np.array([[0.0, -s], [0.0, c]])
        self.still = np.array([c + heading * s, s - heading * c])


def neighbours(x: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of each place (K, 2) and the one nearest to it."""
    if len(x) < 2:
        return []
    far = np.linalg.norm(x[:, None] - x[None], axis=2)
    np.fill_diagonal(far, np.inf)
    pairs = {(min(k, j), max(k, j)) for k, j in enumerate(far.argmin(axis=1).tolist())}
    return sorted(pairs)


def moving_plant(
    cells: LinearCells,
    model: ChargedModel,
    t: float,
    *,
    commands: Literal["heading", "harmonics"],
    points: np.ndarray | None,
    offset: Constant,
) -> control.StateSpace:
    """The plant of equivariant cells frozen at t, with their centroids as last states.

    Parameters
    ----------
    cells : PortedCells
        Shapes, loads and field, frozen.
    commands, points, offset
        See `EquivariantCells.plant`.
    """
    check_offset(offset)
    if commands not in ("heading", "harmonics"):
        raise ParameterError(f"commands must be 'heading' or 'harmonics', got {commands!r}")
    (M, G), placement, field = cells.whole, cells.coupling, cells.coupling.field
    places = np.asarray(placement.positions)[:, :2]
    K, m, n = len(places), cells.model.order, int(field.order)
    names, dt = model.input_names, model.dt
    _, B, b = model.dynamics.step_matrices(float(t), riding=True)
    R = _read_out(model, float(t), m)
    R_u = B[m:] - R @ B[:m]
    ride = _ride(model, cells.gathers) / dt  # of q+ - q
    exact = commands == "harmonics"
    steered = [SteeredInputs(names, float(a), exact=exact) for a in np.asarray(placement.headings)]
    n_u = steered[0].slope.shape[1]
    U = read_points(field, points)
    # Commands, loads, and what is constant, as columns of [z, q] and of the centroids.
    on_x, on_c = np.zeros((len(M), K * n_u)), np.zeros((2 * K, K * n_u))
    const_x, const_c = np.zeros(len(M)), np.zeros(2 * K)
    for k, one in enumerate(steered):
        own, to = slice(k * n_u, (k + 1) * n_u), slice(k * m, (k + 1) * m)
        at = slice(2 * k, 2 * k + 2)
        on_x[:, own] = G[:, to] @ (B[:m] @ one.slope)
        const_x += G[:, to] @ (B[:m] @ one.rest + b[:m])
        on_c[at, own], const_c[at] = R_u @ one.slope, R_u @ one.rest
    drive = np.column_stack([on_x, cells.given_loads @ U.T, const_x])
    sums = np.hstack([np.kron(np.eye(K), R), np.zeros((2 * K, n))])  # of x + x+
    steps = np.hstack([np.zeros((2 * K, K * m)), ride])  # of x+ - x
    own_c = np.column_stack([on_c, np.zeros((2 * K, len(U))), const_c])
    A = np.block(
        [
            [M, np.zeros((len(M), 2 * K))],
            [sums @ M + sums + steps @ M - steps, np.eye(2 * K)],
        ]
    )
    drive = np.vstack([drive, (sums + steps) @ drive + own_c])
    C, D, outputs = _outputs(places, steered, U, K * m, drive.shape[1])
    inputs = [
        *command_names(names if exact else ("amplitude", "heading"), K),
        *point_names("load", U),
        ONE,
    ]
    if offset == "drop":
        drive, D, inputs = drive[:, :-1], D[:, :-1], inputs[:-1]
    each = cell_prefixes(K)
    states = [*latent_names(m, each), *(f"field_q[{i}]" for i in range(n))]
    return state_space(
        A,
        drive,
        C,
        D,
        dt,
        states=[*states, *(f"{cell}{axis}" for cell in each for axis in "xy")],
        inputs=inputs,
        outputs=outputs,
        name=f"equivariant_cells_K{K}",
    )


def _read_out(model: ChargedModel, t: float, m: int) -> np.ndarray:
    """R (2, m): (R_z x_1)/2 of the real states, on a matrix."""
    dynamics = model.dynamics
    R_z = dynamics.clock.weights(t) @ dynamics.riding.R_z
    first, size = dynamics.starts()[1], dynamics.blocks[1].size
    out = np.zeros((2, m))
    for part in range(2):
        out[part, first + part * size : first + (part + 1) * size] = 0.5 * R_z
    return out


def _ride(model: ChargedModel, gathers: np.ndarray) -> np.ndarray:
    """(2 K, order): R_y of the displacement W_0 gathered under each cell."""
    blocks, hats = model.dynamics.blocks, model.representation.port.n_hats
    none, one = len(blocks[0].C), len(blocks[1].C)
    weights = model.dynamics.riding.R_y
    rows = [
        weights @ E[none + part * one + hats : none + part * one + 2 * hats]
        for E in gathers
        for part in range(2)
    ]
    return np.array(rows)


def _outputs(
    places: np.ndarray, steered: list[SteeredInputs], U: np.ndarray, n_z: int, n_in: int
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """C, D and names: displacements, then centroid and polarity of each cell, then gaps."""
    K, n = len(places), U.shape[1]
    size = n_z + n + 2 * K
    C = [np.hstack([np.zeros((len(U), n_z)), U, np.zeros((len(U), 2 * K))])]
    D = [np.zeros((len(U), n_in))]
    names = point_names("matrix", U)
    for k, one in enumerate(steered):
        centre, turned = np.zeros((4, size)), np.zeros((4, n_in))
        centre[[0, 1], [n_z + n + 2 * k, n_z + n + 2 * k + 1]] = 1.0
        n_u = one.polarity.shape[1]
        turned[2:, k * n_u : (k + 1) * n_u], turned[2:, -1] = one.polarity, one.still
        C.append(centre)
        D.append(turned)
        names += [f"cell{k + 1}_{what}" for what in ("x", "y", "p_x", "p_y")]
    for i, j in neighbours(places):
        line, row = places[j] - places[i], np.zeros((1, size))
        line = line / np.linalg.norm(line)
        for k, sign in ((i, -1.0), (j, 1.0)):
            row[0, n_z + n + 2 * k : n_z + n + 2 * k + 2] = sign * line
        C.append(row)
        D.append(np.zeros((1, n_in)))
        names.append(f"gap{i + 1}_{j + 1}")
    return np.vstack(C), np.vstack(D), names
