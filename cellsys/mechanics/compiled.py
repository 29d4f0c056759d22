"""numba's njit with an on-disk cache where there is a place to write it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numba


def compiled(function: Callable | None = None, *, reassociate: bool = False) -> Any:
    """Compile on first call; keep the machine code on disk, or do without on a read-only system.

    `reassociate` lets sums be formed in the order that suits vector units (and products be fused
    into them); NaN and inf keep their meaning.
    """
    if function is None:
        return partial(compiled, reassociate=reassociate)
    fastmath = {"reassoc", "contract", "nsz"} if reassociate else False
    try:
        return numba.njit(cache=True, fastmath=fastmath)(function)
    except RuntimeError:
        # numba finds no writable directory for its cache.
        return numba.njit(fastmath=fastmath)(function)
