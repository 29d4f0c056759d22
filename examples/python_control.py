"""A loop handed to python-control: its plant with the offset, its diagram, its own run beside.

python examples/python_control.py [--quick] [--out diagram.png]
"""

import argparse

import control as ct
import numpy as np

import cellsys as cs

NAMES = ("cell1.cos", "cell1.sin")


def cell() -> cs.LatentModel:
    """Two latent states that lag behind the heading, pulled aside by an offset."""
    return cs.LatentModel(
        A=[[-0.02, 0.01], [-0.01, -0.03]],
        B=[[0.02, 0.0], [0.0, 0.03]],
        offset=[0.004, -0.002],
        input_names=NAMES,
        sensor=cs.StiffnessSensor(K_d=[[0.2, 0.5, -1.0], [0.6, 1.0, 0.5], [0.0, 0.0, 0.0]]),
    )


def main(quick: bool = False, out: str | None = None) -> float:
    model, t = cell(), np.linspace(0.0, 200.0 if quick else 1500.0, 41)
    plant = model.plant()
    print(plant.input_labels)  # the last one is 1 at all times: the offset
    u = np.tile([[1.0], [0.0], [1.0]], len(t))
    answer = ct.forced_response(plant, t, u).outputs.T
    off = np.abs(answer - model.predict(np.zeros(2), u[:2, 0], t)).max()
    print(f"forced_response from predict: {off:.1e}")

    loop = cs.closed_loop(model, controller=cs.PolarityLaw(kappa=1 / 60))
    diagram = loop.interconnect()
    tight = {"rtol": 1e-9, "atol": 1e-11}
    run = ct.input_output_response(diagram, t, 0, loop.system.x0, solve_ivp_kwargs=tight)
    known = loop.simulate(t, cs.CVODES(rtol=1e-10, atol=1e-12))
    print(f"input_output_response from simulate: {np.abs(run.states.T - known.x).max():.1e}")
    print(cs.margins(loop.open_loop()))
    if out is not None:
        from cellsys.figures import block_diagram

        block_diagram(diagram).figure.savefig(out)
    return float(off)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out")
    options = parser.parse_args()
    main(options.quick, options.out)
