"""Parameters of a bond graph with units: mechanical, electric, hydraulic.

A graph works either in the house's units (``"cell"``: um, pN, s) or in coherent SI (``"si"``).
Strings are converted at the boundary; plain numbers are taken to be in the graph's units.
"""

from __future__ import annotations

import math
import re

import numpy as np

from cellsys.errors import ParameterError, UnitError
from cellsys.units import parse_unit

Dimension = tuple[int, int, int, int]  # exponents of length, force, time, current

_PREFIX = {"": 1.0, "p": 1e-12, "n": 1e-9, "u": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
_SI: dict[str, tuple[float, Dimension]] = {
    prefix + name: (scale, dimension)
    for name, dimension in {
        "V": (1, 1, -1, -1),
        "A": (0, 0, 0, 1),
        "C": (0, 0, 1, 1),
        "ohm": (1, 1, -1, -2),
        "H": (1, 1, 0, -2),
        "F": (-1, -1, 2, 2),
        "Wb": (1, 1, 0, -1),
        "W": (1, 1, -1, 0),
    }.items()
    for prefix, scale in _PREFIX.items()
} | {"kg": (1.0, (-1, 1, 2, 0)), "g": (1e-3, (-1, 1, 2, 0)), "l": (1e-3, (3, 0, 0, 0))}

_EFFORT_FLOW: dict[str, tuple[Dimension, Dimension]] = {
    "translation": ((0, 1, 0, 0), (1, 0, -1, 0)),
    "rotation": ((1, 1, 0, 0), (0, 0, -1, 0)),
    "electric": ((1, 1, -1, -1), (0, 0, 0, 1)),
    "hydraulic": ((-2, 1, 0, 0), (3, 0, -1, 0)),
}
DOMAINS = tuple(_EFFORT_FLOW)
_NAMES = {
    ("translation", "cell"): ("pN", "um/s", "um", "pN s"),
    ("rotation", "cell"): ("pN um", "rad/s", "rad", "pN um s"),
    ("hydraulic", "cell"): ("Pa", "um^3/s", "um^3", "Pa s"),
    ("translation", "si"): ("N", "m/s", "m", "N s"),
    ("rotation", "si"): ("N m", "rad/s", "rad", "N m s"),
    ("electric", "si"): ("V", "A", "C", "Wb"),
    ("hydraulic", "si"): ("Pa", "m^3/s", "m^3", "Pa s"),
}
_TIME: Dimension = (0, 0, 1, 0)
_NUMBER = re.compile(
    r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?:\s*/\s*(\d+\.?\d*))?\s*(.*)$"
)
_FACTOR = re.compile(r"^([A-Za-zµ%]+|1)(?:\^([+-]?\d+))?$")


def _times(*parts: tuple[Dimension, int]) -> Dimension:
    length, force, time, current = (sum(d[i] * k for d, k in parts) for i in range(4))
    return length, force, time, current


def dimension_of(parameter: str, domain: str | None, other: str | None = None) -> Dimension | None:
    """Dimension of an element's parameter in a domain; None where the domain is not known.

    `parameter` is one of effort, flow, resistance, conductance, stiffness, compliance, inertance,
    TF, GY; `other` is the domain of a two-port's second side.
    """
    if domain is None:
        return None
    e, f = _EFFORT_FLOW[domain]
    table = {
        "effort": [(e, 1)],
        "flow": [(f, 1)],
        "resistance": [(e, 1), (f, -1)],
        "conductance": [(f, 1), (e, -1)],
        "stiffness": [(e, 1), (f, -1), (_TIME, -1)],
        "compliance": [(f, 1), (_TIME, 1), (e, -1)],
        "inertance": [(e, 1), (_TIME, 1), (f, -1)],
    }
    if parameter in table:
        return _times(*table[parameter])
    if other is None:
        return None
    far = _EFFORT_FLOW[other]
    return _times((e, 1), (far[0], -1)) if parameter == "TF" else _times((e, 1), (far[1], -1))


def state_units(domain: str | None, units: str) -> tuple[str, str, str, str]:
    """Units of effort, flow, displacement and momentum; ``"1"`` where the domain is not known."""
    return _NAMES.get((domain or "", units), ("1", "1", "1", "1"))


def _unit(text: str) -> tuple[float, Dimension]:
    """Factor to SI and dimension of a unit."""
    total: Dimension = (0, 0, 0, 0)
    factor, sign = 1.0, 1
    for token in re.split(r"\s*([*/])\s*|\s+", text.strip()):
        if token in (None, "", "*"):
            continue
        if token == "/":
            sign = -1
            continue
        match = _FACTOR.match(token)
        power = sign * int(match[2] or 1) if match else sign
        if match and match[1] in _SI:
            scale, dimension = _SI[match[1]]
        else:
            scale, exponents = parse_unit(match[1] if match else token)
            if any(exponents[4:]):
                raise UnitError(f"{token!r} is a temperature, which bond graphs here do not carry")
            length, force, time = (int(e) for e in exponents[:3])
            dimension = (length, force, time, 0)
            scale *= 1e-6 ** dimension[0] * 1e-12 ** dimension[1]
        factor *= scale**power
        total = _times((total, 1), (dimension, power))
        sign = 1
    return factor, total


def read(value: object, expected: Dimension | None, units: str, name: str) -> float | np.ndarray:
    """A parameter as a finite float or array in the graph's units.

    Parameters
    ----------
    value : float, array or str
        A number in the graph's units, or a quantity such as ``"0.5 mH"``.
    expected : tuple or None
        Exponents of (length, force, time, current) to compare with; None: not compared.
    units : {"cell", "si"}
        The graph's units.
    name : str
        For the message.

    Raises
    ------
    UnitError
        Unknown unit, wrong dimension, or an electric unit in a graph in cell units.
    ParameterError
        Not a finite number.
    """
    if not isinstance(value, str):
        try:
            array = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise ParameterError(f"{name} must be a number or a quantity, got {value!r}") from None
        if not np.all(np.isfinite(array)):
            raise ParameterError(f"{name} must be finite, got {value!r}")
        return float(array) if array.ndim == 0 else array
    match = _NUMBER.match(value)
    if match is None:
        raise UnitError(f"{name} = {value!r} is not a number with a unit such as '1 N'")
    number = float(match[1]) / float(match[2] or 1.0)
    factor, dimension = _unit(match[3])
    if expected is not None and dimension != expected:
        raise UnitError(
            f"{name} = {value!r} has the wrong dimension: exponents of (length, force, time, "
            f"current) are {dimension}, expected {expected}"
        )
    if units == "cell":
        if dimension[3]:
            raise UnitError(f"{name} = {value!r} is electric; build the graph with units='si'")
        factor *= 1e6 ** dimension[0] * 1e12 ** dimension[1]
    number *= factor
    if not math.isfinite(number):
        raise ParameterError(f"{name} must be finite, got {value!r}")
    return number
