"""What do symbolic loops cost: form, integrator, runs through CasADi, fit, steer?

python analysis/symbolic_costs.py [--quick]
"""

import argparse
import time
from collections.abc import Callable

import casadi as ca
import numpy as np

import cellsys as cs

NAMES = ("cell1.cos", "cell1.sin", "cell1.cos2", "cell1.sin2")
METHOD = cs.CVODES(rtol=1e-6, atol=1e-6)


def model(m: int, seed: int = 0) -> cs.LatentModel:
    """A stable cell of order m, time constants 5 to 50 s, that senses mostly one direction."""
    rng = np.random.default_rng(seed)
    skew = rng.standard_normal((m, m)) / np.sqrt(m)
    A = 0.05 * (skew - skew.T) - np.diag(rng.uniform(0.02, 0.2, m))
    V = np.linalg.qr(rng.standard_normal((3 * m, m)))[0]
    K_d = 0.05 * rng.standard_normal((3, 1 + m))
    K_d[:, 0], K_d[2] = [1.0, 0.3, 0.0], 0.0
    return cs.LatentModel(
        A=A,
        B=0.05 * rng.standard_normal((m, 4)),
        offset=0.02 * rng.standard_normal(m),
        V=V,
        blocks={"component": range(m), "field": range(m, 3 * m)},
        input_names=NAMES,
        sensor=cs.StiffnessSensor(K_d=K_d),
        z_start=rng.standard_normal(m),
    )


def timed(what: str, work: Callable[[], object], most: float | None = None) -> object:
    began = time.perf_counter()
    found = work()
    took = time.perf_counter() - began
    bound = "" if most is None else f"   (at most {most:g} s)"
    print(f"{what:<58} {took:8.3f} s{bound}", flush=True)
    return found


def by_hand(cells: cs.CoupledCells, t: np.ndarray) -> np.ndarray:
    """The end of a run as one would write it with CasADi alone: one matrix for all cells."""
    form = cs.symbolic(cells, parameters=[])
    problem = {"x": form.x, "ode": form.rhs}
    F = ca.integrator("hand", "cvodes", problem, 0.0, t[1:].tolist(), METHOD.options(float(t[-1])))
    return np.asarray(F(x0=form.x0)["xf"])[:, -1]


def main(quick: bool = False) -> None:
    counts, m, duration = ((2, 3), 8, 60.0) if quick else ((2, 5, 10), 50, 1500.0)
    headings = np.linspace(0, 5, counts[-1])
    ten = cs.couple(model(m), counts[-1], headings=headings)
    form = timed(f"form of {counts[-1]} cells, m = {m}", lambda: cs.symbolic(ten), 2.0)
    timed("  its integrator", lambda: form.integrator(METHOD, 5.0), 5.0)
    t = np.linspace(0.0, duration, 31)
    for K in counts:
        cells = cs.couple(model(m), K, headings=headings[:K])
        run = timed(f"CVODES, {K} cells, {duration:g} s", lambda c=cells: c.simulate(t, METHOD))
        again = timed("  once more, its integrator kept", lambda c=cells: c.simulate(t, METHOD))
        hand = timed("  by hand", lambda c=cells: by_hand(c, t))
        n = K * m
        off = np.abs(np.asarray(hand)[n:] - np.asarray(run.x)[-1, n:]).max()
        built = run.statistics["construction_time"], again.statistics["construction_time"]
        print(f"  construction {built[0]:.3f} s, then {built[1]:.3f} s; headings differ {off:.1e}")

    loop = cs.closed_loop(model(20), p0=[np.cos(2.0), np.sin(2.0), 0.0])
    t = np.arange(0.0, duration + 1.0, 5.0)
    p = loop.simulate(t, cs.CVODES(rtol=1e-8, atol=1e-8)).p[:, 0]
    noise = 0.1 * np.random.default_rng(2).standard_normal(len(t))
    seen = cs.Recording(t=t, headings=np.arctan2(p[:, 1], p[:, 0]) + noise)
    fit = timed(f"fit of kappa to {duration:g} s", lambda: cs.fit(loop, seen), 2.0)
    print(fit)
    place = np.zeros((2, 21))
    place[0, 1], place[1, 2] = 1.0, 1.0
    options = {"horizon": 1500.0, "place": place}
    if quick:
        options |= {"horizon": 60.0, "pieces": 4}
    target = cs.Target(place=[0.3, -0.3])
    print(timed("steer", lambda: cs.steer(loop, target, ["heading"], **options), 10.0))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
