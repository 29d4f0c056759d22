"""Every internal state follows its law to second order, against a method that shares no code."""

from functools import cache

import numpy as np
import pytest

from cellsys.effects.clutch import ClutchElement
from cellsys.effects.protocol import Element
from cellsys.effects.steering import PolarityElement
from cellsys.integrate import BDF2, DOP853, simulate
from tests.mechanics.scenes import small

END = np.array([0.0, 2.0])
EXTRA = {
    "clutch and polarity": {},
    "creep and degradation": {"matrix_creep": {}, "matrix_degradation": {}},
}


@cache
def exact(extra):
    """State at the end by an explicit method of order 8; stability alone keeps it exact."""
    method = DOP853(rtol=1e-7, atol=1e-9)
    return simulate(small(**EXTRA[extra]), method, END, auxiliaries=False).x[-1]


def orders(extra):
    """Order of every state block at the end, from two steps."""
    system, errors = small(**EXTRA[extra]), []
    for h in (0.2, 0.1):
        method = BDF2(step=h, tolerance=1e-4, corrections=9)
        gap = simulate(system, method, END, auxiliaries=False).x[-1] - exact(extra)
        errors.append(
            {b.name: np.linalg.norm(gap[system.states.slice(b.name)]) for b in system.states}
        )
    coarse, fine = errors
    return {name: float(np.log2(coarse[name] / fine[name])) for name in coarse}


@pytest.mark.parametrize("extra", EXTRA)
def test_every_block_is_of_second_order(extra):
    found = orders(extra)
    assert len(found) >= 5
    # Two, less what kinks of contact and of buckling take: they are crossed within a step.
    assert min(found.values()) > 1.6, found


def test_naive_bonds_at_the_rates_of_the_start_take_the_order(monkeypatch):
    """What the linearly implicit Euler does; an off rate at the start's bonds alone is enough."""

    def first(self, s, middle, end, dt):
        self.advance(s, end, dt)

    for kind in (Element, ClutchElement, PolarityElement):
        monkeypatch.setattr(kind, "advance_by_middle", first)
    found = orders("clutch and polarity")
    assert found["cell1.bond_strength"] < 1.4
    assert found["cell1.bond_stretch"] < 1.4
