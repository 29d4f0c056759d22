"""What can the sensor read the stiffest direction from, and does the loop turn like the true one?

    python analysis/sensor_truth.py [--quick] [--out DIR]

Two scenes, a stiff spot and a stiffness that grows to one side; training cells start at scattered
places with turning headings. Prints, in degrees, the mean angle between predicted and sensed
direction: of every choice of inputs on the run left out (the choice a model makes for itself), of
the chosen sensor on held-out runs beside the constant direction; and, as what no sensor of the
latent state has, of regressions on the nodal stress and stiffness that the full-order runs store.
Then the polarity loop on the equivariant plant against the full-order loop: heading error against
time. Last, two cells that sense each other: the loop on one shared field, read by the sensor of the
cell's own state and by the law itself on the field's fibres. --out keeps runs and figure.
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import numpy as np

import cellsys as cs
from cellsys.cell.certificate import moments_of
from cellsys.cell.records import read_records
from cellsys.scene.parts import Gradient

SCENE = Path(__file__).parents[1] / "examples" / "spreading.toml"
STARTS = (120.0, -60.0, 200.0, 20.0)


def scenes(quick: bool) -> dict[str, cs.Scene]:
    """The shipped scene with its spot, and with a gradient instead."""
    scene = cs.load_scene(SCENE)
    if quick:
        plan = dataclasses.replace(scene.training, runs=3, held_out=1, duration=80.0)
        matrix = dataclasses.replace(scene.matrix, diameter=46.0, nodes=500)
        scene = dataclasses.replace(scene, matrix=matrix, training=plan, duration=80.0)
    wider = dataclasses.replace(scene.training, scatter=4.0)
    scene = dataclasses.replace(scene, training=wider)
    slope = dataclasses.replace(
        scene.matrix, inclusion=None, gradient=Gradient(direction=0.5, per_um=0.02)
    )
    both = {
        "stiff spot": scene,
        "gradient": dataclasses.replace(scene, name="gradient", matrix=slope),
    }
    return {"gradient": both["gradient"]} if quick else both


def start_at(scene: cs.Scene, degrees: float) -> cs.Scene:
    """The scene with another heading at the start."""
    (cell,) = scene.cells
    turned = dataclasses.replace(cell, polarity=float(np.radians(degrees)))
    return dataclasses.replace(scene, cells=(turned,))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def samples(data: cs.Snapshots, model: cs.EquivariantModel) -> tuple[list, list]:
    """Direction of stored stress (K + 1, 2) and sensed direction (K + 1, 3), a pair per run."""
    records = read_records(data, model.dt, model.representation.port, model.sites)
    every = round(model.dt / data.dt)
    stress = [
        q / np.maximum(np.hypot(q[:, :1], q[:, 1:]), 1e-300)
        for q in moments_of(data, records, model.dt)["virial"]
    ]
    sensed = [np.asarray(data.runs[r.run].d) for r in records]
    return stress, [
        d[: r.steps * every + 1 : every, 0] for d, r in zip(sensed, records, strict=True)
    ]


def inputs(name: str, model: cs.EquivariantModel, data: cs.Snapshots, test: cs.Snapshots) -> None:
    """Angle errors of all choices."""
    sensor = model.sensor
    print(f"\n{name}: mean angle error on the run left out, deg")
    for choice, error in sorted(sensor.tried.items(), key=lambda item: item[1]):
        print(f"  {choice:40s} {error:6.2f}{'   <- chosen' if choice == sensor.inputs else ''}")
    print(
        f"  held-out runs: {sensor.held_out_error:.2f} deg, constant direction "
        f"{sensor.constant_error:.2f} ({sensor.held_out_error / sensor.constant_error:.2f} of it)"
    )
    known = cs.fit_sensor(*samples(data, model), *samples(test, model))
    print(f"  if the stress of the full-order run were known: {known.held_out_error:.2f} deg")


def one_loop(model: cs.EquivariantModel, scene: cs.Scene, run: cs.Trajectory) -> np.ndarray:
    """Heading error (K + 1,) of the reduced loop, deg."""
    data = cs.snapshots([run])
    record = read_records(data, model.dt, model.representation.port, model.sites)[0]
    loop = cs.closed_loop(
        model,
        controller=cs.PolarityLaw(kappa=scene.effects["polarity"].kappa),
        z0=model.encode_cell(record.nodes[:1], record.loads[:1])[0],
        p0=np.asarray(run.p[0, 0]),
    )
    found = loop.simulate(model.dt * np.arange(record.steps + 1))
    every = run.stride(model.dt)
    true = np.asarray(run.p)[: record.steps * every + 1 : every]
    return cs.heading_error_deg(found.p, true)[:, 0]


def two_cells(scene: cs.Scene, quick: bool) -> cs.Scene:
    """Two cells on the disc, both free to turn."""
    (cell,) = scene.cells
    places, far = ((-9.0, 0.0), (9.0, 0.0)), (1.2, -2.0)
    if quick:
        cell, places = dataclasses.replace(cell, radius=5.0), ((-8.0, 0.0), (8.0, 0.0))
    both = tuple(
        dataclasses.replace(cell, position=x, polarity=a) for x, a in zip(places, far, strict=True)
    )
    return dataclasses.replace(scene, name="two cells", cells=both)


def pair_loop(
    model: cs.EquivariantModel, scene: cs.Scene, run: cs.Trajectory, order: int
) -> dict[str, float]:
    """Heading error, deg rms over both cells, of every sensor."""
    system = cs.build(scene)
    field = cs.GalerkinField(system=system, order=order)
    ports = cs.LoadPorts(field=field, positions=np.array([c.position for c in scene.cells]),
                         headings=np.array([c.polarity for c in scene.cells]))  # fmt: skip
    law = cs.PolarityLaw(kappa=scene.effects["polarity"].kappa)
    every = run.stride(model.dt)
    true = np.asarray(run.p)[::every]
    out = {"heading kept": rms(cs.heading_error_deg(true[:1], true))}
    for name, sensor in (
        ("sensor of the cell's own state", model.sensor),
        ("law on the shared field", cs.FieldSensor.of(scene.effects["stiffness_sensing"])),
    ):
        cells = cs.couple(model, coupling=ports, controller=law, sensor=sensor)
        found = cells.simulate(run.t[::every])
        out[name] = rms(cs.heading_error_deg(found.p, true))
    return out


def main(quick: bool = False, out: str | None = None) -> None:
    if out is None:
        with tempfile.TemporaryDirectory() as scratch:
            return main(quick, scratch)
    folder, order = Path(out), (16 if quick else 50)
    method = cs.Equivariant(iterations=20, folds=0) if quick else cs.Equivariant(folds=0)
    curves = {}
    for name, scene in scenes(quick).items():
        train, held = cs.training_scenes(scene)
        loops = [start_at(scene, a) for a in STARTS[: 1 if quick else None]]
        pair = two_cells(scene, quick)
        ran = cs.run_ensemble([*train, *held, *loops, pair], folder / "runs")
        data = cs.snapshots(ran[: len(train)])
        test = cs.snapshots(ran[len(train) : len(train) + len(held)])
        model = cs.reduce(data, order=order, method=method, test=test)
        inputs(name, model, data, test)
        misses = [one_loop(model, scene, run) for run in ran[len(train) + len(held) : -1]]
        worst = ", ".join(f"{s:g} deg: {rms(m):.1f}" for s, m in zip(STARTS, misses, strict=False))
        print(f"  polarity loop, heading error against the full-order loop, deg rms: {worst}")
        curves[name] = misses
        told = pair_loop(model, pair, ran[-1], 60 if quick else 200)
        print("  two cells, heading error, deg rms: " + ", ".join(
            f"{k} {v:.1f}" for k, v in told.items()))  # fmt: skip
    draw(curves, model.dt, folder)


def draw(curves: dict[str, list[np.ndarray]], dt: float, folder: Path) -> None:
    """Heading error against time."""
    from cellsys.figures import save_png, sheet

    figure, ax = sheet((7, 3.8))
    for k, (name, misses) in enumerate(curves.items()):
        for i, (start, miss) in enumerate(zip(STARTS, misses, strict=False)):
            ax.plot(dt * np.arange(len(miss)), miss, ("-", "--", ":", "-.")[i], color=f"C{k}",
                    label=f"{name}, from {start:g} deg")  # fmt: skip
    ax.axhline(0.0, color="0.6", lw=0.8)
    ax.set(xlabel="time (s)", ylabel="heading error of the reduced loop (deg)")
    figure.legend(fontsize="x-small", ncols=4, loc="outside lower center")
    folder.mkdir(parents=True, exist_ok=True)
    save_png(figure, folder / "sensor_truth.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", help="folder of runs and figure")
    given = parser.parse_args()
    main(given.quick, given.out)
