"""A loop with a dead time, and one that is known by samples only: margins, figures of its step.

The polarity loop is kappa/s around a cell that senses late: how late may it be? Then the same
question to measured samples of a return ratio, with their noise.
"""

import argparse
from pathlib import Path

import control
import numpy as np

import cellsys as cs
from cellsys import figures

parser = argparse.ArgumentParser()
parser.add_argument("--quick", action="store_true", help="the same; it is quick anyway")
parser.add_argument("--out", type=Path, help="folder for the figure")
options = parser.parse_args()

# kappa = 1/60 1/s, and a lag of 20 s between polarity and what is sensed.
loop = control.tf([1 / 60], [20, 1, 0])
print(f"without delay: phase margin {cs.margins(loop).phase_margin:.1f} deg")
print(f"step of the closed loop: {cs.step_info(cs.feedback(loop))}")
for delay in (20.0, 60.0, 120.0):
    m = cs.margins(loop, delay=delay)
    said = "stable" if m.closed_loop_stable else f"NOT stable ({m.closed_loop_unstable} poles)"
    print(f"senses {delay:g} s late: {said}, gain margin on kappa {m.gain_margin:.3g}")

# Sixty samples of the same loop, off by 3 % (one standard deviation).
rng = np.random.default_rng(1)
omega = np.geomspace(1e-3, 0.2, 60)
noise = 0.03 * (rng.normal(size=60) + 1j * rng.normal(size=60))
measured = cs.margins(omega, loop(1j * omega) * (1 + noise), accuracy=np.full(60, 0.03), delay=20)
print(measured)
if options.out:
    options.out.mkdir(parents=True, exist_ok=True)
    figures.save_png(measured.plot()[0].figure, options.out / "measured_margins.png")
