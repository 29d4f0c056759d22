"""What accuracy costs in time: one page of tables and work-precision figures.

    python analysis/accuracy_cost.py [--quick] [--out DIR] [--only SECTION]

Writes accuracy_cost.html, and CSV, JSON and PNG of every sweep. Latent loops are random stable
ones of the order asked for (a reduced model of a scene has no other structure); full-order runs
are of examples/spreading.toml, crawlers of examples/crawler.toml. Models of order, training runs
and Table 4 are trained on runs of its disc without the inclusion, kept in DIR/runs. Peers are
called directly.
"""

import argparse
import dataclasses
import html
import tempfile
import time
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.linalg as sla

import cellsys as cs
from cellsys.accuracy import (
    check_budget,
    full_order_references,
    full_order_setups,
    input_output_response,
    measure,
    probe_times,
    scene_problems,
    solve_ivp_peer,
)

HERE = Path(__file__).resolve().parent
NAMES = ("cell1.cos", "cell1.sin", "cell1.cos2", "cell1.sin2")
TOLERANCES = [10.0**-k for k in range(1, 10)]


def latent_loop(m, seed=3):
    """A stable plant with rates 0.02 .. 0.2 1/s, steered by the heading that it is sensed by."""
    rng = np.random.default_rng(seed)
    rates = -np.geomspace(0.02, 0.2, m)
    turn = np.zeros(m - 1)
    turn[::2] = 0.03 * rng.random(len(turn[::2]))
    mix = sla.qr(rng.standard_normal((m, m)))[0] + 0.1 * rng.standard_normal((m, m))
    A = mix @ (np.diag(rates) + np.diag(turn, 1) - np.diag(turn, -1)) @ sla.solve(mix, np.eye(m))
    K_d = rng.standard_normal((3, 1 + m))
    K_d[:, 1:] *= 0.1
    K_d[2] = 0.0
    model = cs.LatentModel(
        A=A,
        B=0.1 * rng.standard_normal((m, 4)),
        offset=0.02 * rng.standard_normal(m),
        input_names=NAMES,
    )
    return cs.closed_loop(model, sensor=cs.loop.StiffnessSensor(K_d=K_d), z0=rng.standard_normal(m))


