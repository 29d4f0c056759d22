"""The coupled system as a named `control.StateSpace`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellsys.errors import ParameterError
from cellsys.population.printed.blocks import ModeBlock
from cellsys.population.printed.printed_cells import PrintedCells
from cellsys.state_space import state_space

if TYPE_CHECKING:
    import control


def plant_of(cells: PrintedCells, blocks: list[ModeBlock], coordinates: str) -> control.StateSpace:
    """Assemble the blocks: x' = M x + G B c, z = T x, or the same in z.

    Parameters
    ----------
    cells : CoupledCells
    blocks : list of ModeBlock
    coordinates : {"emergent", "isolated"}
    """
    if coordinates not in ("emergent", "isolated"):
        raise ParameterError(f"coordinates must be 'emergent' or 'isolated', got {coordinates!r}")
    K, m = cells.n_cells, cells.order
    _, B, _ = cells.matrices
    emergent = coordinates == "emergent"
    M = np.array([b.emergent if emergent else b.M for b in blocks])
    T = np.array([np.eye(len(b.T)) if emergent else b.T for b in blocks])
    modes = cells.modes
    if modes is None:
        into = blocks[0].T @ blocks[0].G if emergent else blocks[0].G
        A, C, G = M[0], T[0], into @ np.kron(np.eye(K), B)
    else:
        into = np.array([(b.T @ b.G if emergent else b.G) @ B for b in blocks])
        A, C = modes.assemble(M), modes.assemble(T)
        G = modes.assemble(into) if B.shape[1] else np.zeros((K * m, 0))
    inputs = [n.split(".")[-1].replace(".", "_") for n in cells.model.input_names]
    inputs = [n.replace("[", "_").replace("]", "") for n in inputs]
    letter = "z" if emergent else "x"
    return state_space(
        A,
        G,
        C,
        np.zeros((K * m, G.shape[1])),
        0,
        states=[f"cell{k}_{letter}[{i}]" for k in range(1, K + 1) for i in range(m)],
        inputs=[f"cell{k}_{n}" for k in range(1, K + 1) for n in inputs],
        outputs=[f"cell{k}_z[{i}]" for k in range(1, K + 1) for i in range(m)],
        name=f"cells_K{K}_m{m}_{coordinates}",
    )
