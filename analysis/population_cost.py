"""What K coupled cells cost: poles and stability for any K, runs of a thousand cells.

    python analysis/population_cost.py [--quick] [--out DIR]

Random stable cells. Times are the shortest of several, wall and processor, in one process;
ratios are taken in turn, block form against dense eigenvalues of the same matrix.
"""

import argparse
import time
import tracemalloc
from pathlib import Path

import numpy as np
import scipy.linalg as sla

import cellsys as cs

NAMES = ("cell1.cos", "cell1.sin", "cell1.cos2", "cell1.sin2")


def cell(m: int, seed: int = 0) -> cs.LatentModel:
    """A stable latent cell with headings, a sensor, and half of V on the matrix."""
    rng = np.random.default_rng(seed)
    rates = np.geomspace(0.005, 0.3, m)
    T = np.eye(m) + 0.3 * rng.standard_normal((m, m)) / np.sqrt(m)
    V = sla.qr(rng.standard_normal((4 * m, m)), mode="economic")[0]
    K_d = rng.standard_normal((3, 1 + m)) / np.sqrt(m)
    K_d[2] = 0.0
    return cs.LatentModel(
        A=sla.solve(T.T, (T @ np.diag(-rates)).T).T,
        B=0.02 * rng.standard_normal((m, 4)),
        offset=0.01 * rng.standard_normal(m),
        V=V,
        blocks={"field": range(2 * m, 4 * m)},
        input_names=NAMES,
        sensor=cs.StiffnessSensor(K_d=K_d),
        z_start=rng.standard_normal(m),
    )


def shortest(call, times: int) -> tuple[float, float]:
    """Wall and processor seconds of the quickest of `times` calls."""
    wall, processor = [], []
    for _ in range(times):
        a, b = time.perf_counter(), time.process_time()
        call()
        wall.append(time.perf_counter() - a)
        processor.append(time.process_time() - b)
    return min(wall), min(processor)


def independent_of_K(m: int) -> None:
    P_map = -0.1 * np.eye(m)
    for form in (cs.Superposition(), cs.MappedSuperposition(P_map=P_map), cs.Feedback()):
        model = cell(m)
        for K in (10, 1_000_000):

            def once(model=model, K=K, form=form):
                cells = cs.couple(model, K, form)
                cells.pole_set()
                cells.stability()

            wall, processor = shortest(once, 7)
            print(
                f"poles and stability, {form.name}, m = {m}, K = {K}: {1e3 * wall:.1f} ms "
                f"(processor {1e3 * processor:.1f} ms)"
            )


def against_dense(m: int, total: int) -> None:
    """Ratio to the eigenvalues of the assembled K m x K m matrix, taken in turn."""
    K, model = total // m, cell(m)
    form = cs.MappedSuperposition(P_map=-0.1 * np.eye(m))
    M = cs.couple(model, K, form).matrix()
    ours, dense = [], []
    for _ in range(2):
        dense.append(shortest(lambda: sla.eigvals(M), 1)[1])
        ours.append(shortest(lambda: cs.couple(model, K, form).pole_set(), 9)[1])
    error = np.abs(
        np.sort(sla.eigvals(M).real) - np.sort(cs.couple(model, K, form).poles().real)
    ).max()
    print(
        f"poles at K m = {K * m}, m = {m}: blocks {1e3 * min(ours):.2f} ms, dense eigenvalues "
        f"{min(dense):.2f} s, {min(dense) / min(ours):.0f} times; real parts differ by {error:.1e}"
    )


def thousand_cells(K: int, m: int, duration: float, folder: Path | None) -> None:
    headings = np.random.default_rng(0).uniform(0, 2 * np.pi, K)
    cells = cs.couple(cell(m), K, headings=headings)
    t = np.linspace(0.0, duration, 301)
    for tol in (1e-6, 1e-8):
        method = cs.Exponential(rtol=tol, atol=tol)
        began, used = time.perf_counter(), time.process_time()
        run = cells.simulate(t, method)
        print(
            f"{K} cells, m = {m}, each its own polarity, {duration:g} s, tolerance {tol:g}: "
            f"{time.perf_counter() - began:.1f} s (processor {time.process_time() - used:.1f} s), "
            f"{run.statistics['steps']} steps"
        )
    turned = np.abs(np.linalg.norm(run.p, axis=2) - 1).max()
    print(f"  | |p| - 1 | at most {turned:.1e}")
    peaks = []
    for part in (K // 4, K):
        small = cs.couple(cell(m), part, headings=headings[:part])
        tracemalloc.start()
        small.simulate(t[:31], cs.Exponential(rtol=1e-4, atol=1e-4))
        peaks.append(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()
    print(f"  memory over 31 samples: {peaks[0]:.1f} MB at K = {K // 4}, {peaks[1]:.1f} MB at {K}")
    if folder is not None:
        from cellsys.figures import headings as draw
        from cellsys.figures import save_png, sheet

        figure, axes = sheet((6.5, 3.5))
        one = {
            f"cell {k + 1}": cs.Trajectory(
                t=run.t,
                x=run.block("z")[:, k],
                states=cs.Layout([cs.Block("z", (m,))]),
                p=run.p[:, k : k + 1],
            )
            for k in range(4)
        }
        draw(one, ax=axes)
        save_png(figure, folder / "population_cost.png")


def graph_coupled(K: int, m: int) -> None:
    places = np.random.default_rng(1).uniform(0, 30 * np.sqrt(K), (K, 2))
    graph = cs.InteractionGraph.attenuated(places, 20.0)
    for form in (cs.Feedback(), cs.MappedSuperposition(P_map=-0.1 * np.eye(m))):

        def once(form=form):
            weights = cs.InteractionGraph(graph.weights)  # nothing kept from before
            cs.couple(cell(m), graph=weights, coupling=form).pole_set()

        wall, processor = shortest(once, 2)
        print(
            f"graph of {K} cells, m = {m}, {form.name}: all {K * m} poles in {wall:.2f} s "
            f"(processor {processor:.2f} s)"
        )


def main(quick: bool = False, out: str | None = None) -> None:
    folder = None if out is None else Path(out)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    independent_of_K(20 if quick else 100)
    for m in (20, 100):
        against_dense(m, 400 if quick else 2000)
    thousand_cells(50 if quick else 1000, 20, 300.0 if quick else 3000.0, folder)
    graph_coupled(100 if quick else 1000, 20)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", help="folder for the figure")
    options = parser.parse_args()
    main(options.quick, options.out)
