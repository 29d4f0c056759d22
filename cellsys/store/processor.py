"""Which kind of processor and linear algebra the numbers of a run come from.

Sums are taken in the order in which the vector units take them: compiled loops and the BLAS are
chosen by the processor, and two kinds differ in the last digits. A run is repeated bit for bit on
one kind only.
"""

from __future__ import annotations

import os
import platform
from functools import cache

import scipy.linalg  # noqa: F401  (its BLAS is loaded with it, and is asked below)
from llvmlite import binding
from threadpoolctl import threadpool_info

# Of the instruction sets, those that change how sums are taken.
_VECTORS = ("sse4.2", "avx", "avx2", "avx512f", "fma", "neon", "sve", "vsx", "vector")


@cache
def processor_kind() -> str:
    """Processor as the compiler sees it, its vector units, and the BLAS with its kernels.

    For example ``x86_64 cascadelake avx2+avx512f+fma, openblas SkylakeX``. Part of the key of the
    run cache.
    """
    name = os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name()
    features = os.environ.get("NUMBA_CPU_FEATURES")
    if features is None:
        has = binding.get_host_cpu_features()
        features = "+".join(v for v in _VECTORS if has.get(v, False))
    libraries = {
        f"{info['internal_api']} {info.get('architecture', 'of one kernel')}"
        for info in threadpool_info()
        if info["user_api"] == "blas"
    }
    return f"{platform.machine()} {name} {features}, {' and '.join(sorted(libraries)) or 'no BLAS'}"
