"""What basis, fit and roll-out cost, in time and memory.

    python analysis/reduction_cost.py [--quick]

Prints: basis and fit on 8 runs x 301 samples, the same streamed from disk on 8 x 3001 samples of
19 701 columns, a latent roll-out of 3000 s at m = 100, each after a warm-up where it is short.
"""

import argparse
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import scipy.sparse as sp

import cellsys as cs
from cellsys.reduction import fit_basis

N_X, N_ETA = 6567, 13134


def synthetic(folder: Path, runs: int, samples: int) -> cs.Snapshots:
    """Smooth random runs written to disk and memory-mapped; 19 701 columns, rank 200."""
    rng = np.random.default_rng(0)
    modes = rng.standard_normal((200, N_X + N_ETA)) * np.geomspace(1, 1e-4, 200)[:, None]
    data = []
    for i in range(runs):
        phase, rate = rng.uniform(0, 2 * np.pi, 200), rng.uniform(1e-3, 5e-2, 200)
        arrays = {}
        for name, width in (("x", N_X), ("eta", N_ETA)):
            path = folder / f"{name}{i}.npy"
            array = np.lib.format.open_memmap(path, mode="w+", dtype=float, shape=(samples, width))
            part = modes[:, :N_X] if name == "x" else modes[:, N_X:]
            for k in range(0, samples, 256):
                t = np.arange(k, min(k + 256, samples))[:, None]
                array[k : k + 256] = np.cos(rate * t + phase) @ part
            array.flush()
            arrays[name] = np.load(path, mmap_mode="r")
        data.append(cs.RunData(x=arrays["x"], eta=arrays["eta"][:-1]))
    return cs.Snapshots(
        runs=tuple(data),
        states=cs.Layout([cs.Block("x", (N_X,))]),
        auxiliaries=cs.Layout([cs.Block("eta", (N_ETA,), "1", role="component", kind="rate")]),
        dt=1.0,
        W_x=sp.csr_array((N_X, N_X)),
        W_eta=sp.csr_array(sp.hstack([sp.eye_array(N_X), sp.eye_array(N_X)])),
    )


def measure(samples: int, order: int) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        data = synthetic(Path(scratch), 8, samples)
        began = time.perf_counter()
        basis = fit_basis(data, order)
        middle = time.perf_counter()
        cs.PCR().fit(data, order, basis=basis)
        end = time.perf_counter()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(
        f"8 runs x {samples} samples x {N_X + N_ETA} columns, m = {order}: basis "
        f"{middle - began:.1f} s, fit {end - middle:.1f} s, peak memory so far {peak:.2f} GB"
    )


def main(quick: bool = False) -> None:
    order = 20 if quick else 100
    measure(61 if quick else 301, order)
    if not quick:
        measure(3001, order)
    rng = np.random.default_rng(1)
    A = -np.diag(np.geomspace(1e-4, 0.5, 100)) + 1e-3 * rng.standard_normal((100, 100))
    model = cs.LatentModel(A=A, B=rng.standard_normal((100, 4)), dt=1.0)
    t, u = np.arange(3001.0), rng.standard_normal((3000, 4))
    model.predict(np.ones(100), u, t)
    times = []
    for _ in range(5):
        began = time.perf_counter()
        model.predict(np.ones(100), u, t)
        times.append(time.perf_counter() - began)
    print(f"latent roll-out, m = 100, 3000 steps of 1 s: {1e3 * min(times):.1f} ms")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
