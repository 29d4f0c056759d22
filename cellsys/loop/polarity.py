"""The controller: the triple-product polarity law with its two degenerate directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.kinds import Seed
from cellsys.laws.arrays import Vector, is_symbolic
from cellsys.laws.polarity import exact_step, rate, rate_rows
from cellsys.model.sensor_block import vector_names
from cellsys.state_space import block
from cellsys.units import real_array, real_number

if TYPE_CHECKING:
    from control import NonlinearIOSystem


@checked
@dataclass(frozen=True)
class AntiparallelStay:
    """p = -d is an equilibrium of the law: stay there."""


@checked
@dataclass(frozen=True, kw_only=True)
class AntiparallelTurn:
    """Leave p near -d by a small turn in the substrate plane, its side drawn from a seed.

    Parameters
    ----------
    angle : float
        Turn, rad.
    within : float
        Cosine of p and d below which the turn is made.
    seed : int
        Of the side.
    """

    angle: float = 0.01
    within: float = -0.999
    seed: Seed = 0

    def __post_init__(self) -> None:
        if not 0 < self.angle < np.pi:
            raise ParameterError(
                f"AntiparallelTurn.angle must be in (0, pi) rad, got {self.angle!r}"
            )
        if not -1 <= self.within <= 1:
            raise ParameterError(f"AntiparallelTurn.within must be in [-1, 1], got {self.within!r}")


@checked
@dataclass(frozen=True)
class PolarityLaw:
    """dp/dt = kappa p x (d x p)                                          [thesis eq. 72]

    |p| is constant. d = 0 turns nothing. p = -|p| d/|d| is an unstable equilibrium; what happens
    there is the choice `antiparallel`.

    Parameters
    ----------
    kappa : float
        Gain, 1/s; the thesis's code has 1/60.
    antiparallel : AntiparallelStay or AntiparallelTurn
    """

    kappa: float = 1.0 / 60.0
    antiparallel: AntiparallelStay | AntiparallelTurn = AntiparallelStay()

    def __post_init__(self) -> None:
        if real_number(self.kappa, "PolarityLaw.kappa") < 0:
            raise ParameterError(
                f"PolarityLaw.kappa must be finite and >= 0 1/s, got {self.kappa!r}"
            )

    def rate(self, p: Vector, d: Vector) -> Vector:
        """dp/dt (3,), numpy or CasADi; p and d (3,), `DimensionError` or `DataError` otherwise.

        NaN and inf go through: an integrator that tries them names time, state and step.
        """
        if is_symbolic(p, d):
            return rate(p, d, self.kappa)
        vectors: tuple = self._vectors(p, d)
        with np.errstate(over="ignore", invalid="ignore"):
            return rate(vectors[0], vectors[1], self.kappa)

    @staticmethod
    def _vectors(p: object, d: object) -> tuple[np.ndarray, np.ndarray]:
        p, d = real_array(p, "p"), real_array(d, "d")
        if p.shape != (3,) or d.shape != (3,):
            raise DimensionError(f"p and d must have shape (3,), got {p.shape} and {d.shape}")
        return p, d

    def step(self, p: np.ndarray, d: np.ndarray, dt: float) -> np.ndarray:
        """Exact solution after dt seconds for constant d: tan(theta/2) decays exponentially.

        Raises
        ------
        DimensionError, DataError
            When p or d is not (3,) or not finite.
        """
        p, d = self._vectors(p, d)
        if not (np.all(np.isfinite(p)) and np.all(np.isfinite(d))):
            raise DataError(f"p or d is not finite: {p}, {d}")
        step = real_array(dt, "dt")
        if step.shape or not np.isfinite(step):
            raise DataError(f"dt is not finite, or not one number: {step!r}")
        return exact_step(self._off_antipode(p, d), d, self.kappa, float(step))

    def block(self, cells: Sequence[str] = ("",), *, dt: float | None = None) -> NonlinearIOSystem:
        """The law as a block of python-control: states and outputs p_x, p_y, p_z, inputs d_x, ...

        Its parameter ``kappa`` may be given to a response: ``params={"kappa": 0.03}``. A
        continuous block is dp/dt as it stands, whatever `antiparallel`, as for any integrator.

        Parameters
        ----------
        cells : sequence of str
            What the signals of each cell begin with, such as ``("cell1_", "cell2_")``.
        dt : float, optional
            s; a block that steps exactly with d held. Default continuous.
        """
        if dt is not None and not (np.isfinite(dt) and dt > 0):
            raise ParameterError(f"dt must be > 0 s, or None for a continuous block, got {dt!r}")
        K = len(cells)

        def update(
            t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]
        ) -> np.ndarray:
            p, d, kappa = x.reshape(K, 3), u.reshape(K, 3), float(params["kappa"])
            if dt is None:
                return rate_rows(p, d, kappa).ravel()
            law = self if kappa == self.kappa else replace(self, kappa=kappa)
            return np.array([law.step(a, b, dt) for a, b in zip(p, d, strict=True)]).ravel()

        names = vector_names("p", cells)
        return block(
            "controller",
            vector_names("d", cells),
            names,
            None,
            states=names,
            update=update,
            dt=0 if dt is None else dt,
            params={"kappa": self.kappa},
        )

    def _off_antipode(self, p: np.ndarray, d: np.ndarray) -> np.ndarray:
        if isinstance(self.antiparallel, AntiparallelStay):
            return p
        scale = float(np.linalg.norm(p) * np.linalg.norm(d))
        if scale == 0.0 or float(p @ d) > self.antiparallel.within * scale:
            return p
        # The side is a fixed draw from the seed, so that full and reduced runs turn alike.
        side = 1.0 if np.random.default_rng(self.antiparallel.seed).random() < 0.5 else -1.0
        c, s = np.cos(self.antiparallel.angle), side * np.sin(self.antiparallel.angle)
        return np.array([c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]])
