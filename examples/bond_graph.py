"""A DC motor as a bond graph: from elements by name to the Bode plot of voltage to speed.

python examples/bond_graph.py [--quick] [--out DIR]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from cellsys.bondgraph import GY, BondGraph, I, One, R, Se
from cellsys.response import frequency_response


def main(quick: bool = False, out: str | None = None) -> None:
    motor = BondGraph(
        [
            Se("supply", "12 V"), One("circuit", domain="electric"),
            R("coil", "1 ohm"), I("inductor", "0.5 mH"),
            GY("motor", "0.02 N m/A"),
            One("shaft", domain="rotation"), I("rotor", "2e-5 kg m^2"), R("bearing", "1e-5 N m s"),
        ],
        [
            "supply -> circuit -> motor -> shaft",
            "circuit -> coil", "circuit -> inductor", "shaft -> rotor", "shaft -> bearing",
        ],
        units="si", name="DC motor",
    )  # fmt: skip
    print(motor)
    plant = motor.equations().linearize(outputs=["rotor.f"])
    response = frequency_response(plant, np.logspace(-1, 5, 60 if quick else 400))
    print(f"steady speed at 12 V: {12 * np.real(plant(0)):.1f} rad/s")
    if out is not None:
        import matplotlib.pyplot as plt

        from cellsys.figures import bode

        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        bode(response)
        plt.gcf().savefig(folder / "bode.png", dpi=120)
        motor.plot().figure.savefig(folder / "graph.png", dpi=120)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out")
    arguments = parser.parse_args()
    main(arguments.quick, arguments.out)
