"""Units: um, pN, s inside; strings with units at the boundary only; arrays of plain numbers.

In these units 1 Pa = 1 pN/um^2 and 1 N s/m = 1e6 pN s/um. Angles are radians inside.
`quantity("5 kPa", "pN/um^2")` gives 5000.0; a number without a unit, an unknown unit and a unit
of another dimension are refused.
"""

from __future__ import annotations

import difflib
import math
import re
from fractions import Fraction
from typing import Annotated

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError, UnitError
from cellsys.kinds import Takes, shown

# Exponents of length, force, time, angle, temperature.
Dimension = tuple[Fraction, Fraction, Fraction, Fraction, Fraction]


def _dim(
    length: int = 0, force: int = 0, time: int = 0, angle: int = 0, temperature: int = 0
) -> Dimension:
    return tuple(Fraction(n) for n in (length, force, time, angle, temperature))  # type: ignore[return-value]


_BASE: dict[str, tuple[float, Dimension]] = {
    "1": (1.0, _dim()),
    "%": (0.01, _dim()),
    "m": (1e6, _dim(length=1)),
    "N": (1e12, _dim(force=1)),
    "Pa": (1.0, _dim(force=1, length=-2)),
    "J": (1e18, _dim(force=1, length=1)),
    "s": (1.0, _dim(time=1)),
    "min": (60.0, _dim(time=1)),
    "h": (3600.0, _dim(time=1)),
    "Hz": (1.0, _dim(time=-1)),
    "rad": (1.0, _dim(angle=1)),
    "deg": (math.pi / 180.0, _dim(angle=1)),
    "K": (1.0, _dim(temperature=1)),
}
_PREFIX = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6}
_PREFIXED = ("m", "N", "Pa", "J", "s")
UNITS: dict[str, tuple[float, Dimension]] = dict(_BASE) | {
    prefix + name: (scale * _BASE[name][0], _BASE[name][1])
    for name in _PREFIXED
    for prefix, scale in _PREFIX.items()
}

_LONGEST = 200  # characters of a quantity: no number and unit need more
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_VALUE = re.compile(rf"^\s*({_NUMBER})\s*(?:/\s*({_NUMBER}))?(?:\s+(.*))?$")
_FACTOR = re.compile(r"^([A-Za-zµ%]+|1)(?:\^([+-]?\d))?$")


def same_mu(text: str) -> str:
    """The text with the micro sign wherever it has the Greek letter that looks like it."""
    return text.replace("\u03bc", "\u00b5")


def parse_unit(text: str) -> tuple[float, Dimension]:
    """Factor to internal units, and dimension, of a unit such as ``"pN s/um"`` or ``"1/s"``.

    A space or ``*`` multiplies; every ``/`` divides by the one factor that follows it.

    Raises
    ------
    UnitError
        When a factor is not a known unit; the nearest known one is offered.
    """
    factor, exponents = 1.0, list(_dim())
    if len(text) > _LONGEST:
        raise UnitError(f"a unit of {len(text)} characters; at most {_LONGEST} are read")
    text = same_mu(text)
    tokens = re.split(r"\s*([*/])\s*|\s+", text.strip())
    sign = 1
    for token in tokens:
        if token is None or token in ("", "*"):
            continue
        if token == "/":
            sign = -1
            continue
        match = _FACTOR.match(token)
        if match is None or match[1] not in UNITS:
            near = difflib.get_close_matches(match[1] if match else token, UNITS, 1, 0.4)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise UnitError(f"unknown unit {token!r} in {text!r}{hint}")
        power = sign * int(match[2] or 1)
        scale, dimension = UNITS[match[1]]
        factor *= scale**power
        exponents = [a + power * b for a, b in zip(exponents, dimension, strict=True)]
        sign = 1
    return factor, tuple(exponents)  # type: ignore[return-value]