def cells_problem(loop, cells, t):
    """`cells` copies of a loop from other headings."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(-np.pi, np.pi, cells)
    z0 = loop.z0 + 0.1 * rng.standard_normal((cells, loop.order))
    p0 = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    name = f"closed loop, m = {loop.order}, {cells} cell{'s' * (cells > 1)}"
    return cs.CostProblem(name=name, system=cs.loop_copies(loop, z0, p0), t=t)


def loop_sweep(loop, cells, t, tolerances, repeats):
    """Our Exponential against every peer on `cells` closed loops."""
    problem = cells_problem(loop, cells, t)
    setups = [cs.by_tolerance(cs.Exponential, tolerances)]
    setups += [solve_ivp_peer(n, tolerances) for n in ("RK45", "DOP853")]
    setups.append(input_output_response(tolerances))
    # Ten cells are 1030 states: one difference Jacobian is 1030 calls, one construction 5 s.
    few = tolerances if cells == 1 else tolerances[1::4]
    setups += [solve_ivp_peer(n, few) for n in ("LSODA", "BDF")]
    setups.append(cs.by_tolerance(cs.CVODES, few))
    references = (cs.by_tolerance(cs.Exponential, [1e-12]), solve_ivp_peer("DOP853", [1e-12]))
    return cs.work_precision(setups, problem, references, repeats=repeats)


def who_is_cheapest(sweep):
    """Rows: error asked, our cheapest, the cheapest peer, ratio."""
    rows = []
    for k in range(1, 9):
        own, all_of = sweep.cheapest(10.0**-k, own=True), sweep.cheapest(10.0**-k, own=False)
        if own and all_of:
            rows.append(
                [f"1e-{k}", f"{own.setup} {1e3 * own.seconds:.1f} ms",
                 f"{all_of.setup} {1e3 * all_of.seconds:.1f} ms",
                 f"{all_of.seconds / own.seconds:.2f}x"]
            )  # fmt: skip
    return rows


def crawler_sweep(end, repeats):
    """Event-driven crawler: integrators that find events; one crawler (README: why not two)."""
    scene = cs.load_scene(HERE.parent / "examples" / "crawler.toml")
    scene = dataclasses.replace(scene, cells=scene.cells[:1])
    problem = cs.CostProblem(name="crawler", system=cs.build(scene), t=np.linspace(0.0, end, 41))
    setups = [cs.by_tolerance(m, [1e-3, 1e-5, 1e-7, 1e-9]) for m in (cs.LSODA, cs.DOP853, cs.Radau)]
    references = cs.by_tolerance(cs.LSODA, [1e-12]), cs.by_tolerance(cs.DOP853, [1e-12])
    return cs.work_precision(setups, problem, references, repeats=repeats, agree=1e-6)


def full_order_sweep(scene, end, name, repeats=1):
    """The full-order model: our two steppers and explicit Euler, against RKC and DOP853."""
    t = np.linspace(0.0, end, 3)
    problem = cs.CostProblem(name=name, system=cs.build(scene), t=t)
    limit = cs.stability_limit(problem.system)
    setups = [
        cs.by_step(cs.LinearlyImplicit, [1.0, 0.5, 0.25]),
        cs.by_tolerance(cs.RKC, [1e-2, 1e-3, 1e-4, 1e-5, 1e-6]),
        cs.by_step(cs.ExplicitEuler, [0.9 * limit, 0.3 * limit]),
    ]
    references = cs.by_tolerance(cs.RKC, [1e-8]), cs.by_tolerance(cs.DOP853, [1e-8])
    return cs.work_precision(
        setups, problem, references, error="motion", repeats=repeats, agree=1e-3
    )


def small_disc():
    """The spreading cell on a disc of 44 um."""
    scene = cs.load_scene(HERE.parent / "examples" / "spreading.toml")
    matrix = dataclasses.replace(scene.matrix, inclusion=None, diameter=44.0, nodes=500)
    one = dataclasses.replace(scene.cells[0], position=(0.0, 0.0), radius=5.0)
    return dataclasses.replace(scene, matrix=matrix, cells=(one,))


def budgets(page, quick, out):
    """Budgets of a scene, held to an exhaustive search on starts that they do not know."""
    spans = (4.0, 20.0) if quick else (10.0, 100.0)
    head = ["asked", "chosen", *(f"in {s:g} s" for s in spans), "cheapest there", "time ratio"]
    asked = [0.03] if quick else [0.1, 0.07, 0.05, 0.03, 0.02, 0.015, 0.01, 0.007, 0.005, 0.003]
    scene, rows = small_disc(), []
    for seed, error in enumerate(asked):
        t, later = (probe_times(scene, end) for end in spans)
        found = cs.budget(scene, error=error, t=t, held_out_t=later, seed=seed)
        if not found:
            rows.append([f"{error:g}", str(found), "", "", "", ""])
            continue
        short, long = (scene_problems(scene, 1, times, 1000 + seed, 1)[0] for times in (t, later))
        truth, ours = full_order_references(short, error)[0], full_order_setups(short)
        check = check_budget(found, short, ours, truth)
        run = cs.simulate(long.system, found.integrator, long.t, auxiliaries=False).x
        beyond = measure("motion", run, truth.solve(long, truth.settings[-1]))
        rows.append([f"{error:g}", check.chosen, f"{check.error:.1e}", f"{beyond:.1e}",
                     check.best or "-", f"{check.ratio:.2f}"])  # fmt: skip
        print("  ".join(rows[-1]), flush=True)
    page.table("budgets of a cell on a small disc, on other headings, places and seeds", head, rows)


def best_of(n, action):
    """Fastest of n, s, after a warm-up."""
    action()
    times = []
    for _ in range(n):
        began = time.perf_counter()
        action()
        times.append(time.perf_counter() - began)
    return min(times)


def orders(t, sizes, repeats):
    """Time of a closed loop against its order."""
    rows = []
    for m in sizes:
        loop = latent_loop(m)
        method = cs.Exponential(rtol=1e-6, atol=1e-6)
        seconds = best_of(repeats, partial(loop.simulate, t, method))
        rows.append([str(m), f"{1e3 * seconds:.1f} ms", f"{loop.simulate(t, method).error}"])
    return rows


def intervals(loop, end, spacings, repeats):
    """Time of a closed loop against the interval of its samples."""
    method = cs.Exponential(rtol=1e-6, atol=1e-6)
    rows = []
    for dt in spacings:
        t = np.arange(0.0, end + 0.5 * dt, dt)
        seconds = best_of(repeats, partial(loop.simulate, t, method))
        rows.append([f"{dt:g} s", str(len(t)), f"{1e3 * seconds:.1f} ms"])
    return rows


def cell(m, seed=0):
    """A stable cell steered by its heading, with half of V's rows on the matrix."""
    loop, rng = latent_loop(m), np.random.default_rng(seed)
    V = sla.qr(rng.standard_normal((3 * m, m)), mode="economic")[0]
    return dataclasses.replace(
        loop.model, V=V, n_states=3 * m, sensor=loop.sensor, z_start=loop.z0,
        blocks={"component": np.arange(m), "field": np.arange(m, 3 * m)},
    )  # fmt: skip


