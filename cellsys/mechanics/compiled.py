"""numba's njit with an on-disk cache where there is a place to write it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numba


def compiled(function: Callable | None = None, *, vector: bool = False) -> Any:
    """Compile on first call; keep the machine code on disk, or do without on a read-only system.

    `vector` lets loops use the vector units: sums in any order, products fused into them, and a
    division by zero that gives inf, as in numpy, instead of an exception.
    """
    if function is None:
        return partial(compiled, vector=vector)
    options: dict[str, Any] = {}
    if vector:
        options = {"fastmath": {"reassoc", "contract", "nsz"}, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:
        # numba finds no writable directory for its cache.
        return numba.njit(**options)(function)
