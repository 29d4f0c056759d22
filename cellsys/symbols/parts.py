"""What every symbolic loop is put together from: parameters, inputs, commands and senses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cellsys.errors import ParameterError
from cellsys.laws.polarity import heading_features
from cellsys.laws.sensing import cue
from cellsys.model.sensor import StiffnessSensor
from cellsys.model.sensor_symbols import raw_symbols, unit_symbols
from cellsys.samples.commands import feature_of

if TYPE_CHECKING:
    import casadi as ca

OF_A_CELL = ("kappa", "K_d", "sensor.gain", "force")
PLANT = ("A", "B", "offset")
PARAMETERS = (*OF_A_CELL, *PLANT, "coupling")
INPUTS = ("amplitude", "heading")


def known_names(wanted: Sequence[str], known: Sequence[str], what: str) -> tuple[str, ...]:
    """The names, refused unless they are different ones of the known."""
    wrong = [name for name in wanted if name not in known]
    if wrong or len(set(wanted)) < len(wanted):
        raise ParameterError(
            f"{what} must be different ones of {', '.join(known)}, got {list(wanted)}"
        )
    return tuple(wanted)


class SymbolicParameters:
    """Values by name, those asked for as symbols; of each cell its own where `per_cell`.

    Parameters
    ----------
    wanted : sequence of str
    values : mapping of str to array (rows, columns)
    cells : sequence of str
        What the names of each cell begin with.
    per_cell : bool
    """

    def __init__(
        self,
        wanted: Sequence[str],
        values: Mapping[str, np.ndarray],
        cells: Sequence[str],
        *,
        per_cell: bool,
    ) -> None:
        import casadi as ca

        self.values, labels, numbers = values, [], [np.zeros(0)]
        copies = [
            (name, cell)
            for name in wanted
            for cell in (cells if per_cell and name in OF_A_CELL else ("",))
        ]
        sizes = [values[name].size for name, _ in copies]
        ends = np.cumsum([0, *sizes]).tolist()
        self.p, self.symbols = ca.MX.sym("p", ends[-1]), {}
        for i, (name, cell) in enumerate(copies):  # row by row, as the labels
            value = values[name]
            part = ca.reshape(self.p[ends[i] : ends[i + 1]], *value.shape[::-1])
            self.symbols[name, cell] = part.T
            labels += [cell + label for label in _labels(name, value)]
            numbers.append(value.ravel())
        self.labels, self.p0 = tuple(labels), np.concatenate(numbers)

    def value(self, name: str, cell: str = "") -> ca.MX:
        """The symbol, that of the cell before that of all, or the number."""
        import casadi as ca

        for key in ((name, cell), (name, "")):
            if key in self.symbols:
                return self.symbols[key]
        return ca.MX(ca.DM(self.values[name]))


def _labels(name: str, value: np.ndarray) -> list[str]:
    rows, columns = value.shape
    if rows * columns == 1 and name not in ("A", "B", "offset"):
        return [name]
    if name == "offset":
        return [f"offset[{i}]" for i in range(rows)]
    return [f"{name}[{i},{j}]" for i in range(rows) for j in range(columns)]


def cell_values(kappa: float, sensor: StiffnessSensor | None) -> dict[str, np.ndarray]:
    """Numbers of the parameters that each cell has."""
    one = np.ones((1, 1))
    found = {"kappa": kappa * one, "sensor.gain": one, "force": one}
    return found if sensor is None else found | {"K_d": sensor.K_d}


def direction_of(
    sensor: StiffnessSensor, z: ca.MX, values: SymbolicParameters, cell: str, *, normalise: bool
) -> ca.MX:
    """d (3, 1) as the law uses it."""
    raw = raw_symbols(sensor, z, values.value("K_d", cell), values.value("sensor.gain", cell))
    if not normalise:
        return raw
    return cue(raw, sensor.noise) if sensor.noise else unit_symbols(raw)


@dataclass(frozen=True, eq=False)
class ToldInputs:
    """Inputs of all cells: amplitudes and headings, each an input or what the cell has itself."""

    inputs: tuple[str, ...]
    cells: Sequence[str]
    u: ca.MX

    @property
    def names(self) -> list[str]:
        """Of the entries of u."""
        return [f"{cell}{name}" for cell in self.cells for name in self.inputs]

    def start(self, headings: np.ndarray) -> np.ndarray:
        """u at the start: amplitude 1 and headings (K,) rad."""
        usual = {"amplitude": np.ones(len(self.cells)), "heading": headings}
        if not self.inputs:
            return np.zeros(0)
        return np.column_stack([usual[name] for name in self.inputs]).ravel()

    def of(self, name: str, k: int) -> ca.MX | None:
        """The input of cell k, None where it is not one."""
        if name not in self.inputs:
            return None
        return self.u[k * len(self.inputs) + self.inputs.index(name)]

    def amplitude(self, k: int) -> ca.MX:
        """Of cell k."""
        import casadi as ca

        told = self.of("amplitude", k)
        return ca.MX(1.0) if told is None else told

    def pointed(self, k: int, p: ca.MX) -> ca.MX:
        """The polarity (3, 1) that cell k's commands are given for."""
        import casadi as ca

        told = self.of("heading", k)
        return p if told is None else ca.vertcat(ca.cos(told), ca.sin(told), 0)


def commands_of(names: Sequence[str], p: ca.MX, amplitude: ca.MX, force: ca.MX) -> ca.MX:
    """Inputs of the model, by their names, for polarity p and amplitude; all times `force`."""
    import casadi as ca

    parts = [feature_of(name) for name in names]
    waves = heading_features(p, max((q for _, q, _ in parts), default=1) or 1)
    return force * ca.vertcat(
        *(
            amplitude**power
            * (1.0 if kind == "amplitude" else waves[2 * (q - 1) + (kind == "sin")])
            for kind, q, power in parts
        )
    )


def heading_of(p: np.ndarray) -> np.ndarray:
    """Angles (K,) of polarities (K, 3), rad."""
    return np.arctan2(p[:, 1], p[:, 0])
