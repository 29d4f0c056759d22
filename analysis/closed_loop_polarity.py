"""The polarity loop on PCR, which does not predict, against full-order, from several headings.

python analysis/closed_loop_polarity.py [--quick] [--runs DIR] [--out DIR]
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import numpy as np

import cellsys as cs

SCENE = Path(__file__).parents[1] / "examples" / "spreading.toml"


def main(quick: bool = False, runs: str | None = None, out: str | None = None) -> None:
    scene = cs.load_scene(SCENE)
    starts, order = (120.0, -60.0, 200.0), 10
    if quick:
        plan = dataclasses.replace(scene.training, runs=4, held_out=1, duration=60.0)
        scene, starts, order = dataclasses.replace(scene, training=plan, duration=60.0), (120.0,), 5
    full = [
        dataclasses.replace(
            scene, cells=(dataclasses.replace(scene.cells[0], polarity=float(np.radians(a))),)
        )
        for a in starts
    ]
    with tempfile.TemporaryDirectory() as scratch:
        train, _ = cs.training_scenes(scene)
        ran = cs.run_ensemble(train + full, runs or scratch)
        data = cs.snapshots(ran[: len(train)])
        model = cs.reduce(data, order=order, method=cs.PCR())
        truth = [(r.t, np.array(r.p)) for r in ran[len(train) :]]
    print(model.card.verdict)
    curves = {}
    for start, (t, p) in zip(starts, truth, strict=True):
        loop = cs.closed_loop(model, controller=cs.PolarityLaw(), p0=p[0, 0])
        run = loop.simulate(t, cs.CVODES(rtol=1e-8, atol=1e-8))
        gap = cs.heading_error_deg(run.p[:, 0], p[:, 0])
        turned = cs.heading_deg(p[:, 0]), cs.heading_deg(run.p[:, 0])
        print(
            f"start {start:6.1f} deg: heading at the end {turned[0][-1]:7.1f} (full) "
            f"{turned[1][-1]:7.1f} (reduced); error {np.sqrt(np.mean(gap**2)):.1f} deg rms"
        )
        curves[start] = (t, *turned)
    if out is not None:
        from cellsys.figures import save_png, sheet

        figure, ax = sheet((8, 4.2))
        for k, (start, (t, a, b)) in enumerate(curves.items()):
            ax.plot(t, a, "-", color=f"C{k}", label=f"{start:g} deg, full order")
            ax.plot(t, b, "--", color=f"C{k}", label=f"{start:g} deg, reduced")
        ax.set(xlabel="time (s)", ylabel="heading (deg)")
        ax.legend(fontsize="small")
        ax.grid(alpha=0.3)
        save_png(figure, Path(out) / "closed_loop_polarity.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--runs", help="run cache to use and fill")
    parser.add_argument("--out", help="folder for the figure")
    options = parser.parse_args()
    main(options.quick, options.runs, options.out)
