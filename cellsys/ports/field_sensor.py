"""The sensor on a shared field: the full-order sensing law on the field's own fibres.

    d_k = direction of sum_j w_j s_j (x_j - c_k)/rho_j        [laws.sensing]

s_j is the tangent stiffness (or tensile virial) of the fibres at node j, strained by all cells:
through it cells turn towards each other, which no sensor of a cell's own state can make them do.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Protocol

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import MatrixField
from cellsys.errors import ParameterError
from cellsys.laws.sensing import (
    contrast,
    fibre_ends,
    graded,
    measure_moment,
    nodal_sum,
    sensed_direction,
)
from cellsys.model.stiffness_map import INNER, REACH
from cellsys.ports.capabilities import CellSensor, FibreField, NetworkReader

MEASURES = ("stiffness", "stress")


class SensingParameters(Protocol):
    """A scene's effect such as stiffness_sensing."""

    @property
    def measure(self) -> str:
        """``"stiffness"`` or ``"stress"``."""

    @property
    def reach(self) -> float:
        """Sensing range, um."""

    @property
    def inner(self) -> float:
        """Inner radius of the shell, um."""

    @property
    def threshold(self) -> float:
        """Least |q|/S that turns a cell."""

    @property
    def unit(self) -> bool:
        """Whether the cue has length 1."""

    @property
    def noise(self) -> float:
        """g0 of a graded cue."""


@checked
@dataclass(frozen=True)
class FieldSensor:
    """Reads the direction that the full-order model would sense in the reduced field.

    Nothing is learned. Parameters are those of the effect ``stiffness_sensing``.

    Parameters
    ----------
    measure : {"stiffness", "stress"}
        Nodal tangent stiffness, or tensile stress in a shell.
    reach, inner : float
        Sensing range and inner radius of the shell, um.
    threshold : float
        Least |q|/S that turns a cell; below it d is the cell's own polarity. Of unit directions.
    noise : float
        g0 of a graded cue; 0: d has length 1.
    """

    measure: str = "stiffness"
    _: KW_ONLY
    reach: float = REACH
    inner: float = INNER
    threshold: float = 1e-3
    noise: float = 0.0

    def __post_init__(self) -> None:
        if self.measure not in MEASURES:
            raise ParameterError(
                f"measure must be one of {', '.join(MEASURES)}, got {self.measure!r}"
            )
        for name in ("reach", "inner", "threshold", "noise"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ParameterError(f"FieldSensor.{name} must be finite and >= 0, got {value!r}")
        if not self.reach > 1.0:
            raise ParameterError(f"FieldSensor.reach must be > 1 um, got {self.reach!r}")

    @classmethod
    def of(cls, effect: SensingParameters) -> FieldSensor:
        """The sensor of a scene's effect ``stiffness_sensing``."""
        return cls(
            measure=effect.measure,
            reach=effect.reach,
            inner=effect.inner,
            threshold=effect.threshold,
            noise=0.0 if effect.unit else effect.noise,
        )

    def directions(
        self, field: MatrixField, q: np.ndarray, places: np.ndarray, p: np.ndarray
    ) -> np.ndarray:
        """Cues (K, 3) sensed at places (K, 2), um, by cells of polarities p (K, 3).

        Raises
        ------
        ParameterError
            When the field has no fibres to read (a `LinearField` from matrices).
        """
        if not isinstance(field, FibreField):
            raise ParameterError(
                f"a FieldSensor reads the fibres of a field, and a {type(field).__name__} has "
                "none; use a GalerkinField or a full field"
            )
        u = field.displacement(q)
        if self.noise:
            return np.array([self._graded(field, u, c) for c in places])
        nodal = field.matrix.nodal(u)
        stress = self.measure == "stress"
        measure, inner = nodal["virial" if stress else "stiffness"], self.inner if stress else 0.0
        nodes = field.nodes + u
        return np.array(
            [
                sensed_direction(nodes, measure, c, p_k, inner, self.reach, self.threshold)
                for c, p_k in zip(places, p, strict=True)
            ]
        )

    def _graded(self, field: FibreField, u: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Graded cue (3,) at one place."""
        nodes = field.matrix.rest + u
        if self.measure == "stiffness":
            g = contrast(nodes, field.matrix.fibre_stiffness(u), place, self.reach)
        else:
            virial = field.matrix.nodal(u)["virial"]
            q, total = measure_moment(nodes, virial, place, self.inner, self.reach)
            g = q / total if total > 0.0 else np.zeros(2)
        return np.array([*graded(g, self.noise), 0.0])


def standing_on(field: MatrixField, sensor: CellSensor | None) -> CellSensor | None:
    """The sensor with the network of this field, where it reads the stiffness at rest.

    A `LocalSensor` keeps the network it was fitted on; cells on another matrix stand on another.

    Raises
    ------
    ParameterError
        When the field has other nodes and no fibres to read (a `LinearField` from matrices).
    """
    if not isinstance(sensor, NetworkReader) or not (sensor.K_s.any() or sensor.a):
        return sensor
    nodes, known = np.asarray(field.nodes), sensor.map.nodes
    if isinstance(field, FibreField):
        disc = field.matrix.disc
        total = nodal_sum(len(nodes), disc.fibres, disc.stiffness)
        if sensor.map.contrasts:
            total = total / fibre_ends(len(nodes), disc.fibres)
        return sensor.on(nodes, total)
    if len(nodes) != len(known) or not np.array_equal(nodes[:, :2], known):
        raise ParameterError(
            f"the sensor reads the stiffness of its own network of {len(known)} nodes, and this "
            f"{type(field).__name__} of {len(nodes)} nodes has no fibres to read; use a "
            "GalerkinField or a full field, or a sensor of the latent state alone"
        )
    return sensor