def couplings(counts, m, repeats):
    """Poles of K coupled cells: by modes and by the dense matrix."""
    model = cell(m)
    rows = []
    for K in counts:
        by_modes = best_of(repeats, lambda K=K: cs.couple(model, K, cs.Superposition()).poles())
        dense = "-"
        if K * m <= 600:
            A = sla.block_diag(*[model.A] * K)
            dense = f"{1e3 * best_of(1, lambda A=A: sla.eigvals(A)):.1f} ms"
        rows.append([str(K), f"{1e3 * by_modes:.1f} ms", dense])
    return rows


def choices(scene, end):
    """Cost of a simulated second with effects on and off, and of switching against clutch."""
    variants = {"as it is (clutch)": scene}
    effects = dict(scene.effects)
    for name in ("lamellipodium", "cortical_tension"):
        if name in effects:
            less = {k: v for k, v in effects.items() if k != name}
            variants[f"without {name}"] = dataclasses.replace(scene, effects=less)
    rows = []
    for name, variant in variants.items():
        system, method = cs.build(variant), cs.LinearlyImplicit(step=0.5)
        t = np.array([0.0, end])
        seconds = best_of(1, partial(cs.simulate, system, method, t, auxiliaries=False))
        rows.append([name, f"{1e3 * seconds / end:.1f} ms per s"])
    return rows


def plan(quick):
    """Training, held-out and pair scenes on one homogeneous disc."""
    scene = cs.load_scene(HERE.parent / "examples" / "spreading.toml")
    matrix = dataclasses.replace(scene.matrix, inclusion=None)
    one = dataclasses.replace(scene.cells[0], position=(0.0, 0.0))
    plain, loaded, held = (3, 0, 1) if quick else (22, 10, 4)
    if quick:
        matrix = dataclasses.replace(matrix, diameter=44.0, nodes=500)
        one = dataclasses.replace(one, radius=5.0)
        training = dataclasses.replace(scene.training, duration=60.0)
        scene = dataclasses.replace(scene, duration=60.0, training=training)
    scene = dataclasses.replace(scene, matrix=matrix, cells=(one,))
    train = cs.turning_scenes(scene, plain, seed=101, scatter=3.0)
    if loaded:
        train += cs.turning_scenes(scene, loaded, seed=101, scatter=3.0, loaded=True)
    first, second = cs.turning_scenes(scene, 2, seed=777, scatter=0.0)
    both = tuple(
        dataclasses.replace(s.cells[0], position=x, commands=s.cells[0].commands or s.commands)
        for s, x in ((first, (-9.0, 0.0)), (second, (9.0, 0.0)))
    )
    pair = dataclasses.replace(first, name="pair", cells=both)
    held = cs.turning_scenes(scene, held, seed=72, scatter=3.0, label="held out")
    return scene, train, held, pair


def trained(page, quick, out):
    """Order, training runs, kinetics, and Table 4: two cells by models of real runs."""
    folder = out / "runs"
    scene, train, held, pair = plan(quick)
    workers = 1 if quick else 2
    runs = cs.run_ensemble(train + held, folder, workers=workers)
    known, test = cs.snapshots(runs[: len(train)]), cs.snapshots(runs[len(train) :])
    method = cs.Equivariant(folds=0, iterations=8) if quick else cs.Equivariant(folds=0)
    orders = [6, 12] if quick else [10, 20, 50, 100]
    methods = [cs.PCR(), cs.LeastSquares(), method]
    page.axis(cs.order_cost(known, test, orders, methods))
    took = float(np.mean([r.statistics["wall_time"] for r in runs]))
    counts = [1, 3] if quick else [2, 4, 8, 16, 32]
    page.axis(cs.runs_cost(known, test, method, orders[1], took, counts, draws=1))
    page.axis(cs.kinetics_cost(scene, np.linspace(0.0, 4.0 if quick else 1500.0, 5)))
    # Errors against half the step, so that the full-order run shows its own.
    pair = dataclasses.replace(pair, stepper="LinearlyImplicit")
    fine = dataclasses.replace(pair, step=0.5 * pair.step)
    truth, run = cs.run_ensemble([fine, pair], folder, workers=workers)
    began = time.perf_counter()
    small = {"order": 40, "places": 20} if quick else {}
    field = cs.GalerkinField(system=cs.build(pair), **small)
    offline = time.perf_counter() - began
    models = [cs.reduce(known, order=m, method=method) for m in ((6, 12) if quick else (20, 100))]
    step = {f"full order, {s.step:g} s": r for s, r in ((pair, run), (fine, truth))}
    table = cs.cells_cost(models, field, pair, truth, step)
    page.axis(dataclasses.replace(table, name=f"Table 4: {table.name}; modes of the field once: "
                                  f"{offline:.1f} s, {len(train)} training runs"))  # fmt: skip


