"""One thread each for linear algebra: the tests run in two processes on two cores.

The libraries read the environment when they are loaded, which is after this file.
"""

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
