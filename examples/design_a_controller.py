"""A controller of the heading by python-control: a gain that stands a delay, and LQR; checked.

python examples/design_a_controller.py [--quick]
"""

import argparse
import dataclasses

import control as ct
import numpy as np
from fit_kappa import cell

import cellsys as cs

DELAY = 40.0  # s from a direction sensed to a turn


def fastest(loop: cs.ClosedLoop) -> float:
    """The factor on kappa at which the loop stands twice the delay and twice the gain, no more."""
    L, low, high = loop.open_loop("equilibrium"), 1e-3, 1e3
    while high / low > 1.01:
        k = float(np.sqrt(low * high))
        found = cs.margins(k * L)
        stands = found.delay_margin >= 2 * DELAY and found.gain_margin >= 2.0
        low, high = (k, high) if stands else (low, k)
    return low


def main(quick: bool = False) -> None:
    loop, t = cell(1 / 60), np.linspace(0.0, 300.0 if quick else 1500.0, 61)
    point, k = loop.linearize("equilibrium"), fastest(loop)
    faster = dataclasses.replace(loop, controller=cs.PolarityLaw(kappa=k / 60))
    print(f"kappa may be {k:.2f} times as large at a delay of {DELAY:g} s of the sensor")
    print(cs.margins(faster.open_loop("equilibrium")))
    for name, each in (("as it is", loop), ("changed", faster)):
        run = each.simulate(t, cs.CVODES(rtol=1e-8, atol=1e-10))  # nonlinear, from 126 deg off
        off = np.abs(cs.heading_error_deg(run.p[:, 0], point.p[None]))
        print(f"{name}: {off[-1]:.2f} deg off at the end, 5 deg after {t[off > 5.0].max():.0f} s")

    # LQR: the turning rate as the input, plant and heading as the state.
    m = loop.order
    A = np.block([[point.A_plant, point.B_heading[:, None]], [np.zeros((1, m + 1))]])
    B = np.eye(m + 1)[:, m:]
    K, _, poles = ct.lqr(ct.ss(A, B, np.eye(m + 1), 0), np.diag([*[0.1] * m, 1.0]), [[1e4]])
    print(f"LQR: gain {K.round(4)[0]}, poles {np.sort(poles.real).round(4)}")
    form = cs.symbolic(loop, parameters=[], inputs=["heading"])
    f, x, theta = form.function(), form.x0.copy(), 2.2
    aim, h = np.arctan2(point.p[1], point.p[0]), 1.0
    for _ in range(int(t[-1] / h)):  # the nonlinear plant under the turning that LQR commands
        z = x[:m]
        theta -= h * float(K[0] @ np.append(z - point.z, np.angle(np.exp(1j * (theta - aim)))))
        x = x + h * np.asarray(f(x, theta, [])[0]).ravel()
    print(f"LQR in the nonlinear plant: {np.degrees(theta - aim):.3f} deg off at the end")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
