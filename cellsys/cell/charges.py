"""Charges: how coefficients turn when a cell and its heading are turned about the normal.

A vector field on circles is written with W = X + iY and Z, each a sum over e^{i m phi}. Turned by
alpha, Z_m becomes Z_m e^{-i m alpha} and W_m becomes W_m e^{i (1 - m) alpha}; the quantities

    Z_{-q},   W_{1-q},   conj W_{1+q}                                        charge q >= 0

all turn by e^{i q alpha}. A mirror image conjugates them, so a linear law that respects both
symmetries is block diagonal in q with real matrices
[notes: theory, equivariant cell]. Charge 0 is real: its
mirror-odd part (swirl) is zero for an isolated cell and is not carried.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

TOP = 5  # highest charge carried
N_FEATURES = 3  # of the commands, per charge


def pack(W: Mapping[int, np.ndarray], Z: Mapping[int, np.ndarray], q: int) -> np.ndarray:
    """Coefficients of charge q, last axis: parts Z_{-q}, W_{1-q}, conj W_{1+q}.

    W[m] and Z[m] are (..., n_m); orders that are not there are left out. The weights make
    sum over q of |packed|^2 the squared norm of the field (orders within reach).
    """
    parts = []
    if -q in Z:
        # Z_q and Z_{-q} are conjugate; one stands for both.
        parts.append(Z[-q] * (1.0 if q == 0 else np.sqrt(2.0)))
    if 1 - q in W:
        parts.append(W[1 - q])
    if q > 0 and 1 + q in W:
        parts.append(np.conj(W[1 + q]))
    if not parts:
        raise ValueError(f"no coefficients of charge {q}")
    packed = np.concatenate(parts, axis=-1)
    return packed.real if q == 0 else packed


def unpack(
    packed: Mapping[int, np.ndarray], sizes_W: Mapping[int, int], sizes_Z: Mapping[int, int]
) -> tuple[dict[int, np.ndarray], dict[int, np.ndarray]]:
    """Inverse of `pack` over all charges; orders that no charge holds are zero."""
    shape = next(iter(packed.values())).shape[:-1]
    W = {m: np.zeros((*shape, n), complex) for m, n in sizes_W.items()}
    Z = {m: np.zeros((*shape, n), complex) for m, n in sizes_Z.items()}
    for q, values in packed.items():
        start = 0

        def take(n: int, values: np.ndarray = values) -> np.ndarray:
            nonlocal start
            start += n
            return values[..., start - n : start]

        if -q in Z:
            part = take(sizes_Z[-q]) / (1.0 if q == 0 else np.sqrt(2.0))
            Z[-q] = part.astype(complex)
        if 1 - q in W:
            W[1 - q] = take(sizes_W[1 - q]).astype(complex)
        if q > 0 and 1 + q in W:
            W[1 + q] = np.conj(take(sizes_W[1 + q]))
    return W, Z


def turn(values: np.ndarray, q: int, alpha: float | np.ndarray) -> np.ndarray:
    """Coefficients of charge q after a rotation by alpha."""
    return values * np.exp(1j * q * alpha) if q else values


def command_features(amplitude: np.ndarray, heading: np.ndarray, q: int) -> np.ndarray:
    """[1, a - 1, (a - 1)^2] e^{i q theta}, (..., 3); real for charge 0.

    The square is needed: a motor clutch slips, so a cell does not answer to the amplitude in
    proportion (without it the centroid's error is 1.6 times as large).
    """
    more = np.asarray(amplitude) - 1.0
    powers = np.stack([np.ones_like(more), more, more * more], axis=-1)
    return powers if q == 0 else powers * np.exp(1j * q * np.asarray(heading))[..., None]


def harmonic_names(cell: str) -> tuple[str, ...]:
    """Inputs of the frozen plant: a, a^2, then (cos, sin) of q theta plain, times a, times a^2."""
    names = [f"{cell}.amplitude", f"{cell}.amplitude_squared"]
    for q in range(1, TOP + 1):
        suffix = "" if q == 1 else str(q)
        for weight in ("unit_", "", "squared_"):
            names += [f"{cell}.{weight}cos{suffix}", f"{cell}.{weight}sin{suffix}"]
    return tuple(names)