def real_array(value: object, name: str) -> np.ndarray:
    """`value` as an array of floats; NaN and inf are left to the caller.

    Raises
    ------
    DataError
        Complex numbers, texts, objects, or rows of different lengths.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind == "c":
            raise DataError(f"{name} is complex; it must be made of real numbers")
        if array.dtype.kind in "SUMm":
            raise DataError(f"{name} holds {array.dtype.name}; it must be made of real numbers")
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{name} must be an array of real numbers: {error}") from error


def complex_array(value: object, name: str) -> np.ndarray:
    """`value` as an array of complex numbers; DataError for texts, objects and the like."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biufc":
            raise DataError(f"{name} holds {array.dtype.name}; it must be made of complex numbers")
        return np.asarray(array, dtype=complex)
    except (TypeError, ValueError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{name} must be an array of complex numbers: {error}") from error


def real_number(value: object, name: str) -> float:
    """`value` as a finite float.

    Raises
    ------
    ParameterError
    """
    if isinstance(value, (int, float, np.number, np.ndarray)) and np.ndim(value) == 0:
        array = np.asarray(value)
        if array.dtype.kind in "iufb" and math.isfinite(array):
            return float(array)
    raise ParameterError(f"{name} must be a finite real number, got {shown(value)}")


def shaped_array(value: object, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """`value` as a finite array of floats of a shape; None stands for any length.

    Raises
    ------
    DimensionError, DataError
        Another shape; NaN, inf, or what `real_array` refuses.
    """
    array = real_array(value, name)
    fits = array.ndim == len(shape) and all(
        n in (None, m) for n, m in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise DimensionError(f"{name} must have shape ({wanted}), got {array.shape}")
    if not np.all(np.isfinite(array)):
        bad = np.argwhere(~np.isfinite(array))[0].tolist()
        raise DataError(f"{name}{bad} is {array[tuple(bad)]}, not finite")
    return array


@checked
def quantity(
    value: Annotated[str | float, Takes(object)], unit: str, *, name: str = "value"
) -> float:
    """Convert a quantity to a float in `unit`'s internal form.

    Parameters
    ----------
    value : str or float
        ``"5 kPa"``, ``"1/60 1/s"``; a bare number is accepted only where `unit` is ``"1"``.
    unit : str
        A unit of the expected dimension, e.g. ``"pN/um^2"``.
    name : str
        What the value is, for the message.

    Raises
    ------
    UnitError
        Missing or unknown unit, other dimension, not a number, or not finite.
    """
    scale, expected = parse_unit(unit)
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise UnitError(f"{name} must be a quantity such as '1 {unit}', got {shown(value)}")
    if isinstance(value, str):
        if len(value) > _LONGEST:
            raise UnitError(
                f"{name} = {shown(value)} has {len(value)} characters; write a quantity such as "
                f"'1 {unit}' with at most {_LONGEST}"
            )
        match = _VALUE.match(value)
        if match is None:
            raise UnitError(f"{name} = {value!r} is not a number with a unit such as '1 {unit}'")
        number = float(match[1])
        if match[2] is not None:
            if float(match[2]) == 0.0:
                raise UnitError(f"{name} = {value!r} divides by zero")
            number /= float(match[2])
        text = (match[3] or "").strip()
    else:
        try:
            number, text = float(value), ""
        except OverflowError as error:
            raise UnitError(f"{name} is {shown(value)}, beyond 1e308") from error
    if not math.isfinite(number):
        raise UnitError(f"{name} must be finite, got {value!r}")
    if not text:
        if expected != _dim():
            raise UnitError(f"{name} = {value!r} has no unit; write for example '{value} {unit}'")
        return number
    factor, dimension = parse_unit(text)
    if dimension != expected:
        raise UnitError(
            f"{name} = {value!r} has the wrong dimension; expected a unit like {unit!r}"
        )
    del scale
    if not math.isfinite(number * factor):
        raise UnitError(f"{name} = {value!r} is beyond 1e308 in the units used inside")
    return number * factor
