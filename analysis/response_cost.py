"""What a frequency response costs here and elsewhere, at equal accuracy; and what stability costs.

    python analysis/response_cost.py [--quick]

Every row is one system: 1000 frequencies, time of each tool divided by ours. Tools slower than 1 s
are timed on some 20 points (200 where these are quick) and scaled to 1000, marked ~; what they do
once is timed once. The error is the largest relative one at five frequencies against solutions
refined in extended precision. Equal accuracy: a tool whose error is above 1e-12 and 100 times ours
is marked !! and does not count. Caches are off; the least of several times is taken. Ours is timed
from the `control.StateSpace` to the array, once without and once with the error bound per
frequency. All tools run on one BLAS thread, unless OMP_NUM_THREADS says otherwise: on a machine
that does other work as well, threads wait for each other and ratios mean nothing.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")  # read when numpy loads its BLAS

import control as ct
import numpy as np
import scipy.linalg as sla
import scipy.signal

import cellsys.response as response

SIZES = (50, 200, 500, 1000, 2000)
POINTS, SAMPLE, SECONDS = 1000, 20, 10.0
WRONG, FACTOR = 1e-12, 100.0


class _Plain(ct.StateSpace):
    """A StateSpace that behaves as if slycot were not installed."""

    def slycot_laub(self, x: np.ndarray) -> np.ndarray:
        raise ImportError("slycot left out on purpose")


def system(n: int, m: int, p: int) -> tuple[np.ndarray, ...]:
    """Gaussian A with spectrum in a disc of radius 1 around -1.1: n modes, some sharp."""
    rng = np.random.default_rng(n)
    A = rng.standard_normal((n, n)) / np.sqrt(n) - 1.1 * np.eye(n)
    return A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), np.zeros((p, m))


def reference(A: np.ndarray, B: np.ndarray, C: np.ndarray, s: complex) -> np.ndarray:
    """C (s I - A)^-1 B with two refinements in extended precision."""
    M = s * np.eye(len(A)) - A
    lu = sla.lu_factor(M)
    X = sla.lu_solve(lu, B.astype(complex)).astype(np.clongdouble)
    long = M.astype(np.clongdouble)
    for _ in range(2):
        X = X + sla.lu_solve(lu, (B - long @ X).astype(complex))
    return (C @ X).astype(complex)


def peers(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> dict[str, Callable]:
    """Name -> function of omega (k,) that gives (p, m, k)."""
    found: dict[str, Callable] = {}
    plain = _Plain(A, B, C, D, 0)
    found["control"] = lambda w: plain.horner(1j * w)
    try:
        import slycot  # noqa: F401
    except ImportError:
        print("slycot is not installed: left out")
    else:
        found["control+slycot"] = lambda w: ct.ss(A, B, C, D, 0).slycot_laub(1j * w)
    try:
        from pymor.core.cache import disable_caching
        from pymor.core.logger import set_log_levels
        from pymor.models.iosys import LTIModel
    except ImportError:
        print("pyMOR is not installed: left out")
    else:
        set_log_levels({"pymor": "ERROR"})
        disable_caching()

        def shifted_solves(w: np.ndarray) -> np.ndarray:
            transfer = LTIModel.from_matrices(A, B, C, D).transfer_function
            return np.moveaxis(np.array([transfer.eval_tf(1j * x) for x in w]), 0, -1)

        found["pyMOR"] = shifted_solves
    eye = np.eye(len(A))
    found["scipy solve"] = lambda w: np.stack(
        [C @ sla.solve(1j * x * eye - A, B) + D for x in w], axis=-1
    )
    if B.shape[1] == C.shape[0] == 1 and len(A) <= 500:
        found["scipy.signal"] = lambda w: scipy.signal.freqresp(
            scipy.signal.StateSpace(A, B, C, D), w
        )[1].reshape(1, 1, -1)
    return found


def clock(run: Callable[[], object], repeats: int) -> float:
    """Least wall time, s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def worst(run: Callable, omega: np.ndarray, truth: np.ndarray) -> float:
    """Largest relative error; inf when the tool breaks down."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            error = float((np.abs(run(omega) - truth) / np.abs(truth)).max())
    except (ValueError, np.linalg.LinAlgError):
        return np.inf
    return error if np.isfinite(error) else np.inf


def row(n: int, m: int, p: int) -> dict[str, float]:
    """One system: prints times and errors, gives time of each peer / ours."""
    A, B, C, D = system(n, m, p)
    plant = ct.ss(A, B, C, D, 0)
    omega = np.geomspace(1e-2, 1e2, POINTS)
    few = omega[:: POINTS // 5]
    truth = np.stack([reference(A, B, C, 1j * w) for w in few], axis=-1)
    repeats = 9 if n <= 200 else 5 if n <= 1000 else 3
    bare = clock(lambda: response.frequency_response(plant, omega, accuracy=False), repeats)
    full = clock(lambda: response.frequency_response(plant, omega), repeats)
    ours = response.frequency_response(plant, few)
    error = float((np.abs(ours.response - truth) / np.abs(truth)).max())
    bound = float(ours.accuracy.max())
    print(
        f"n = {n:4d}, {p} x {m}: ours {bare:.4f} s, with bounds {full:.4f} s, "
        f"error {error:.0e} (bound {bound:.0e})"
    )
    ratios = {}
    for name, run in peers(A, B, C, D).items():
        wrong = worst(run, few, truth)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            once = clock(lambda run=run: run(omega[:1]), 1)
            k = int(np.clip(SECONDS / once, 3, SAMPLE))  # fewer points where each is long
            part = clock(lambda run=run, k=k: run(omega[: k + 1]), 1)
            if 200 * (part - once) / k < SECONDS:  # the once outweighs the points: take more
                k = 200
                part = clock(lambda run=run: run(omega[:201]), 1)
            seconds, mark = once + (POINTS - 1) * max(part - once, 0.0) / k, "~"
            if seconds < 1:
                again = int(np.clip(1 / seconds, 1, repeats))
                seconds, mark = clock(lambda run=run: run(omega), again), " "
        failed = not wrong < max(WRONG, FACTOR * error)
        if not failed:
            ratios[name] = seconds / bare
        print(
            f"    {name:15s} {mark}{seconds:9.4f} s  {seconds / bare:8.1f} x ours "
            f"({seconds / full:.1f} x with bounds)  error {wrong:.0e}{'  !!' if failed else ''}"
        )
    return ratios


def lags() -> None:
    """The chain of 100 equal lags: truth, ours, python-control."""
    n, gain = 100, 0.5
    plant = ct.ss(-np.eye(n) + np.eye(n, k=-1), np.eye(n, 1), gain * np.eye(1, n, n - 1), 0, 0)
    truth = 1 / (gain * np.cos(np.pi / n) ** n)
    ours = response.margins(plant)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = ct.margin(plant)
    print(
        f"100 lags: gain margin {truth:.6f}; ours {ours.gain_margin:.6f} and phase margin "
        f"{ours.phase_margin}; control.margin {theirs[0]:.6f} and {theirs[1]:.1f} deg"
    )


def main(quick: bool) -> None:
    """Print the table; `quick` stops at n = 200."""
    sizes = SIZES[:2] if quick else SIZES
    single = {n: row(n, 1, 1) for n in sizes}
    print("two inputs, two outputs:")
    for n in sizes[:1] if quick else sizes[1:4]:
        row(n, 2, 2)
    A = system(200, 1, 1)[0]
    seconds = clock(lambda: response.stability(A), 1 if quick else 3)
    print(f"stability of n = 200: {seconds:.2f} s (asked for: under 1 s)")
    lags()
    print("summary, one input and output (ratios to ours without bounds):")
    for n, ratios in single.items():
        fastest = min(ratios, key=lambda name: ratios[name])
        text = f"    n = {n:4d}: fastest other {fastest} {ratios[fastest]:.1f} x ours"
        print(text + f"; control without slycot {ratios['control']:.1f} x ours")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="n = 50 and 200 only")
    main(parser.parse_args().quick)
