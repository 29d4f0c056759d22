"""What each printed coupling of K cells does to the poles, on a cell learned from data.

    python analysis/coupled_stability.py [--quick] [--runs DIR] [--out DIR]

Prints the rank decision, poles and verdicts against K, the limits for many cells, the theorem
about eq. 36 on the learned model, and the polarity loops closed over the shared field.
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import numpy as np

import cellsys as cs

SCENE = Path(__file__).parents[1] / "examples" / "spreading.toml"


def learn(quick: bool, runs: str | None):
    """A reduced cell, its training latents and scene length."""
    scene = cs.load_scene(SCENE)
    order = 10
    if quick:
        plan = dataclasses.replace(scene.training, runs=4, held_out=1, duration=60.0)
        scene, order = dataclasses.replace(scene, training=plan), 5
    with tempfile.TemporaryDirectory() as scratch:
        train, _ = cs.training_scenes(scene)
        data = cs.snapshots(cs.run_ensemble(train, runs or scratch))
        model = cs.reduce(data, order=order, method=cs.PCR())
        start, eta = np.array(data.runs[0].x[:-1]), np.array(data.runs[0].eta)
        latent = model.encode(start[: len(eta)], eta[: len(start)])
    return model, latent


def spread(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of a pole of a from the nearest of b."""
    return float(np.abs(a[:, None] - b[None]).min(axis=1).max())


def theorem(model: cs.LatentModel) -> None:
    own = np.asarray(model.poles())
    print("eq. 36 on the learned cell:")
    for K in (2, 5, 1000):
        cells = cs.couple(model, K)
        found = cells.pole_set()
        print(
            f"  K = {K}: {found.count} poles, distance of the distinct ones from those of one cell "
            f"{spread(found.values[found.values != 0], own):.1e} 1/s, {found.zeros} exact zeros"
            + ("" if found.determined else "; not determined by the data")
        )
    P, A = cs.P_phi(model), model.continuous_matrices()[0]
    K, m = 2, model.order
    N = np.kron(np.eye(K), np.eye(m) - P) + np.kron(np.ones((K, K)), P)
    dense = np.linalg.eigvals(N @ np.kron(np.eye(K), A) @ np.linalg.pinv(N))
    print(f"  naive dense pseudo-inverse, K = 2: largest real part {dense.real.max():.3g} 1/s")


def against_K(model: cs.LatentModel, P_map: cs.ForceMap, numbers, folder) -> None:
    # [93] projects on the matrix's forces, and so does its P_map [88, 89]
    mapped = cs.MappedSuperposition(P_map=P_map, rows="forces")
    forms = (cs.Superposition(), mapped, cs.Feedback())
    drawn = []
    for form in forms:
        sets = []
        for K in numbers:
            cells = cs.couple(model, K, form)
            report = cells.stability()
            sets.append(report.poles)
            print(
                f"{form.name}, K = {K}: {report.verdict}, largest real part "
                f"{report.spectral_abscissa:.4g} 1/s, largest |pole| "
                f"{np.abs(report.poles.values).max():.4g} 1/s"
            )
        try:
            limit = cells.limit_poles()
        except cs.ParameterError as error:
            print(f"  {error}")
            limit = None
        if limit is not None:
            many = cs.couple(model, 100_000, form).pole_set()
            mean = many.values[np.isnan(many.omega) | (many.omega > 0)]
            scale = 99_999 if isinstance(form, cs.Feedback) else 1
            print(f"  mean block at K = 1e5 from its limit: {spread(mean / scale, limit):.1e} 1/s")
        # poles of Feedback grow like K: no common picture with their limit
        drawn.append((form, sets, None if isinstance(form, cs.Feedback) else limit))
    if folder is None:
        return
    from cellsys.figures import poles_against_cells, save_png, sheet

    figure, axes = sheet((13, 4.2), 1, 3)
    for ax, (form, sets, limit) in zip(axes, drawn, strict=True):
        poles_against_cells(numbers, sets, ax, limit=limit)
        ax.set_title(form.name, fontsize="medium")
        ax.set_xscale("symlog", linthresh=1e-2)
        ax.tick_params(axis="x", labelsize="small")
    save_png(figure, folder / "coupled_stability.png")


