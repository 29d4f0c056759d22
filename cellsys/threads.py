"""One thread for linear algebra where many small matrices are looped over.

A second thread there only waits for the first: beside another busy process a study took twice as
long with two threads, and sums over several threads are taken in another order.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    """The BLAS libraries of this process; scipy brings one of its own beside numpy's."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for linear algebra, whatever was set; what was set comes back afterwards.

    The number belongs to the whole process, so only its main thread sets it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    with _libraries().limit(limits=1, user_api="blas"):
        yield
