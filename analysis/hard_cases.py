"""Error of the naive route and of ours against hardness, for six sweeps, in one figure.

    python analysis/hard_cases.py [--quick] [--out DIR]

Every sweep has an exact reference: a theorem, a closed form, or a run at a tight tolerance. The
table has hardness, error of the naive route, error of ours; nan where a route gave no number.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scipy.linalg as sla
import scipy.signal

import cellsys as cs
from cellsys.figures import hard_sweep, save_png, sheet


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of a pole of either set to the nearest of the other."""
    apart = np.abs(np.asarray(a)[:, None] - np.asarray(b)[None])
    return float(max(apart.min(axis=0).max(), apart.min(axis=1).max()))


def coupling(count: int) -> tuple:
    """Poles of two coupled cells while 1 - lambda -> 0: by the theorem those of one, twice.

    Below 1e-7 `pole_set` says besides that data do not determine them, and gives both sets.
    """
    rng, rows = np.random.default_rng(0), []
    U, F, W = (sla.qr(rng.standard_normal((n, 4)), mode="economic")[0] for n in (7, 9, 4))
    A = -np.diag([0.1, 0.2, 0.5, 1.0]) + 0.3 * np.triu(rng.standard_normal((4, 4)), 1)
    for gap in np.logspace(-2, -16, count):
        gaps = np.array([gap, 0.3, 0.5, 0.7])
        V = np.vstack([U * np.sqrt(gaps), F * np.sqrt(1 - gaps)]) @ W.T
        model = cs.LatentModel(A=A, V=V, blocks={"component": range(7), "field": range(7, 16)})
        P = V[7:].T @ V[7:]
        N = np.eye(8) + np.kron([[0, 1], [1, 0]], P)
        naive = sla.eigvals(N @ np.kron(np.eye(2), A) @ np.linalg.pinv(N))
        ours = cs.couple(model, 2, cs.Superposition()).pole_set().values
        exact = np.diag(A)
        rows.append((1 / gap, distance(naive, exact), distance(ours, exact)))
    return "poles of two coupled cells", "1 / (1 - lambda)", rows


def lags(count: int) -> tuple:
    """Gain of (s + 1)^-n at 1 rad/s, the lags in turned coordinates."""
    rows = []
    for n in np.unique(np.geomspace(5, 100, count).astype(int)):
        Q = sla.qr(np.random.default_rng(n).standard_normal((n, n)))[0]
        A, B, C = Q @ (-np.eye(n) + np.eye(n, k=-1)) @ Q.T, Q[:, :1], Q[:, -1:].T
        exact = (1 + 1j) ** -float(n)
        num, den = scipy.signal.ss2tf(A, B, C, [[0.0]])
        naive = np.polyval(num[0], 1j) / np.polyval(den, 1j)
        ours = cs.frequency_response((A, B, C, [[0.0]]), [1.0]).response[0, 0, 0]
        rows.append((n, abs(naive / exact - 1), abs(ours / exact - 1)))
    return "frequency response of n lags", "n", rows


def antipode(count: int) -> tuple:
    """One polarity step from `gap` off the antipode, long enough to turn by some 90 degrees."""
    rows, d = [], np.array([1.0, 0.0, 0.0])
    for gap in np.logspace(-1, -15, count):
        p, tau = np.array([-np.cos(gap), np.sin(gap), 0.0]), np.log(1 / gap)
        end = 2 * np.arctan(np.exp(-tau) / np.tan(gap / 2))
        exact = np.array([np.cos(end), np.sin(end), 0.0])
        with np.errstate(all="ignore"):
            angle = np.arccos(p @ d)
            new = 2 * np.arctan(np.tan(angle / 2) * np.exp(-tau))
            naive = np.array([np.cos(new), np.sin(new), 0.0])
        ours = cs.PolarityLaw(kappa=1.0).step(p, d, tau)
        rows.append((1 / gap, np.abs(naive - exact).max(), np.abs(ours - exact).max()))
    return "polarity step near the antipode", "1 / angle", rows


def conditioning(count: int) -> tuple:
    """Poles learned from snapshots whose columns are 1 to 1e12 apart."""
    rows, dt = [], 0.1
    rng = np.random.default_rng(1)
    A = np.array([[-0.3, 1.0, 0.0], [-1.0, -0.3, 0.2], [0.0, 0.0, -0.8]])
    step, exact = sla.expm(dt * A), sla.eigvals(A)
    x = [rng.standard_normal(3)]
    for _ in range(80):
        x.append(step @ x[-1])
    for spread in np.logspace(0, 12, count):
        X = np.array(x) * np.array([1.0, np.sqrt(spread), spread])
        G = X[:-1].T @ X[:-1]
        K = np.linalg.pinv(G) @ (X[:-1].T @ X[1:])
        with np.errstate(all="ignore"):
            naive = np.log(sla.eigvals(K).astype(complex)) / dt
        data = cs.snapshots([X], dt=dt, scale="column")
        ours = cs.reduce(data, order=3, method=cs.LeastSquares()).poles()
        error = distance(naive, exact) if np.all(np.isfinite(naive)) else np.nan
        rows.append((spread, error, distance(ours, exact)))
    return "poles learned, columns far apart", "largest over smallest column", rows


