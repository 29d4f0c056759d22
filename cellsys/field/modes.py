"""Field modes: POD of the matrix's own responses to loads at random places.

Loads are smooth patches as a cell exerts them: radial hats times azimuthal orders around a place,
each with a radial, a tangential and a vertical part, random coefficients. Responses are those of
the *nonlinear* matrix: modes of the linear one cannot follow the way load paths move when fibres
buckle (`analysis/field_truth.py` prints both; projection floors are nearly the same)
[notes: measurements, field modes].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from cellsys.errors import DataError, DimensionError, RankError, SceneError
from cellsys.field.elasticity import MatrixEnergy
from cellsys.geometry.disc import Disc
from cellsys.trajectory import Trajectory

MatrixRuns = np.ndarray | Trajectory | Sequence[np.ndarray | Trajectory]
_PATCH = 14.0  # um: reach of a load patch, that of a spread cell
_HAT = 2.0  # um between the radial hats
_ORDERS = 4  # azimuthal orders 0 .. 4
_WITHIN = 0.8  # of the radius: cells bind no further out than 0.9
_LARGEST = (0.1, 1.0)  # um: greatest displacement of a response, as cells cause
_SWEEPS = 6  # modified Newton sweeps of a response; 3 % of the load is left


def symmetric_factor(matrix: sp.csc_array) -> spla.SuperLU:
    """Sparse LU of a symmetric positive definite matrix; ``.solve`` takes (n,) or (n, k)."""
    return spla.splu(
        sp.csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def patch_loads(
    matrix: MatrixEnergy, places: int, per_place: int, rng: np.random.Generator
) -> np.ndarray:
    """Random smooth surface loads (places * per_place, n, 3), pN, of unit Euclidean norm."""
    disc = matrix.disc
    if not isinstance(disc, Disc):
        raise SceneError(
            "patches of load lie on the top of a disc, and this matrix is around its cells; give "
            "GalerkinField the modes= of runs in it"
        )
    on = disc.surface
    xy = disc.position[on, :2]
    hats = int(_PATCH / _HAT) + 1
    order = np.arange(_ORDERS + 1)
    loads = np.zeros((places * per_place, matrix.n, 3))
    k = 0
    for _ in range(places):
        r, phi = _WITHIN * disc.radius * np.sqrt(rng.uniform()), rng.uniform(0.0, 2.0 * np.pi)
        away = xy - r * np.array([np.cos(phi), np.sin(phi)])
        far, angle = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
        radial = np.clip(1.0 - np.abs(far / _HAT - np.arange(hats)[:, None]), 0.0, None)
        around = np.concatenate([np.cos(order[:, None] * angle), np.sin(order[:, None] * angle)])
        fade = 1.0 / (1.0 + np.tile(order, 2))
        for _ in range(per_place):
            c = rng.standard_normal((3, hats, len(fade))) * fade
            along, across, up = np.einsum("chm,hn,mn->cn", c, radial, around)
            f = loads[k]
            f[on, 0] = along * np.cos(angle) - across * np.sin(angle)
            f[on, 1] = along * np.sin(angle) + across * np.cos(angle)
            f[on, 2] = up
            size = np.linalg.norm(f)
            if size > 0:
                f /= size
            k += 1
    return loads


def responses(
    matrix: MatrixEnergy, loads: np.ndarray, linear: bool, rng: np.random.Generator, slope: float
) -> np.ndarray:
    """Static responses (k, n_free) of the matrix to loads (k, n, 3), per unit of load.

    Each load is scaled so that its linear response has a greatest displacement drawn from 0.1 to
    1 um; the nonlinear response is approached by modified Newton sweeps with one factorisation
    (every fibre at `slope`) and divided by the scale again.
    """
    free = matrix.free
    rest = np.zeros((matrix.n, 3))
    f = loads.reshape(len(loads), -1)[:, free]
    u = symmetric_factor(matrix.tangent(rest)[free][:, free]).solve(f.T).T
    if linear:
        return u
    size = np.abs(u).max(axis=1)
    scale = rng.uniform(*_LARGEST, len(u)) / np.where(size > 0, size, 1.0)
    u = scale[:, None] * u
    factor = symmetric_factor(matrix.tangent(rest, slope)[free][:, free])
    full = np.zeros(3 * matrix.n)
    left = np.empty_like(u)
    for _ in range(_SWEEPS):
        for k in range(len(u)):
            full[free] = u[k]
            left[k] = matrix.force(full.reshape(-1, 3)).ravel()[free] + scale[k] * f[k]
        u = u + factor.solve(left.T).T
    return u / scale[:, None]


def displacements(matrix: MatrixEnergy, snapshots: MatrixRuns) -> np.ndarray:
    """Free displacements (k, n_free) of runs or of an array (k, n, 3) or (k, 3 n), um."""
    items: Sequence[np.ndarray | Trajectory] = (
        snapshots if isinstance(snapshots, (list, tuple)) else (snapshots,)
    )
    rows = []
    for item in items:
        if isinstance(item, Trajectory):
            array = np.asarray(item.block("matrix.displacement"), dtype=float)
        else:
            array = np.asarray(item, dtype=float)
        array = array.reshape(len(array), -1) if array.ndim > 1 else array[None]
        if array.shape[1] != 3 * matrix.n:
            raise DimensionError(
                f"snapshots must hold {matrix.n} nodes x 3 (um), got rows of {array.shape[1]}"
            )
        if not np.all(np.isfinite(array)):
            raise DataError("snapshots hold NaN or inf")
        rows.append(array[:, matrix.free])
    return np.concatenate(rows)


def response_modes(
    matrix: MatrixEnergy,
    order: int,
    *,
    linear: bool,
    seed: int,
    snapshots: MatrixRuns | None,
    places: int,
    per_place: int,
    slope: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Modes (n_free, order), orthonormal, and their singular values (order,).

    POD of the responses to ``places * per_place`` random loads and, where given, of snapshots,
    both parts with the same total weight. The first columns of a larger order are the modes of a
    smaller one.

    Raises
    ------
    RankError
        More modes asked for than responses, or than free displacements.
    """
    rng = np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(202,)))
    loads = patch_loads(matrix, places, per_place, rng)
    parts = [responses(matrix, loads, linear, rng, slope)]
    if snapshots is not None:
        parts.append(displacements(matrix, snapshots))
    rows = np.concatenate([p / max(np.linalg.norm(p), 1e-300) for p in parts])
    most = min(rows.shape)
    if order > most:
        raise RankError(
            f"order = {order} modes are asked for and {len(rows)} responses of {rows.shape[1]} "
            f"free displacements span at most {most}; take a lower order or more places"
        )
    left, s, _ = sla.svd(rows.T, full_matrices=False)
    return left[:, :order], s[:order]
