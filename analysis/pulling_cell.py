"""How does a cell pull: do its forces balance, does it keep its volume, does it feel stiffness?

    python analysis/pulling_cell.py [--quick] [--part forces|stiffness|cue|start|cost]

Prints the literal form of the thesis (`examples/spreading_literal.toml`) beside the shipped one
(`examples/spreading.toml`), one cell each:

forces     tractions of a cell that keeps its heading on 5 kPa, at every sample from 60 s on:
           balance with the drag, dipole, front and rear, torque; contact, crawl, volume
stiffness  the same at the end on 0.2, 1, 5, 20 and 50 kPa, and with the bonds of the option
           `focal_adhesion.reinforcement`
cue        where a cell that senses turns: homogeneous networks, gradients, inclusions
start      how far a start 5 nm to the side moves the run, and how still the free cell starts
cost       processor time of a step, timed in turns
"""

import argparse
import dataclasses
import os
import tomllib
from collections.abc import Callable
from pathlib import Path

# As the command line does: vectors here are short, a second BLAS thread costs time.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import cellsys as cs
from cellsys.observe import (
    contact_area,
    contact_radius,
    crawl_distance,
    traction_read_outs,
    tractions,
    volume_course,
)
from cellsys.scene import step_cost

EXAMPLES = Path(__file__).parents[1] / "examples"
FORMS = {"literal": "spreading_literal.toml", "balanced": "spreading.toml"}
SETTLED = 60.0  # s: before it there are few bonds, and the cell speeds up
Table = dict[str, dict]


def one_cell(form: str, duration: float, *, seed: int = 7, senses: bool = False) -> Table:
    """Table of a cell at the origin of a homogeneous disc, heading 90 deg."""
    table = tomllib.loads((EXAMPLES / FORMS[form]).read_text())
    table.pop("training")
    table["matrix"].pop("inclusion")
    table |= {"duration": f"{duration:g} s", "sample": "10 s", "seed": seed}
    table["cells"] = [{"position": ["0 um", "0 um"], "polarity": "90 deg"}]
    if not senses:
        for name in ("stiffness_sensing", "polarity"):
            table["effects"].pop(name)
    return table


def run_of(table: Table) -> cs.Trajectory:
    return cs.run_scene(cs.Scene.parse(table))


def settled(run: cs.Trajectory) -> list[int]:
    """Samples that end an interval after `SETTLED`; the last one of a short run."""
    return [k for k in range(1, len(run)) if run.t[k - 1] >= SETTLED] or [len(run) - 1]


