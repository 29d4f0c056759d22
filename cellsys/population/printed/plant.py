"""The coupled system as a named `control.StateSpace`, and closed as a diagram."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellsys.errors import ParameterError
from cellsys.loop.blocks import loop_diagram
from cellsys.model.plant import ONE
from cellsys.model.sensor_block import latent_names
from cellsys.population.headings import commands, sensed, steering
from cellsys.population.printed.blocks import ModeBlock
from cellsys.population.printed.printed_cells import PrintedCells
from cellsys.population.printed.propagators import rest_offset
from cellsys.population.signals import Constant, cell_prefixes, check_offset, command_names
from cellsys.state_space import state_space

if TYPE_CHECKING:
    import control

STIFF = 1e-3  # smallest 1 - lambda for which the printed form loses less than 1e-10 to rounding


def plant_of(
    cells: PrintedCells,
    blocks: list[ModeBlock],
    coordinates: str | None,
    offset: Constant,
) -> control.StateSpace:
    """Assemble the blocks: x' = M x + G (B c + b), z = T x + offset, or the same in z.

    Parameters
    ----------
    cells : CoupledCells
    blocks : list of ModeBlock
    coordinates : {"emergent", "isolated"}, optional
    offset : {"input", "drop"}
    """
    if coordinates is None:
        stiff = min(b.smallest for b in blocks) < STIFF
        coordinates = "isolated" if stiff else "emergent"
    if coordinates not in ("emergent", "isolated"):
        raise ParameterError(f"coordinates must be 'emergent' or 'isolated', got {coordinates!r}")
    check_offset(offset)
    K, m = cells.n_cells, cells.order
    _, B, b = cells.matrices
    emergent = coordinates == "emergent"
    M = np.array([b.emergent if emergent else b.M for b in blocks])
    T = np.array([np.eye(len(b.T)) if emergent else b.T for b in blocks])
    into = np.array([b.T @ b.G if emergent else b.G for b in blocks])
    modes = cells.modes
    if modes is None:
        A, C, G = M[0], T[0], into[0]
    else:
        A, C, G = modes.assemble(M), modes.assemble(T), modes.assemble(into)
    drive = G @ np.kron(np.eye(K), B) if B.shape[1] else np.zeros((K * m, 0))
    D = np.zeros((K * m, drive.shape[1]))
    names = command_names(cells.model.input_names, K)
    if offset == "input":
        push, rest = G @ np.tile(b, K), rest_offset(cells).ravel()
        if emergent:  # z' = M (z - rest) + ...
            push, rest = push - A @ rest, np.zeros(K * m)
        drive, D = np.column_stack([drive, push]), np.column_stack([D, rest])
        names = [*names, ONE]
    return state_space(
        A,
        drive,
        C,
        D,
        0,
        states=latent_names(m, cell_prefixes(K), "z" if emergent else "x"),
        inputs=names,
        outputs=latent_names(m, cell_prefixes(K)),
        name=f"cells_K{K}_m{m}_{coordinates}",
    )


def cells_diagram(cells: PrintedCells, blocks: list[ModeBlock]) -> control.InterconnectedSystem:
    """Plant in x, controllers, commands and sensors of all cells.

    Raises
    ------
    ParameterError
        For cells without a polarity loop.
    """
    loop, each = steering(cells.loop), cell_prefixes(cells.n_cells)
    return loop_diagram(
        plant_of(cells, blocks, "isolated", "input"),
        loop.controller.block(each),
        lambda z: sensed(loop, z @ loop.sensor.S_d.T),
        lambda p: commands(loop, p),
        cells=each,
        order=cells.order,
    )