def damping(count: int) -> tuple:
    """Slope of the rate of a noise-driven variable on itself: -(1 - rho)/dt, eq. 19 and ours."""
    rows, dt, n = [], 0.1, 200_000
    for rho in 1 - np.logspace(-0.05, -2, count):
        rng = np.random.default_rng(3)
        noise = rng.standard_normal(n) * np.sqrt(1 - rho**2)
        eta = scipy.signal.lfilter([1.0], [1.0, -rho], noise)
        exact, rate = -(1 - rho) / dt, np.diff(eta) / dt
        # eq. 19 regresses the backward difference; the forward one is what models are fitted to
        naive, ours = (np.polyfit(z, rate, 1)[0] for z in (eta[1:], eta[:-1]))
        rows.append((1 / (1 - rho), abs(naive / exact - 1), abs(ours / exact - 1)))
    return "damping under noise (2: wrong sign)", "1 / (1 - correlation)", rows


def switches(count: int) -> tuple:
    """Largest error of a crawler's first three switching times: fixed steps and roots.

    Hardness is the step; the tolerance of ours is its fourth power.
    """
    system, end = cs.build_crawlers([cs.Crawler()]), 6.0
    tight = cs.simulate(system, cs.DOP853(rtol=1e-12, atol=1e-14), [0.0, end])
    exact = np.array([e.time for e in tight.events][:3])
    rows = []
    for step in np.geomspace(0.001, 0.1, count):
        t, x, found = 0.0, system.x0.copy(), []
        while t < end and len(found) < len(exact):
            a = system.rhs(t, x)
            x = x + step * system.rhs(t + step / 2, x + step / 2 * a)
            t += step
            for event in system.events():
                if event.guard(t, x) <= 0:
                    x = event.reset(t, x)
                    found.append(t)
        rtol = max(step**4, 1e-11)
        run = cs.simulate(system, cs.DOP853(rtol=rtol, atol=rtol / 100), [0.0, end])
        ours = np.array([e.time for e in run.events][:3])
        short = np.array(found[: len(exact)])
        error = np.abs(short - exact).max() if len(short) == len(exact) else np.nan
        rows.append((step, error, np.abs(ours - exact).max()))
    return "switching times of a crawler (s)", "step; tolerance is its 4th power (s)", rows


SCENE = {
    "name": "small cell",
    "duration": "20 s",
    "matrix": {"diameter": "24 um", "nodes": 90},
    "cells": [{"radius": "4 um"}],
    "effects": {
        name: {}
        for name in ("drag", "membrane_elasticity", "volume", "cortical_tension", "lamellipodium",
                     "substrate_contact", "matrix_elasticity", "foundation")
    },
}  # fmt: skip


def shifted(kinetics: str, shift: float) -> float:
    """rms distance (um) after 20 s of a cell's nodes, shift taken off, from those of a run whose
    start was not shifted."""
    adhesion = {"focal_adhesion": {"kinetics": kinetics}}
    ends = []
    for moved in (0.0, shift):
        system = cs.build(cs.Scene.parse(SCENE | {"effects": SCENE["effects"] | adhesion}))
        x0 = system.x0.copy()
        system.states.view(x0, "cell1.position")[:, 0] += moved
        run = cs.simulate(system, cs.LinearlyImplicit(step=0.5), [0.0, 20.0], x0, seed=3)
        end = system.states.view(run.x[-1], "cell1.position").copy()
        end[:, 0] -= moved
        ends.append(end)
    return float(np.sqrt(np.mean(np.sum((ends[1] - ends[0]) ** 2, axis=1))))


SWEEPS = (coupling, lags, antipode, conditioning, damping, switches)


def main() -> None:
    """Table on standard output, figure in the output folder where one is given."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="fewer points")
    parser.add_argument("--out", type=Path, help="folder of the figure")
    given = parser.parse_args()
    figure, axes = sheet((12.0, 7.0), 2, 3)
    for sweep, ax in zip(SWEEPS, axes.flat, strict=True):
        title, label, rows = sweep(5 if given.quick else 15)
        hardness, naive, ours = np.array(rows, float).T
        hard_sweep(hardness, naive, ours, title=title, label=label, ax=ax)
        print(f"\n{title}\n{label:>30s}{'naive':>12s}{'cellsys':>12s}")
        for row in rows:
            print(f"{row[0]:30.3g}{row[1]:12.1e}{row[2]:12.1e}")
    print("\nshape 20 s after a shifted start (nm)")
    print(f"{'shift':>20s}{'5 nm':>12s}{'100 nm':>12s}")
    for kinetics in ("clutch", "switching"):
        found = [1e3 * shifted(kinetics, s) for s in (0.005, 0.1)]
        print(f"{kinetics:>20s}{found[0]:12.2g}{found[1]:12.2g}")
    if given.out is not None:
        print(f"\nfigure: {save_png(figure, given.out / 'hard_cases.png')}")


if __name__ == "__main__":
    main()