def forces(duration: float) -> None:
    print(f"\nforces, heading kept, 5 kPa, {duration:g} s; worst of samples after {SETTLED:g} s")
    rows: dict[str, dict[str, str]] = {}
    for form in FORMS:
        run = run_of(one_cell(form, duration))
        found = [tractions(run, k=k) for k in settled(run)]
        last, end = found[-1], traction_read_outs(run)
        front, rear = np.array([f.front_rear_pN for f in found]).T
        dipole = np.array([np.trace(f.dipole_pN_um) for f in found])
        x, volume = run.block("cell1.position"), volume_course(run)
        minutes = (run.t[-1] - run.t[len(run) // 5]) / 60.0
        rows[form] = {
            "|sum t + N C V| / sum |t|, %": f"{100 * max(f.imbalance_share for f in found):.3g}",
            "net share at the end, %": f"{100 * last.net_share:.2f}",
            "sum |t| at the end, nN": f"{1e-3 * last.sum_pN:.1f}",
            "dipole at the end, nN um": f"{1e-3 * dipole[-1]:.1f}",
            "samples with dipole < 0": f"{(dipole < 0).sum()} of {len(dipole)}",
            "front / rear at the end, nN": f"{1e-3 * front[-1]:+.1f} / {1e-3 * rear[-1]:+.1f}",
            "samples with front < 0 < rear": f"{((front < 0) & (rear > 0)).sum()} of {len(front)}",
            "torque, %": f"{100 * max(f.torque_share for f in found):.2f}",
            "torque less the drag's couple, %": (
                f"{100 * max(f.torque_imbalance_share for f in found):.2g}"
            ),
            "net force along the normal, %": f"{100 * last.net_pN[2] / last.sum_pN:.2f}",
            "contact radius, um": f"{contact_radius(x[-1]):.2f}",
            "contact area, um2": f"{contact_area(x[-1]):.0f}",
            "crawl, um": f"{crawl_distance(x):.2f}",
            "crawl after a fifth, um/min": f"{crawl_distance(x[len(x) // 5 :]) / minutes:.3f}",
            "peak traction, Pa": f"{end['traction_peak_Pa']:.0f}",
            "strain energy, fJ": f"{end['strain_energy_fJ']:.2f}",
            "greatest displacement, um": f"{_displacement(run):.2f}",
            "V/V(0)": f"{volume.min() / volume[0]:.4f} .. {volume.max() / volume[0]:.4f}",
        }
    _beside(rows)


def _displacement(run: cs.Trajectory) -> float:
    return float(np.linalg.norm(run.block("matrix.displacement"), axis=2).max())


def _beside(rows: dict[str, dict[str, str]]) -> None:
    print(f"{'':34s}" + "".join(f"{form:>20s}" for form in rows))
    for name in next(iter(rows.values())):
        print(f"{name:34s}" + "".join(f"{row[name]:>20s}" for row in rows.values()))


def stiffness(duration: float, moduli: tuple[float, ...]) -> None:
    print(f"\nstiffness, heading kept, {duration:g} s")
    head = "radius um, area um2, sum t nN, dipole nN um, net %, um/min, W fJ, umax um".split(", ")
    print(f"{'form':>11s} {'kPa':>5s}" + "".join(f"{name:>13s}" for name in head))
    for form in (*FORMS, "reinforced"):
        for modulus in moduli:
            table = one_cell("balanced" if form == "reinforced" else form, duration)
            table["matrix"]["modulus"] = f"{modulus:g} kPa"
            if form == "reinforced":
                table["effects"]["focal_adhesion"]["reinforcement"] = 3
            run = run_of(table)
            x, out = run.block("cell1.position"), traction_read_outs(run)
            late = len(x) // 5
            speed = 60.0 * crawl_distance(x[late:]) / (run.t[-1] - run.t[late])
            values = (
                f"{contact_radius(x[-1]):.2f}",
                f"{out['contact_area_end_um2']:.0f}",
                f"{1e-3 * out['traction_sum_pN']:.1f}",
                f"{1e-3 * out['dipole_pN_um']:.1f}",
                f"{out['net_traction_percent']:.1f}",
                f"{speed:.3f}",
                f"{out['strain_energy_fJ']:.2f}",
                f"{_displacement(run):.2f}",
            )
            print(f"{form:>11s} {modulus:5g}" + "".join(f"{value:>13s}" for value in values))


def _turned(table: Table) -> tuple[float, float, float]:
    """Heading at the end and change of it, deg, and mean |d|."""
    run = run_of(table)
    angle = np.degrees(np.unwrap(np.arctan2(run.p[:, 0, 1], run.p[:, 0, 0])))
    strength = np.hypot(run.d[:, 0, 0], run.d[:, 0, 1]).mean()
    return float(angle[-1]), float(angle[-1] - angle[0]), float(strength)


def cue(duration: float, seeds: int, few: int) -> None:
    print(f"\ncue, start at 90 deg, {duration:g} s")

    def gradient(per_um: float) -> Callable[[Table], None]:
        def put(table: Table) -> None:
            table["matrix"]["gradient"] = {"direction": "0 deg", "per_um": per_um}

        return put  # fmt: skip

    def inclusion(factor: float) -> Callable[[Table], None]:
        def put(table: Table) -> None:
            spot = {"center": ["12 um", "0 um"], "radius": "5 um", "factor": factor}
            table["matrix"]["inclusion"] = spot

        return put  # fmt: skip

    for form in FORMS:
        change, strengths = [], []
        for seed in range(1, seeds + 1):
            _, turned, strength = _turned(one_cell(form, duration, seed=seed, senses=True))
            change.append(turned)
            strengths.append(strength)
        print(f"  {form}, homogeneous: turns by {' '.join(f'{c:.0f}' for c in change)} deg, mean "
              f"{np.abs(change).mean():.1f}, greatest {np.abs(change).max():.1f}, mean |d| "
              f"{np.mean(strengths):.3f}")  # fmt: skip
    for what, put in (
        ("gradient 1 %/um to 0 deg", gradient(0.01)),
        ("gradient 2 %/um to 0 deg", gradient(0.02)),
        ("stiff inclusion at 0 deg, 12 um", inclusion(5.0)),
        ("soft inclusion at 0 deg, 12 um", inclusion(0.2)),
    ):
        ends, strengths = [], []
        for seed in range(1, few + 1):
            table = one_cell("balanced", duration, seed=seed, senses=True)
            put(table)
            end, _, strength = _turned(table)
            ends.append(end)
            strengths.append(strength)
        print(f"  balanced, {what}: ends at {' '.join(f'{e:.0f}' for e in ends)} deg, "
              f"mean |d| {np.mean(strengths):.2f}")  # fmt: skip


def start(duration: float) -> None:
    print(f"\nstart, heading kept, {duration:g} s")
    for form in FORMS:
        table = one_cell(form, duration)
        base = run_of(table)
        table["cells"][0]["position"] = ["0.005 um", "0 um"]
        moved = run_of(table)
        share = {}
        for name in ("cell1.position", "matrix.displacement"):
            x, y = moved.block(name), base.block(name)
            x = x - (x[0] - y[0])
            share[name] = np.linalg.norm(x - y) / np.linalg.norm(y - y[0])
        system = cs.build(cs.Scene.parse(table))
        cell = system.states.slice("cell1.position")
        speed = [
            np.abs(system.rhs(float(t), x.copy())[cell]).max()
            for t, x in zip(base.t, base.x, strict=True)
        ]
        print(f"  {form}: 5 nm to the side change the cell by {share['cell1.position']:.2g}, the "
              f"matrix by {share['matrix.displacement']:.2g}; greatest speed of a node at the "
              f"start {speed[0]:.1e} um/s, later {max(speed[1:]):.1e} um/s")  # fmt: skip


def cost(duration: float, repeats: int) -> None:
    """The shipped scene, the same without reaction and wall on the matrix, and the literal one.

    A step of the first minute makes more corrections, in which forces are small: steps are timed
    after it.
    """
    scene = cs.load_scene(EXAMPLES / "spreading.toml")
    literal = cs.load_scene(EXAMPLES / "spreading_literal.toml")
    source = dataclasses.replace(scene.effects["lamellipodium"], reaction="none")
    rigid = dataclasses.replace(scene.effects["substrate_contact"], support="rigid")
    without = dataclasses.replace(
        scene, effects={**scene.effects, "lamellipodium": source, "substrate_contact": rigid}
    )
    cases = {"literal": literal, "shipped, no reaction": without, "shipped": scene}
    best = dict.fromkeys(cases, np.inf)
    systems = {name: cs.build(case) for name, case in cases.items()}
    for _ in range(repeats):
        for name, case in cases.items():
            whole = step_cost(systems[name], case.step, duration, repeats=1).whole
            best[name] = min(best[name], whole)
    print(
        f"\ncost, ms of processor time a step from {duration:g} to {2 * duration:g} s, least of "
        f"{repeats} in turns"
    )
    for name, whole in best.items():
        print(f"  {name:22s} {1e3 * whole:7.3f}  x {whole / best['literal']:.3f} of the literal")


def main(quick: bool = False, part: str = "all") -> None:
    long = 20.0 if quick else 1500.0
    jobs: dict[str, Callable[[], None]] = {
        "forces": lambda: forces(long),
        "stiffness": lambda: stiffness(long, (5.0,) if quick else (0.2, 1.0, 5.0, 20.0, 50.0)),
        "cue": lambda: cue(long, 1 if quick else 6, 1 if quick else 3),
        "start": lambda: start(long),
        "cost": lambda: cost(10.0 if quick else 200.0, 1 if quick else 5),
    }
    for name, job in jobs.items():
        if part in ("all", name):
            job()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="short runs, one seed")
    parser.add_argument("--part", default="all",
                        choices=("all", "forces", "stiffness", "cue", "start", "cost"))  # fmt: skip
    parser.add_argument("--out", help="no figure is made", default=None)
    arguments = parser.parse_args()
    main(arguments.quick, arguments.part)
