"""Does a basis of snapshots larger than memory come in time, and how exact is it?

    python analysis/reduction_scale.py [--quick] [--folder DIR]

Writes 60 000 x 19 701 snapshots (9.5 GB, deleted afterwards) whose singular vectors are known by
construction and whose singular values fall like those of a cell (s_i = i^-1.4, s_1/s_100 = 631),
streams 100 modes out of them, and prints time, peak memory, error bounds and the true angles.
"""

import argparse
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

import cellsys as cs

N_X, N_ETA, RANK = 6567, 13134, 400


def write(path: Path, rows: int, width: int, block: int, rows_of) -> np.ndarray:
    """A .npy file written block by block, never whole in memory; read back memory-mapped."""
    with path.open("wb") as file:
        header = {"descr": "<f8", "fortran_order": False, "shape": (rows, width)}
        np.lib.format.write_array_header_1_0(file, header)
        for k in range(0, rows, block):
            np.ascontiguousarray(rows_of(k, min(k + block, rows))).tofile(file)
    return np.load(path, mmap_mode="r")


def synthetic(folder: Path, runs: int, pairs: int) -> tuple[cs.Snapshots, np.ndarray]:
    """Runs on disk, and the exact right singular vectors of their centred samples."""
    rng, total = np.random.default_rng(0), runs * pairs
    left = rng.standard_normal((total, min(RANK, total - 1)))
    left = sla.qr(left - left.mean(axis=0), mode="economic", overwrite_a=True)[0]
    right = sla.qr(rng.standard_normal((N_X + N_ETA, left.shape[1])), mode="economic")[0]
    weights = 1e3 * np.arange(1.0, left.shape[1] + 1) ** -1.4 * np.sqrt(total)
    mean, data = 10.0 * rng.standard_normal(N_X + N_ETA), []
    for i in range(runs):
        # two more samples than pairs: the last ones have no successor and are not used
        rows = np.zeros((pairs + 2, left.shape[1]))
        rows[:pairs] = left[i * pairs : (i + 1) * pairs] * weights
        parts = []
        for name, columns, count in (
            ("x", slice(0, N_X), pairs + 2),
            ("eta", slice(N_X, None), pairs + 1),
        ):
            side, centre = np.ascontiguousarray(right[columns].T), mean[columns]

            def rows_of(k, stop, rows=rows, side=side, centre=centre):
                return rows[k:stop] @ side + centre

            width = side.shape[1]
            parts.append(write(folder / f"{name}{i}.npy", count, width, 512, rows_of))
        data.append(cs.RunData(x=parts[0], eta=parts[1], label=f"run {i}"))
    snapshots = cs.Snapshots(
        runs=tuple(data),
        states=cs.Layout([cs.Block("x", (N_X,))]),
        auxiliaries=cs.Layout([cs.Block("eta", (N_ETA,), "1", role="component", kind="rate")]),
        dt=1.0,
        W_x=sp.csr_array((N_X, N_X)),
        W_eta=sp.csr_array((N_X, N_ETA)),
        scale="none",
    )
    return snapshots, right


def main(quick: bool = False, folder: str | None = None) -> None:
    runs, pairs, order = (4, 150, 30) if quick else (8, 7500, 100)
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        data, exact = synthetic(Path(scratch), runs, pairs)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        began, worked = time.perf_counter(), time.process_time()
        basis = cs.fit_basis(data, order, method=cs.RandomisedSVD())
        took, worked = time.perf_counter() - began, time.process_time() - worked
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    size = 8e-9 * data.n_samples * data.n_columns
    print(f"{data.n_samples} x {data.n_columns} snapshots, {size:.2f} GB on disk, {order} modes")
    print(
        f"basis {took:.1f} s ({worked:.1f} s of processor time); peak memory {peak:.2f} GB "
        f"({before:.2f} GB before it began)"
    )
    print(f"share of the norm left out (exact): {basis.left_out:.3e}")
    print(f"largest bound on the error of a singular value: {basis.residuals.max():.1e}")
    for count in (5, 10, 20):
        angle = sla.subspace_angles(basis.V[:, :count], exact[:, :count])[0]
        print(
            f"first {count:2d} directions: sine of the largest angle {np.sin(angle):.1e}, "
            f"bound {basis.angle_bound(count):.1e}"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--folder")
    arguments = parser.parse_args()
    main(arguments.quick, arguments.folder)
