"""Which states, inputs and outputs take part in which mode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.spectra.realization import balance, realization
from cellsys.spectra.roots import order


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Participation(Drawable):
    """Modes in columns or rows, ordered by falling real part.

    Attributes
    ----------
    poles : complex array (n,)
    states : array (n, n)
        |v_ki w_ik|: share of state k (row) in mode i (column).
    outputs : array (p, n)
        |C v_i|: how mode i shows in each output; v_i of unit length in balanced coordinates.
    inputs : array (n, m)
        |w_i^H B|, w_i^H v_i = 1: how each input excites mode i.
    residue : array (p, m, n)
        |C v_i w_i^H B|: does not depend on any scaling of the states.
    condition : array (n,)
        Condition number of each eigenvalue: beyond 1e8 the modes of a cluster cannot be told
        apart and only their sum means something.
    state_names, input_names, output_names : tuple of str
    """

    _figure: ClassVar[str] = "participation"
    poles: np.ndarray
    states: np.ndarray
    outputs: np.ndarray
    inputs: np.ndarray
    residue: np.ndarray
    condition: np.ndarray
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]

    def __str__(self) -> str:
        lines = []
        for i in range(min(len(self.poles), 12)):
            k = int(np.argmax(self.states[:, i]))
            lines.append(f"{complex(self.poles[i]):.5g}: mostly {self.state_names[k]}")
        return "\n".join(lines) if lines else "no modes"


@checked
def participation(sys: LinearSystem) -> Participation:
    """Modal participation of states, outputs and inputs.

        A v_i = lambda_i v_i,  w_i^H A = lambda_i w_i^H,  w_i^H v_i = 1
        G(s) = D + sum_i C v_i w_i^H B / (s - lambda_i)

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays

    Returns
    -------
    Participation

    Raises
    ------
    DataError, DimensionError, ParameterError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Perez-Arriaga, Verghese and Schweppe, IEEE Trans. Power App. Syst. 101 (1982) 3117.
    """
    system = realization(sys).dense()
    n, m, p = system.n_states, system.n_inputs, system.n_outputs
    if n == 0:
        none = np.zeros
        return Participation(
            poles=none(0, complex),
            states=none((0, 0)),
            outputs=none((p, 0)),
            inputs=none((0, m)),
            residue=none((p, m, 0)),
            condition=none(0),
            state_names=(),
            input_names=system.inputs,
            output_names=system.outputs,
        )
    b = balance(system)
    values, left, right = sla.eig(b.A, left=True, right=True)
    rank = order(values)
    values, left, right = values[rank], left[:, rank], right[:, rank]
    inner = np.einsum("ij,ij->j", left.conj(), right)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        condition = np.where(inner == 0, np.inf, 1 / np.abs(inner))
        states = np.abs(right * left.conj() / inner)
        rows = np.abs((left.conj().T @ b.B) / inner[:, None]) / b.right
    columns = np.abs(b.C @ right) / b.left[:, None]
    residue = columns[:, None, :] * rows.T[None, :, :]
    return Participation(
        poles=values,
        states=states,
        outputs=columns,
        inputs=rows,
        residue=residue,
        condition=condition,
        state_names=system.states,
        input_names=system.inputs,
        output_names=system.outputs,
    )
