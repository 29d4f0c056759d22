"""numba's njit with an on-disk cache where there is a place to write it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numba


def compiled(
    function: Callable | None = None, *, vector: bool = False, inline: bool = False
) -> Any:
    """Compile on first call; keep the machine code on disk, or do without on a read-only system.

    `vector` lets loops use the vector units: sums in any order, products fused into them, and a
    division by zero that gives inf, as in numpy, instead of an exception. `inline` puts a law into
    the loop that calls it: a cached function is otherwise called, and the loop not vectorised.
    """
    if function is None:
        return partial(compiled, vector=vector, inline=inline)
    options: dict[str, Any] = {"inline": "always"} if inline else {}
    if vector:
        options |= {"fastmath": {"reassoc", "contract", "nsz"}, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:
        # numba finds no writable directory for its cache.
        return numba.njit(**options)(function)
