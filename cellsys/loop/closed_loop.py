"""The closed polarity loop on a reduced plant: simulate it, linearise it, cut it open.

    z' = A z + b + B c(p)      p' = kappa p x (d x p)      d = K_d [1; z]   [thesis eq. 85]

Linearised about (z*, p*) with T the tangent of p in the substrate plane, dp = T xi:

    [[A, B_u T], [kappa T^T S_d, -kappa p*.d*]]             raw d
    [[A, B_u T], [kappa/|d*| T^T S_d, -kappa p*.d*/|d*|]]   normalised d
    [[A, B_u T], [kappa T^T J S_d, -kappa p*.d*]]           graded d of a contrast g, J = dd/dg

and broken at kappa, for negative feedback,

    L(s) = (kappa/s) (p*.d* - G(s)),   G(s) = T^T S_d (sI - A)^-1 B_u T

whose gain margin is the factor on kappa [notes: theory, return ratio].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.contracts import Integrator, LinearModel
from cellsys.drawable import Drawable
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.integrate.semilinear import Semilinear
from cellsys.integrate.simulate import simulate
from cellsys.integrate.symbolic import CVODES
from cellsys.kinds import shown
from cellsys.laws.arrays import Vector, operations
from cellsys.laws.polarity import heading_features
from cellsys.laws.sensing import cue, cue_slope
from cellsys.loop.blocks import loop_diagram
from cellsys.loop.loop_system import ClosedLoopSystem, model_error, semilinear_of, sensed_rows
from cellsys.loop.modal import set_apart_text, split_slow
from cellsys.loop.polarity import PolarityLaw
from cellsys.model.poles import KnowsCertainty
from cellsys.model.sensor import StiffnessSensor
from cellsys.samples.commands import feature_of
from cellsys.spectra.realization import Realization
from cellsys.state_space import state_space
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory
from cellsys.units import real_array

if TYPE_CHECKING:
    from control import InterconnectedSystem, StateSpace


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Linearisation(Drawable):
    """The loop linearised about one point.

    Parameters
    ----------
    A : (m + 1, m + 1), 1/s
        Closed loop in (z, xi).
    z, p, d : (m,), (3,), (3,)
        Where; d is the sensed direction there as the law uses it.
    residual : float
        |(z', p')| there, per unit of state: 0 at an equilibrium; else the linearisation is
        frozen in time.
    slow : array
        Plant poles set apart, 1/s: |pole| < `slower_than`, not to be told from integrators of
        absolute position over the run behind the model. `A` and the rest are without them.
    """

    A: np.ndarray
    z: np.ndarray
    p: np.ndarray
    d: np.ndarray
    residual: float
    kappa: float
    A_plant: np.ndarray
    B_heading: np.ndarray
    S_heading: np.ndarray
    strength: float
    slow: np.ndarray

    _figure: ClassVar[str] = "linearisation"

    @property
    def poles(self) -> np.ndarray:
        """Closed-loop poles, 1/s."""
        return sla.eigvals(self.A)

    def closed(self, factor: float = 1.0) -> np.ndarray:
        """Closed-loop matrix with kappa multiplied by `factor`."""
        A = self.A.copy()
        A[-1] *= factor
        return A

    def return_ratio(self) -> Realization:
        """The loop cut at kappa, for negative feedback: see `ClosedLoop.open_loop`."""
        m = len(self.A_plant)
        A = np.zeros((m + 1, m + 1))
        A[:m, :m], A[:m, m] = self.A_plant, self.B_heading
        B = np.zeros((m + 1, 1))
        B[m, 0] = self.kappa
        C = np.concatenate([-self.S_heading, [self.strength]])[None]
        names = (*(f"z[{i}]" for i in range(m)), "xi")
        return Realization(A, B, C, states=names, inputs=("v",), outputs=("y",))

    def __str__(self) -> str:
        where = "equilibrium" if self.residual < 1e-9 else "frozen time, not an equilibrium"
        apart = set_apart_text(self.slow)
        return (
            f"linearised loop, order {len(self.A)}: spectral abscissa "
            f"{self.poles.real.max():.3g} 1/s; {where} (residual {self.residual:.2g} 1/s){apart}"
        )


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class ClosedLoop:
    """Plant, controller and sensor joined.

    Parameters
    ----------
    model : LatentModel
        Its inputs must be heading features (amplitude, cos, sin, cos2, ...) of one cell.
    controller : PolarityLaw
    sensor : StiffnessSensor
    normalise : bool
        Whether d is what the full-order model senses (default): scaled to |d| = 1, or the graded
        cue of a sensor with a `noise`; else the sensor's raw value.
    z0, p0 : (m,), (3,)
        Start of `simulate`.
    """

    model: LinearModel
    controller: PolarityLaw
    sensor: StiffnessSensor
    normalise: bool
    z0: np.ndarray
    p0: np.ndarray

    @property
    def order(self) -> int:
        """m."""
        return self.model.order

    def commands(self, p: Vector) -> Vector:
        """Inputs c(p) of the model, numpy or CasADi."""
        parts = [feature_of(name) for name in self.model.input_names]
        values = heading_features(p, max((q for _, q, _ in parts), default=1) or 1)
        chosen = [
            1.0 if kind == "amplitude" else values[2 * (q - 1) + (kind == "sin")]
            for kind, q, _ in parts
        ]
        return operations(p).concatenate(chosen)

    def sensed(self, z: Vector) -> Vector:
        """d as the law uses it, numpy or CasADi."""
        raw = self.sensor.K_d[:, 0] + self.sensor.S_d @ z
        if not self.normalise:
            return raw
        if self.sensor.noise:
            return cue(raw, self.sensor.noise)
        ops = operations(z)
        # A raw direction of zero stays zero and turns nothing.
        return raw / ops.sqrt(ops.dot(raw, raw) + 1e-300)

    @cached_property
    def semilinear(self) -> Semilinear:
        """The linear plant and the slow heading, and what `Exponential` keeps of them."""
        return semilinear_of(self)

    @cached_property
    def system(self) -> ClosedLoopSystem:
        """The loop as an `OdeSystem` with states z and p."""
        A, B, b = self.model.continuous_matrices()
        m, loop = self.order, self

        def forcing(t: object, x: Vector) -> Vector:
            z, p = x[:m], x[m:]
            parts = [B @ loop.commands(p) + b, loop.controller.rate(p, loop.sensed(z))]
            return operations(x).concatenate(parts)

        W = np.zeros((m + 3, m + 3))
        W[:m, :m] = A
        system = ClosedLoopSystem(
            states=Layout(
                [Block("z", (m,)), Block("p", (3,), "1", role="controller", kind="internal")]
            ),
            x0=np.concatenate([self.z0, self.p0]),
            W_x=sp.csr_array(W),
            forcing=forcing,
        )
        object.__setattr__(system, "loop", self)
        return system

    def simulate(
        self,
        t: np.ndarray,
        integrator: Integrator,
        *,
        z0: np.ndarray | None = None,
        p0: np.ndarray | None = None,
        auxiliaries: bool = False,
    ) -> Trajectory:
        """Run the loop at the times `t` (s); `Exponential` is made for it. No laws are logged."""
        z0 = self.z0 if z0 is None else real_array(z0, "z0")
        p0 = self.p0 if p0 is None else real_array(p0, "p0")
        check_point(z0, p0)
        return simulate(
            self.system,
            integrator,
            t,
            np.concatenate([z0, p0]),
            auxiliaries=auxiliaries,
            label="closed loop, reduced",
            model_error=model_error(self.model),
        )

    def linearize(self, at: object = None, *, slower_than: float = 0.0) -> Linearisation:
        """Linearise about a point.

        Parameters
        ----------
        at : None, float, Trajectory, (z, p) or "equilibrium"
            None: the end of a 1500 s run from the loop's own start. A float: that time of such
            a run. A trajectory of this loop: its last sample. "equilibrium": solved by Newton's
            method from the end of that run (a crawling cell usually has none; then refused).
        slower_than : float
            Plant poles closer to zero than this, 1/s, are set apart (exactly, by decoupling),
            those that grow beyond their error bound never; 1/T for a run of length T is natural.
        """
        z, p = self._point(at)
        A, B, b = self.model.continuous_matrices()
        length = float(np.linalg.norm(p))
        if not abs(p[2]) <= 1e-6 * length:
            raise DataError(
                f"p = {p.round(3)} points out of the substrate plane; the loop is linearised in it"
            )
        tangent = np.array([-p[1], p[0], 0.0]) / np.hypot(p[0], p[1])
        B_heading = B @ self._features_slope(p)
        raw = self.sensor.raw(z)
        if self.normalise and self.sensor.noise:
            d = cue(raw, self.sensor.noise)
            S = length * (tangent @ cue_slope(raw, self.sensor.noise) @ self.sensor.S_d)
        else:
            size = float(np.linalg.norm(raw)) if self.normalise else 1.0
            if size == 0.0:
                raise DataError(
                    "the sensed direction is zero at this point: the loop has no slope there"
                )
            d = raw / size
            # Turning of p follows the part of d across p; normalisation removes that along d.
            S = length * (tangent @ self.sensor.S_d) / size
            if self.normalise:
                S = S - length * float(tangent @ d) * (d @ self.sensor.S_d) / size
        strength = float(p @ d)
        kappa = self.controller.kappa
        rate = np.concatenate(
            [A @ z + B @ np.asarray(self.commands(p)) + b, self.controller.rate(p, d)]
        )
        residual = float(np.linalg.norm(rate)) / max(1.0, float(np.linalg.norm(z)))
        known = None
        if slower_than > 0 and isinstance(self.model, KnowsCertainty):
            known = self.model.certainty()
        A, B_heading, S, slow = split_slow(A, B_heading[:, None], S[None], slower_than, known)
        B_heading, S = B_heading[:, 0], S[0]
        closed = np.block([[A, B_heading[:, None]], [kappa * S[None], -kappa * strength]])
        return Linearisation(
            A=closed,
            z=z,
            p=p,
            d=d,
            residual=residual,
            kappa=kappa,
            A_plant=A,
            B_heading=B_heading,
            S_heading=S,
            strength=strength,
            slow=slow,
        )

    def _features_slope(self, p: np.ndarray) -> np.ndarray:
        """dc/dtheta (n_c,) at heading theta of p."""
        theta, slope = np.arctan2(p[1], p[0]), []
        for name in self.model.input_names:
            kind, q, _ = feature_of(name)
            turned = {"cos": -np.sin(q * theta), "sin": np.cos(q * theta)}
            slope.append(q * turned.get(kind, 0.0))
        return np.array(slope)

    def open_loop(self, at: object = None) -> StateSpace:
        """Return ratio for negative feedback, cut at kappa, as `control.StateSpace`.

        Its gain margin is the factor on kappa. States z and xi, input v, output y:
        z' = A z + B_u T xi, xi' = kappa v, y = (p*.d*) xi - T^T S_d z. `at` is a
        `Linearisation` or what `linearize` takes.
        """
        point = at if isinstance(at, Linearisation) else self.linearize(at)
        ratio = point.return_ratio()
        return state_space(
            ratio.A,
            ratio.B,
            ratio.C,
            ratio.D,
            0,
            states=ratio.states,
            inputs=ratio.inputs,
            outputs=ratio.outputs,
            name="return_ratio_kappa",
        )

    def interconnect(self) -> InterconnectedSystem:
        """The loop as a diagram of python-control: plant, controller, commands and sensor.

        Blocks are `model.plant()`, `controller.block()` and the sensor; an input is fed by the
        output of its name (p_x, d_x, z[i], the commands, ``one``), and nothing comes from outside.
        Started from ``system.x0`` (z, then p) its ``control.input_output_response`` is `simulate`,
        to the tolerance of both integrators; outputs are z, p and d.
        """
        return loop_diagram(
            self.model.plant(),
            self.controller.block(),
            lambda z: sensed_rows(self, z),
            lambda p: np.array([np.asarray(self.commands(row)) for row in p]),
            order=self.order,
        )

    def _point(self, at: object) -> tuple[np.ndarray, np.ndarray]:
        if isinstance(at, str) and at != "equilibrium":
            raise ParameterError(
                f"at must be a time, a trajectory, (z, p) or 'equilibrium', got {at!r}"
            )
        if at is None or isinstance(at, (int, float, str)):
            end = 1500.0 if at is None or isinstance(at, str) else float(at)
            if not (np.isfinite(end) and end >= 0):
                raise ParameterError(f"at must be a time >= 0 s, got {end!r}")
            if end > 0:
                run = self.simulate(np.array([0.0, end]), CVODES(rtol=1e-8, atol=1e-8))
                z, p = run.x[-1, : self.order], run.x[-1, self.order :]
            else:
                z, p = self.z0, self.p0
            return self._equilibrium(z, p) if isinstance(at, str) else (z, p)
        if isinstance(at, Trajectory):
            if at.states != self.system.states:
                raise DimensionError(
                    f"the trajectory has {at.states.size} states and is not one of this loop, "
                    f"which has {self.order} latent states and p"
                )
            return np.asarray(at.x[-1, : self.order]), np.asarray(at.x[-1, self.order :])
        if not (isinstance(at, (tuple, list)) and len(at) == 2):
            raise ParameterError(
                f"at must be a time, a trajectory, (z, p) or 'equilibrium', got {shown(at)}"
            )
        z, p = real_array(at[0], "z"), real_array(at[1], "p")
        if z.shape != (self.order,) or p.shape != (3,):
            raise DimensionError(
                f"at must be (z ({self.order},), p (3,)), got {z.shape}, {p.shape}"
            )
        check_point(z, p)
        return z, p

    def _equilibrium(self, z: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        theta, length = float(np.arctan2(p[1], p[0])), float(np.linalg.norm(p))
        A, B, b = self.model.continuous_matrices()
        for _ in range(50):
            p = length * np.array([np.cos(theta), np.sin(theta), 0.0])
            point = self.linearize((z, p))
            across = np.array([-p[1], p[0], 0.0]) / length**2
            rate = np.concatenate(
                [
                    A @ z + B @ np.asarray(self.commands(p)) + b,
                    [float(across @ self.controller.rate(p, self.sensed(z)))],
                ]
            )
            if float(np.linalg.norm(rate)) < 1e-12 * max(1.0, float(np.linalg.norm(z))):
                return z, p
            step = sla.lstsq(point.A, -rate, cond=1e-14)[0]
            z, theta = z + step[:-1], theta + float(np.clip(step[-1], -0.5, 0.5))
        raise DataError(
            "no equilibrium found: Newton's method stopped at a rate of "
            f"{np.linalg.norm(rate):.2g}; a crawling cell has none, linearise at a time instead"
        )


def check_point(z: np.ndarray, p: np.ndarray) -> None:
    """Refuse a start without a heading, or one that holds NaN or inf."""
    if not (np.all(np.isfinite(z)) and np.all(np.isfinite(p))):
        raise DataError("z or p holds NaN or inf")
    if np.hypot(p[0], p[1]) < 1e-150:  # its square is no double
        raise DataError("p is normal to the substrate or zero: it has no heading")
