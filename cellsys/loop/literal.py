"""The loop with its inputs as printed: nodal forces from the table M_pol, projected [82, 85].

    z' = A z + b + V_x^T u(p)      u(p) = M_pol(:, theta(p)) F_L / (C_c + C_cort)      [70]
    p' = kappa p x (d x p)         d = K_d [1; z]

instead of B c(p), harmonics of the heading with B fitted. `MPol.lookup` says how the angle is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.errors import DimensionError, NotSymbolicError, ParameterError
from cellsys.integrate.simulate import simulate
from cellsys.loop.closed_loop import check_point
from cellsys.loop.input_map import MPol
from cellsys.loop.polarity import PolarityLaw
from cellsys.model.latent import LatentModel
from cellsys.model.sensor import StiffnessSensor
from cellsys.system import Block, Layout, OdeSystem, SymbolicForm
from cellsys.trajectory import Trajectory
from cellsys.units import real_array, real_number


class LiteralSystem(OdeSystem):
    """States z and p, driven by a table."""

    def casadi(self) -> SymbolicForm:
        """Refused: a table is looked up by the numbers of p.

        Raises
        ------
        NotSymbolicError
        """
        raise NotSymbolicError(
            "a loop driven by the table M_pol has no symbolic form; use DOP853, LSODA or "
            "RKC, or closed_loop(model), whose harmonics of the heading have one"
        )


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class LiteralLoop:
    """A polarity loop whose plant is pushed by M_pol. Made by `literal_loop`.

    Attributes
    ----------
    model : LatentModel
        Its own inputs are not used.
    input_map : MPol
    H : (m, 360)
        V_x^T M_pol F_L / C, 1/s in latent units: a column per degree.
    controller : PolarityLaw
    sensor : StiffnessSensor
    normalise : bool
    z0, p0 : (m,), (3,)
    """

    model: LatentModel
    input_map: MPol
    H: np.ndarray
    controller: PolarityLaw
    sensor: StiffnessSensor
    normalise: bool
    z0: np.ndarray
    p0: np.ndarray

    @property
    def order(self) -> int:
        """m."""
        return self.model.order

    @cached_property
    def _projected(self) -> MPol:
        short = -len(self.H) % 3  # a table has three rows per node
        return MPol(np.vstack([self.H, np.zeros((short, 360))]), self.input_map.lookup)

    def push(self, p: np.ndarray) -> np.ndarray:
        """V_x^T u(p) (m,), exactly as the table has it."""
        return self._projected.at(p)[: len(self.H)]

    @cached_property
    def system(self) -> OdeSystem:
        """The loop as an `OdeSystem` with states z and p."""
        A, _, b = self.model.continuous_matrices()
        m = self.order
        read = self.sensor.direction if self.normalise else self.sensor.raw

        def forcing(t: float, x: np.ndarray) -> np.ndarray:
            turned = self.controller.rate(x[m:], read(x[:m]))
            return np.concatenate([self.push(x[m:]) + b, turned])

        W = np.zeros((m + 3, m + 3))
        W[:m, :m] = A
        return LiteralSystem(
            states=Layout(
                [Block("z", (m,)), Block("p", (3,), "1", role="controller", kind="internal")]
            ),
            x0=np.concatenate([self.z0, self.p0]),
            W_x=sp.csr_array(W),
            forcing=forcing,
        )

    def simulate(self, t: np.ndarray, integrator: Integrator) -> Trajectory:
        """Run the loop at the times t (s).

        Between its columns a nearest or arctan lookup jumps, so that tolerances cost many steps.
        """
        return simulate(self.system, integrator, t, auxiliaries=False, label="literal loop")


@checked
def literal_loop(
    model: LatentModel,
    input_map: MPol,
    *,
    force: float,
    drag: float,
    rows: np.ndarray | None = None,
    controller: PolarityLaw | None = None,
    sensor: StiffnessSensor | None = None,
    normalise: bool = True,
    z0: np.ndarray | None = None,
    p0: np.ndarray | None = None,
) -> LiteralLoop:
    """The loop of thesis eq. 85 with the inputs of eq. 69-70 projected exactly.

    Parameters
    ----------
    model : LatentModel
        With a basis V.
    input_map : MPol
        Patterns of the membrane nodes.
    force : float
        F_L, pN.
    drag : float
        C_c + C_cort, pN s/um.
    rows : (3 n,) of int, optional
        States that the patterns act on; default the first 3 n.
    controller, sensor, normalise, z0, p0 : optional
        As in `closed_loop`.

    Raises
    ------
    ParameterError, DimensionError
        No sensor, a drag that is not positive, patterns of other sizes than the rows.
    """
    sensor = model.sensor if sensor is None else sensor
    if sensor is None:
        raise ParameterError("the model has no sensor: fit one or pass sensor=")
    if not (np.isfinite(real_number(drag, "drag")) and drag > 0):
        raise ParameterError(f"drag must be finite and > 0 pN s/um, got {drag!r}")
    if not np.isfinite(real_number(force, "force")):
        raise ParameterError(f"force must be finite, pN, got {force!r}")
    V, n = model.V_x, len(input_map.table)
    at = np.arange(n) if rows is None else np.asarray(rows)
    if at.shape != (n,) or at.dtype.kind not in "iu" or at.min() < 0 or at.max() >= len(V):
        raise DimensionError(
            f"rows must be {n} indices of the {len(V)} states of the model, as many as M_pol has "
            f"rows; got {at.shape}"
        )
    scale = np.ones(len(V)) if model.scale is None else model.scale[: len(V)]
    weight = np.divide(1.0, scale[at], out=np.zeros(n), where=scale[at] > 0)
    H = V[at].T @ (weight[:, None] * input_map.table) * (force / drag)
    z0 = model.z_start if z0 is None else real_array(z0, "z0")
    z0 = np.zeros(model.order) if z0 is None else z0
    p0 = np.array([1.0, 0.0, 0.0]) if p0 is None else real_array(p0, "p0")
    if z0.shape != (model.order,) or p0.shape != (3,):
        raise DimensionError(f"z0 must be ({model.order},) and p0 (3,), got {z0.shape}, {p0.shape}")
    check_point(z0, p0)
    return LiteralLoop(
        model=model,
        input_map=input_map,
        H=H,
        controller=controller or PolarityLaw(),
        sensor=sensor,
        normalise=normalise,
        z0=z0,
        p0=p0,
    )
