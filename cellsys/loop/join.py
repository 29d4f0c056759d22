"""`closed_loop`: plant, controller and sensor joined into one loop; systems made of a loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import overload

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.cell.model import EquivariantModel
from cellsys.contracts import LinearModel
from cellsys.errors import DimensionError, ParameterError
from cellsys.integrate.parameter_sensitivities import ParametricSystem
from cellsys.laws.arrays import Vector, operations
from cellsys.laws.polarity import rate as polarity_rate
from cellsys.loop.closed_loop import ClosedLoop, check_point
from cellsys.loop.loop_system import LoopCopies
from cellsys.loop.polarity import PolarityLaw
from cellsys.loop.scheduled import ScheduledLoop
from cellsys.model.latent import LatentModel
from cellsys.model.sensor import StiffnessSensor
from cellsys.samples.commands import harmonic
from cellsys.system import Block, Layout
from cellsys.units import shaped_array


@overload
def closed_loop(
    model: EquivariantModel,
    *,
    controller: PolarityLaw | None = None,
    sensor: StiffnessSensor | None = None,
    normalise: bool = True,
    z0: np.ndarray | None = None,
    p0: np.ndarray | None = None,
) -> ScheduledLoop:
    """The loop of a cell whose plant follows its clock."""


@overload
def closed_loop(
    model: LatentModel,
    *,
    controller: PolarityLaw | None = None,
    sensor: StiffnessSensor | None = None,
    normalise: bool = True,
    z0: np.ndarray | None = None,
    p0: np.ndarray | None = None,
) -> ClosedLoop:
    """The loop of a plant that is the same at all times."""


@overload
def closed_loop(
    model: LinearModel,
    *,
    controller: PolarityLaw | None = None,
    sensor: StiffnessSensor | None = None,
    normalise: bool = True,
    z0: np.ndarray | None = None,
    p0: np.ndarray | None = None,
) -> ClosedLoop | ScheduledLoop:
    """The loop of any linear model."""


@checked
def closed_loop(
    model: LinearModel,
    *,
    controller: PolarityLaw | None = None,
    sensor: StiffnessSensor | None = None,
    normalise: bool = True,
    z0: np.ndarray | None = None,
    p0: np.ndarray | None = None,
) -> ClosedLoop | ScheduledLoop:
    """Join a reduced plant, the polarity law and the sensor.

    An `EquivariantModel` gives a `ScheduledLoop`, whose plant follows its clock.

    Parameters
    ----------
    model : LinearModel
        With heading features as inputs.
    controller : PolarityLaw, optional
        Default kappa = 1/60 1/s.
    sensor : StiffnessSensor, optional
        Default the model's own.
    normalise : bool
        Scale d to unit length (default). A scheduled loop knows no other.
    z0, p0 : array (m,), (3,), optional
        Start; default the model's start and a heading of 0 degrees.

    Raises
    ------
    ParameterError, DimensionError
        When the model has no sensor, or inputs that are not heading features of one cell.
    """
    sensor = model.sensor if sensor is None else sensor
    if not isinstance(sensor, StiffnessSensor):
        had = "the model has no sensor" if sensor is None else f"got {type(sensor).__name__}"
        raise ParameterError(f"{had}; sensor must be a StiffnessSensor: fit one or pass sensor=")
    if sensor.S_d.shape[1] != model.order:
        raise DimensionError(
            f"the sensor reads {sensor.S_d.shape[1]} latent states, the model has {model.order}"
        )
    names = model.input_names
    owners = {n.rpartition(".")[0] for n in names}
    if not names or any(harmonic(n) is None for n in names) or len(owners) > 1:
        raise ParameterError(
            "closed_loop needs a model whose inputs are heading features of one cell "
            f"(amplitude, cos, sin, cos2, sin2, ...), got {list(names)}"
        )
    if z0 is None:
        z0 = model.z_start if model.z_start is not None else np.zeros(model.order)
    p0 = np.array([1.0, 0.0, 0.0]) if p0 is None else np.asarray(p0, dtype=float)
    z0 = np.asarray(z0, dtype=float)
    if z0.shape != (model.order,) or p0.shape != (3,):
        raise DimensionError(f"z0 must be ({model.order},) and p0 (3,), got {z0.shape}, {p0.shape}")
    check_point(z0, p0)
    law = controller or PolarityLaw()
    if not isinstance(model, EquivariantModel):
        return ClosedLoop(
            model=model, controller=law, sensor=sensor, normalise=normalise, z0=z0, p0=p0
        )
    if not normalise:
        raise ParameterError(
            "normalise=False is for a plant that is the same at all times; the loop of an "
            "equivariant cell takes the direction with |d| = 1; use closed_loop(model.at(t))"
        )
    return ScheduledLoop(model=model, controller=law, sensor=sensor, z0=z0, p0=p0)


@checked
def loop_copies(loop: ClosedLoop, z0: np.ndarray, p0: np.ndarray) -> LoopCopies:
    """The system of K cells with one loop each, from z0 (K, m) and p0 (K, 3).

    Raises
    ------
    DimensionError
        When z0 and p0 do not fit the loop.
    """
    m = loop.order
    z0 = shaped_array(z0, "z0", (None, m))
    K = len(z0)
    p0 = shaped_array(p0, "p0", (K, 3))
    if not K:
        raise DimensionError("z0 and p0 must hold at least one cell")
    A = loop.model.continuous_matrices()[0]
    system = LoopCopies(
        states=Layout(
            [Block("z", (K, m)), Block("p", (K, 3), "1", role="controller", kind="internal")]
        ),
        x0=np.concatenate([z0.ravel(), p0.ravel()]),
        W_x=sp.csr_array(sp.block_diag([*[A] * K, sp.csr_array((3 * K, 3 * K))], format="csr")),
    )
    system.__dict__["loop"], system.__dict__["cells"] = loop, K
    return system


@checked
def parametric_loop(loop: ClosedLoop) -> ParametricSystem:
    """The loop with its gain `kappa` (1/s) and a factor `force` on its commands as parameters.

    For `cs.parameter_sensitivities`: d trajectory/d kappa, d trajectory/d force.
    """
    A, B, b = loop.model.continuous_matrices()
    m = loop.order

    def rate(t: object, x: Vector, p: Mapping[str, Vector]) -> Vector:
        z, heading = x[:m], x[m:]
        turn = polarity_rate(heading, loop.sensed(z), p["kappa"])
        push = p["force"] * (B @ loop.commands(heading)) + b
        return operations(x).concatenate([push, turn])

    W = np.zeros((m + 3, m + 3))
    W[:m, :m] = A
    return ParametricSystem(
        states=loop.system.states,
        x0=loop.system.x0,
        W_x=sp.csr_array(W),
        rate=rate,
        parameters={"kappa": loop.controller.kappa, "force": 1.0},
    )
