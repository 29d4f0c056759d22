"""Protrusion force of the leading edge.

    F_i = F (1 - z/h)_+ w(cos angle(e_r, p)) (e_r - c e_z)                   [thesis 4.4]
    F_i = F w(cos angle(e_r, p)) e_r                                         in a gel

e_r is the outward radial direction from the centroid, in the substrate plane or in space where the
sector is a cone, w the smoothstep
from cosine `edge` to cosine `full`: a hard sector edge would itself be a switch
[notes: mechanics, lamellipodium].
"""

from __future__ import annotations

import numpy as np


def smoothstep(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below `low`, 1 above `high`, cubic with zero slope at both ends between."""
    q = np.clip((value - low) / (high - low), 0.0, 1.0)
    return q * q * (3.0 - 2.0 * q)


def node_force(
    away_x: float,
    away_y: float,
    z: float,
    head_x: float,
    head_y: float,
    height: float,
    edge: float,
    full: float,
) -> float:
    """Share (1 - z/h)_+ w(cos) of one node, for plain numbers: `protrusion` without its arrays.

    away: offset from the centroid in the plane, um; head: unit heading.
    """
    distance = np.sqrt(away_x * away_x + away_y * away_y + 1e-12)
    cosine = (away_x * head_x + away_y * head_y) / distance
    q = min(max((cosine - edge) / (full - edge), 0.0), 1.0)
    return q * q * (3.0 - 2.0 * q) * min(max(1.0 - z / height, 0.0), 1.0)


def protrusion(
    x: np.ndarray,
    p: np.ndarray,
    force: float,
    height: float,
    edge: float,
    full: float,
    downward: float,
    axes: int = 2,
) -> np.ndarray:
    """Force on each membrane node (n, 3), pN; of 3 `axes` the push of a cell inside a gel.

    x : (n, 3) um; p : (3,) polarity, projected on the substrate plane (no force when p is
    normal to it); force in pN; height in um; edge, full: cosines; downward: -z part.
    """
    p = np.asarray(p)[:axes]
    heading = float(np.hypot.reduce(p))
    out = np.zeros_like(x)
    if heading == 0.0 or force == 0.0:
        return out
    away = x[:, :axes] - x[:, :axes].mean(axis=0)
    away = away / np.sqrt((away**2).sum(axis=1) + 1e-12)[:, None]
    weight = smoothstep(away @ (p / heading), edge, full)
    weight *= force if axes == 3 else force * np.clip(1.0 - x[:, 2] / height, 0.0, 1.0)
    if axes == 2:
        out[:, 2] = -downward * weight
    out[:, :axes] = weight[:, None] * away
    return out