class Page:
    """One HTML page, printed as it grows."""

    def __init__(self, folder):
        self.folder, self.parts = folder, []
        folder.mkdir(parents=True, exist_ok=True)

    def table(self, title, head, rows):
        print(f"\n{title}")
        for row in [head, *rows]:
            print("  " + "  ".join(f"{cell:>24s}" for cell in row))
        cells = "".join(
            "<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>"
            for row in [head, *rows]
        )
        self.parts.append(f"<h2>{html.escape(title)}</h2><table>{cells}</table>")

    def axis(self, axis):
        self.table(axis.name, axis.head(), axis.table())

    def sweep(self, sweep):
        print(f"\n{sweep}")
        source, _ = sweep.save(self.folder)
        figure = sweep.plot()[0].figure
        figure.savefig(source.with_suffix(".png"), dpi=110)
        plt.close(figure)
        rows = "".join(
            "<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>"
            for row in sweep.table()
        )
        self.parts.append(
            f"<h2>{html.escape(sweep.problem)}</h2><img src='{source.stem}.png'>"
            f"<table>{rows}</table>"
        )
        head = ["error", "ours", "cheapest peer", "peer/ours"]
        if any(p.own for p in sweep.points) and any(not p.own for p in sweep.points):
            self.table(f"{sweep.problem}: who is cheapest", head, who_is_cheapest(sweep))

    def write(self):
        style = "<style>body{font-family:sans-serif}td{padding:2px 10px}</style>"
        text = f"<!doctype html><title>What accuracy costs</title>{style}{''.join(self.parts)}"
        (self.folder / "accuracy_cost.html").write_text(text, encoding="utf-8")
        print(f"\npage: {self.folder / 'accuracy_cost.html'}")


def loops(page, quick, out):
    """Closed loops: every integrator, for one cell and for ten."""
    m, end, repeats = (20, 120.0, 1) if quick else (100, 3000.0, 3)
    t, tolerances = np.arange(0.0, end + 1.0), TOLERANCES[1:8:3] if quick else TOLERANCES
    loop = latent_loop(m)
    for cells in (1, 10):
        page.sweep(loop_sweep(loop, cells, t, tolerances, repeats))


def sizes(page, quick, out):
    """Closed loops against order and samples; K cells by modes and by the dense matrix."""
    m, end, repeats = (20, 120.0, 1) if quick else (100, 3000.0, 5)
    t = np.arange(0.0, end + 1.0)
    page.table(
        "closed loop against its order", ["m", "time", "error estimate"],
        orders(t, [5, 20] if quick else [5, 20, 50, 100, 200], repeats),
    )  # fmt: skip
    page.table(
        "closed loop against the interval of its samples", ["interval", "samples", "time"],
        intervals(latent_loop(m), end, [1.0, 10.0] if quick else [0.1, 1.0, 10.0, 100.0], repeats),
    )  # fmt: skip
    page.table(
        "poles of K cells", ["K", "by modes", "dense"],
        couplings([2, 10] if quick else [2, 10, 100, 1000], 10 if quick else 20, repeats),
    )  # fmt: skip
    few, span = ([2], 30.0) if quick else ([2, 10, 100], 300.0)
    page.axis(cs.coupling_cost(cell(10 if quick else 20), few,
                               np.arange(0.0, span + 1.0, 10.0), cs.Feedback()))  # fmt: skip


def crawler(page, quick, out):
    """The event-driven crawler."""
    page.sweep(crawler_sweep(1.0 if quick else 12.0, 1))


def full_order(page, quick, out):
    """The full-order model: integrators, effects on and off (no quick form)."""
    if quick:
        return
    scene = cs.load_scene(HERE.parent / "examples" / "spreading.toml")
    page.sweep(full_order_sweep(scene, 10.0, "full order, spreading"))
    page.table("effects on and off", ["scene", "time"], choices(scene, 5.0))


SECTIONS = {f.__name__: f for f in (loops, sizes, trained, crawler, full_order, budgets)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, help="folder of the page and its runs")
    parser.add_argument("--only", choices=SECTIONS, action="append", help="this section alone")
    given = parser.parse_args()
    if given.out is not None:
        return everything(given.quick, given.out, given.only)
    with tempfile.TemporaryDirectory() as scratch:
        return everything(given.quick, Path(scratch), given.only)


def everything(quick, out, only):
    page = Page(out)
    for name in only or SECTIONS:
        SECTIONS[name](page, quick, out)
    page.write()


if __name__ == "__main__":
    main()
