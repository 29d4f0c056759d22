"""One set of elementwise operations for numpy arrays and CasADi symbols."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    import casadi

Values = TypeVar("Values", float, np.ndarray)  # of an elementwise law
Vector = TypeVar("Vector", np.ndarray, "casadi.SX", "casadi.MX")  # of a law that takes symbols too


def is_symbolic(*values: object) -> bool:
    """True when any value is a CasADi expression; CasADi is not imported to find out."""
    return any(type(v).__module__.startswith("casadi") for v in values)


def operations(*values: object) -> SimpleNamespace:
    """Namespace with dot, cross, sqrt, exp, sin, cos, atan2, tanh, maximum, where, concatenate."""
    if not is_symbolic(*values):
        return _NUMPY
    import casadi as ca

    return SimpleNamespace(
        dot=ca.dot,
        cross=ca.cross,
        sqrt=ca.sqrt,
        exp=ca.exp,
        sin=ca.sin,
        cos=ca.cos,
        atan2=ca.atan2,
        tanh=ca.tanh,
        maximum=ca.fmax,
        minimum=ca.fmin,
        where=ca.if_else,
        concatenate=lambda parts: ca.vertcat(*parts),
    )


_NUMPY = SimpleNamespace(
    dot=lambda a, b: float(np.dot(a, b)),
    cross=np.cross,
    sqrt=np.sqrt,
    exp=np.exp,
    sin=np.sin,
    cos=np.cos,
    atan2=np.arctan2,
    tanh=np.tanh,
    maximum=np.maximum,
    minimum=np.minimum,
    where=np.where,
    concatenate=lambda parts: np.concatenate([np.atleast_1d(p) for p in parts]),
)
