"""How fast does a cell turn? kappa with its interval, from headings recorded every 5 s.

python examples/fit_kappa.py [--quick]
"""

import argparse

import numpy as np

import cellsys as cs

NAMES = ("cell1.cos", "cell1.sin")


def cell(kappa: float) -> cs.ClosedLoop:
    """Two latent states that lag behind the heading and pull the sensed direction along."""
    model = cs.LatentModel(
        A=[[-0.02, 0.01], [-0.01, -0.03]],
        B=[[0.02, 0.0], [0.0, 0.03]],
        offset=[0.004, -0.002],
        input_names=NAMES,
        sensor=cs.StiffnessSensor(K_d=[[1.0, 0.3, -0.2], [0.4, 0.2, 0.3], [0.0, 0.0, 0.0]]),
    )
    law = cs.PolarityLaw(kappa=kappa)
    return cs.closed_loop(model, controller=law, p0=[np.cos(2.2), np.sin(2.2), 0.0])


def main(quick: bool = False) -> cs.Fitted:
    t = np.arange(0.0, 301.0 if quick else 1501.0, 5.0)
    truth = cell(1 / 80).simulate(t, cs.CVODES(rtol=1e-9, atol=1e-9))
    seen = np.arctan2(truth.p[:, 0, 1], truth.p[:, 0, 0])
    seen = seen + 0.1 * np.random.default_rng(0).standard_normal(len(t))  # 6 deg of noise
    found = cs.fit(cell(1 / 60), cs.Recording(t=t, headings=seen), ["kappa"])
    print(found)
    profile = found.profiles["kappa"]
    print(f"profile: {profile.low:.6f} to {profile.high:.6f} 1/s; it was {1 / 80:.6f} 1/s")

    # The same loop as CasADi expressions, for a problem of one's own.
    form = cs.symbolic(found.loop, parameters=["kappa"], inputs=["amplitude"])
    print(form)
    print(form.function())

    # A cell that already points where it is drawn says nothing about how fast it turns.
    still = np.full(len(t), seen[-60:].mean()) + 0.1 * np.random.default_rng(1).standard_normal(
        len(t)
    )
    try:
        cs.fit(cell(1 / 60), cs.Recording(t=t, headings=still), ["kappa"])
    except cs.RankError as error:
        print(error)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
