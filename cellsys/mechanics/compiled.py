"""numba's njit with an on-disk cache where there is a place to write it."""

from __future__ import annotations

from collections.abc import Callable

import numba


def compiled(function: Callable) -> Callable:
    """Compile on first call; keep the machine code on disk, or do without on a read-only system."""
    try:
        return numba.njit(cache=True)(function)
    except RuntimeError:
        # numba finds no writable directory for its cache.
        return numba.njit(function)