def closed_loops(model: cs.LatentModel, latent: np.ndarray, numbers, duration: float) -> None:
    """Cells meet through the sensed field: the loops' poles move although the plant's do not."""
    z, p = latent[-1], np.array([1.0, 0.0, 0.0])
    print(f"polarity loops about the end of a training run, heading {p[:2]}:")
    alone = cs.couple(model, 1).linearize((z, p)).poles.values
    for K in numbers:
        found = cs.couple(model, K).linearize((z, p))
        print(
            f"  K = {K}: largest real part {found.poles.abscissa:.4g} 1/s, poles moved by up to "
            f"{spread(found.poles.values, alone):.2g} 1/s against one cell; plant's "
            f"{found.plant_poles.abscissa:.4g} 1/s"
        )
    t = np.linspace(0.0, duration, 31)
    method = cs.Exponential(rtol=1e-6, atol=1e-6)
    angles = np.array([0.0, 0.7, 2.0])
    together = cs.couple(model, 3, headings=angles).simulate(t, method)
    for k, angle in enumerate(angles):
        single = cs.couple(model, 1, headings=[angle]).simulate(t, method)
        gap = cs.heading_error_deg(together.p[:, k], single.p[:, 0])
        print(
            f"  cell started at {np.degrees(angle):.0f} deg, {duration:g} s: heading differs from "
            f"the same cell alone by up to {np.abs(gap).max():.1f} deg"
        )


def lattice(side: int) -> cs.LinearField:
    """Square lattice of springs on a foundation, 6 um apart."""
    axis = 6.0 * (np.arange(side) - 0.5 * (side - 1))
    nodes = np.array([(x, y, 0.0) for x in axis for y in axis])
    near = np.linalg.norm(nodes[:, None] - nodes[None], axis=2) < 6.5
    springs = 0.2 * (np.diag(near.sum(axis=1)) - near)
    return cs.LinearField(nodes, np.kron(springs + 0.005 * np.eye(len(nodes)), np.eye(3)), 1.0)


def load_ports(numbers) -> None:
    """A collocated port against a freely fitted one of the same size, on one spring lattice."""
    rng = np.random.default_rng(7)
    m, field = 5, lattice(6)
    turn, push = rng.standard_normal((2, m, m))
    A = 0.2 * (turn - turn.T) - 0.02 * push @ push.T - 0.05 * np.eye(m)
    F = rng.standard_normal((2, m))
    passive = cs.CellPort.collocated(A, F, gamma=0.3)
    free = rng.standard_normal((m, 2))
    free *= np.linalg.norm(passive.C) / np.linalg.norm(free)
    fitted = cs.CellPort(A=A, F=F, C=free)
    print(f"LoadPorts, collocated: {passive.passivity()}")
    print(f"LoadPorts, freely fitted: {fitted.passivity()}")
    for K in numbers:
        places = rng.uniform(-9.0, 9.0, (K, 2))
        safe = cs.couple(passive, coupling=cs.LoadPorts(field=field, positions=places))
        loose = cs.couple(
            fitted, coupling=cs.LoadPorts(field=field, positions=places, allow_active=True)
        )
        print(
            f"  K = {K}: collocated {safe.pole_set().abscissa:.4g} 1/s "
            f"({safe.stability().verdict}), freely fitted {loose.pole_set().abscissa:.4g} 1/s "
            f"({loose.stability().verdict})"
        )
    try:
        cs.couple(fitted, coupling=cs.LoadPorts(field=field, positions=places))
    except cs.ParameterError as error:
        print(f"  refused: {error}")


def main(quick: bool = False, runs: str | None = None, out: str | None = None) -> None:
    folder = None if out is None else Path(out)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    model, latent = learn(quick, runs)
    print(f"cell: {model.card.verdict if model.card else ''}")
    print(f"split of its basis: {cs.couple(model, 2).rank}")
    # the adhesion forces on the membrane, and nothing else of the cell's laws
    laws = model.auxiliaries
    on_cell = [
        model.n_states + k
        for b in laws
        if b.name == "cell1.focal_adhesion"
        for k in range(laws.slice(b.name).start, laws.slice(b.name).stop)
    ]
    fitted = cs.fit_P_map(model, latent, cell_rows=on_cell, field="forces", tol=1e-3)
    print(
        f"P_map from the training run: |P_map| = {np.linalg.norm(fitted.matrix, 2):.3g}, residual "
        f"{fitted.residual:.2g}, {fitted.dropped} directions not in the data"
    )
    theorem(model)
    numbers = (1, 2, 10, 100)
    against_K(model, fitted, numbers, folder)
    load_ports(numbers[:3] if quick else numbers)
    closed_loops(model, latent, numbers, 60.0 if quick else 1500.0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--runs", help="folder that keeps the runs")
    parser.add_argument("--out", help="folder for the figure")
    options = parser.parse_args()
    main(options.quick, options.runs, options.out)
