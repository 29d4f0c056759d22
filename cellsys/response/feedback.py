"""Closing a loop, the gain at rest, and the bandwidth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.errors import DimensionError, ParameterError
from cellsys.response import grid
from cellsys.response.brackets import find_roots
from cellsys.response.channel import one_channel
from cellsys.spectra.minimal import minreal
from cellsys.spectra.realization import EPS, Realization, realization, same_time
from cellsys.spectra.resolvent import Resolvent, s_plane
from cellsys.units import real_number

if TYPE_CHECKING:
    import control


@checked
def feedback(
    sys: LinearSystem, controller: LinearSystem | float = 1.0, sign: int = -1
) -> control.StateSpace:
    """y = G e, e = r + sign K y: the closed loop from r to y, names of G kept.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction or tuple of arrays
        G, (p, m).
    controller : the same, or float
        K, (m, p); a number stands for that number times I, of a square G.
    sign : int
        -1 (negative feedback) or 1.

    Returns
    -------
    control.StateSpace

    Raises
    ------
    DimensionError
        Channels that do not fit.
    ParameterError
        Mixed sampling times, another sign, or an algebraic loop (I - sign D_G D_K singular).
    """
    G = realization(sys).dense()
    if sign not in (-1, 1):
        raise ParameterError(f"sign must be -1 or 1, got {sign!r}")
    if isinstance(controller, (int, float)):
        if G.n_inputs != G.n_outputs:
            raise DimensionError(
                f"a number as controller is for as many outputs as inputs, got {G.n_outputs} and "
                f"{G.n_inputs}; give a matrix gain as (np.zeros((0, 0)), [], [], K)"
            )
        K = Realization(
            np.zeros((0, 0)), D=real_number(controller, "controller") * np.eye(G.n_inputs), dt=G.dt
        )
    else:
        K = realization(controller).dense()
    dt = same_time(G, K)
    if (K.n_outputs, K.n_inputs) != (G.n_inputs, G.n_outputs):
        raise DimensionError(
            f"the controller must be {G.n_inputs} outputs x {G.n_outputs} inputs, got "
            f"{K.n_outputs} x {K.n_inputs}"
        )
    F = np.eye(G.n_inputs) - sign * K.D @ G.D
    if F.size and sla.svdvals(F)[-1] < 1e-14 * max(1.0, float(sla.norm(F))):
        raise ParameterError("the loop is algebraic: I - sign D_K D_G is singular; add a lag")
    E = np.linalg.solve(F, np.hstack([np.eye(G.n_inputs), sign * K.D @ G.C, sign * K.C]))
    R, X, Z = np.split(E, [G.n_inputs, G.n_inputs + G.n_states], axis=1)  # e = R r + X x + Z z
    y = (G.C + G.D @ X, G.D @ Z, G.D @ R)
    A = np.block([[G.A + G.B @ X, G.B @ Z], [K.B @ y[0], K.A + K.B @ y[1]]])
    closed = Realization(
        A, np.vstack([G.B @ R, K.B @ y[2]]), np.hstack(y[:2]), y[2], dt=dt,
        inputs=G.inputs, outputs=G.outputs,
        states=(*G.states, *(f"K.{name}" for name in K.states)),
    )  # fmt: skip
    return closed.state_space()


def series(systems: Sequence[Realization]) -> Realization:
    """The first behind no other, each driven by the one before: one dt, channels that fit."""
    total = systems[0]
    for after in systems[1:]:
        B, C = after.B @ total.C, after.D @ total.C
        A = np.block([[total.A, np.zeros((total.n_states, after.n_states))], [B, after.A]])
        total = Realization(
            A, np.vstack([total.B, after.B @ total.D]), np.hstack([C, after.C]),
            after.D @ total.D, dt=same_time(total, after),
        )  # fmt: skip
    return total


@checked
def dcgain(sys: LinearSystem) -> np.ndarray:
    """G(0), or G(1) in discrete time: what a constant input leads to, (p, m).

    inf, with the sign of what a step leads to, where an integrator stands between an input and an
    output.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction or tuple of arrays

    Returns
    -------
    array (p, m)

    Raises
    ------
    DataError, DimensionError, MemoryBudgetError
        As for `poles`.
    """
    system = realization(sys).dense()
    out, lost = _at_rest(system)
    for i, j in np.argwhere(lost):
        channel = minreal(one_channel(system, int(j), int(i)).state_space()).system
        value, still = _at_rest(channel)
        if still[0, 0]:  # its own integrator: what it goes to from the right
            n = max(channel.n_states, 1)
            step = 1e-6 * (1.0 if channel.is_discrete else float(sla.norm(channel.A)) or 1.0) / n
            near = np.array([1.0 + step if channel.is_discrete else step], complex)
            value = np.copysign(np.inf, Resolvent(channel)(near).real[:, :, 0])
        out[i, j] = value[0, 0]
    return out


def _at_rest(system: Realization) -> tuple[np.ndarray, np.ndarray]:
    """G at 0 (at 1 in discrete time), and where nothing is known of it."""
    point = np.array([1.0 if system.is_discrete else 0.0], complex)
    G, bound = Resolvent(system).with_accuracy(point)
    value = G[:, :, 0].real.copy()
    lost = ~np.isfinite(G[:, :, 0])
    return value, lost | (bound[:, :, 0] > np.maximum(0.1 * np.abs(value), 1e-3))


@checked
def bandwidth(
    sys: LinearSystem,
    *,
    input: str | int | None = None,
    output: str | int | None = None,
    drop: float = -3.0,
) -> float:
    """First frequency, rad/s, where |G| has fallen by `drop` dB below G(0); inf if it never does.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction or tuple of arrays
    input, output : str or int, optional
        The channel of a system of several.
    drop : float
        dB, below 0.

    Returns
    -------
    float

    Raises
    ------
    ParameterError
        G(0) is 0 or infinite: nothing to fall from.
    """
    system = one_channel(realization(sys).dense(), input, output)
    drop = real_number(drop, "drop")
    if not drop < 0:
        raise ParameterError(f"drop must be < 0 dB, got {drop!r}")
    rest = abs(float(dcgain(system.state_space())[0, 0]))
    if not (np.isfinite(rest) and rest > 0):
        raise ParameterError(
            f"the gain at rest is {rest:g}: a bandwidth is the fall from it; read the band off "
            "frequency_response"
        )
    evaluate = Resolvent(system)
    level = np.log(rest) + drop * np.log(10) / 20

    def above(omega: np.ndarray, _: np.ndarray | None = None) -> np.ndarray:
        G = np.abs(evaluate(s_plane(omega, system.dt))[0, 0])
        return np.asarray(np.log(np.maximum(G, 1e-300)) - level)

    omega, _ = grid.refine(lambda w: evaluate(s_plane(w, system.dt))[0], grid.automatic(system))
    f = above(omega)
    while f[-1] > 0 and not system.is_discrete and omega[-1] < 1e12 * omega[0]:
        if np.exp(f[-1] + level) <= abs(float(system.D[0, 0])) * (1 + 1e-6):
            return float("inf")
        omega = np.append(omega, 2 * omega[-1])
        f = np.append(f, above(omega[-1:]))
    k = np.flatnonzero(f <= 0)
    if not k.size:
        return float("inf")
    j = int(k[0])
    if j == 0:
        a, b = omega[:1] * 1e-12, omega[:1]
    else:
        a, b = omega[j - 1 : j], omega[j : j + 1]
    return float(
        find_roots(above, a, b, above(a), above(b), np.sqrt(a * b), np.full(1, 4 * EPS))[0]
    )
