"""The majorant bounds the tangent: M - 3/4 K >= 0, at a look and until the next one.

A linearly implicit step oscillates (the two-cycle of a lagged tangent) where M < K/2 or so; the
scheme asks for 3/4. K is the tangent of one step: forces after the internal states have followed
the nodes, by central differences.
"""

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.integrate import LinearlyImplicit, simulate
from tests.mechanics.scenes import small

DT = 0.5  # s, the shipped step


def bound(system, t, x):
    """M (n, n) on the free node states: majorant blocks and low-rank directions."""
    n = system.states.size
    M, covered = np.zeros((n, n)), np.zeros(n, int)
    for block in system.majorant(t, x, DT):
        matrix = block.matrix().toarray()
        for column in block.entries.T:
            M[np.ix_(column, column)] += matrix
            covered[column] += 1
    nodes = system.drag() > 0
    assert np.all(covered[nodes] == 1)  # together the blocks cover every node state once
    assert not covered[~nodes].any()
    for item in system.low_rank(t, x):
        M[np.ix_(item.entries, item.entries)] += item.stiffness * np.outer(
            item.direction, item.direction
        )
    return M


def tangent(system, t, x, free, h=1e-6):
    """-dF/dx (k, k) on the free states, of the forces at the end of a step that starts at x."""
    ports = system.W_eta
    drag = np.where(np.isfinite(system.drag()), system.drag(), 0.0)

    def forces(end):
        system.advance_internal(t, x, end, DT)
        return drag[free] * (ports @ system.efforts(t + DT, end))[free]

    K = np.empty((len(free), len(free)))
    for column, state in enumerate(free):
        end = [x.copy(), x.copy()]
        end[0][state] += h
        end[1][state] -= h
        K[:, column] = (forces(end[1]) - forces(end[0])) / (2 * h)
    return K


CASES = {
    "clutch": {},
    "stiffening": {"matrix_elasticity": {"law": "stiffening", "onset": "0.005"}},
    "switching": {
        "focal_adhesion": {"kinetics": "switching", "bind_rate": "2 1/s", "bind_distance": "2 um"}
    },
}


@pytest.mark.parametrize(
    "name",
    ["switching", *(pytest.param(n, marks=pytest.mark.slow) for n in ("clutch", "stiffening"))],
)
def test_majorant_bounds_the_tangent_until_the_next_look(name):
    system = small(**CASES[name])
    run = simulate(system, LinearlyImplicit(step=DT), np.array([0.0, 2.0, 30.0, 40.0]), seed=1)
    free = np.flatnonzero(np.isfinite(system.drag()) & (system.drag() > 0))
    bonds = "cell1.bond_partner"
    for look, use in ((0, 0), (1, 1), (2, 3)):
        system.forget()
        x, later = run.x[look].copy(), run.x[use].copy()
        if bonds in system.states and look != use:
            # A new bond is looked at when it forms: compare the bonds that both states have.
            kept = system.states.view(x, bonds) == system.states.view(later, bonds)
            if not kept.all():
                for block in (bonds, "cell1.bond_number", "cell1.bond_length"):
                    system.states.view(later, block)[~kept] = -1.0 if block == bonds else 0.0
        M = bound(system, run.t[look], x)[np.ix_(free, free)]
        # The stepper renews the pressure direction at every step.
        for item in system.low_rank(run.t[use], later):
            fresh = np.zeros(system.states.size)
            fresh[item.entries] = item.direction
            M += item.stiffness * np.outer(fresh[free], fresh[free])
        for item in system.low_rank(run.t[look], x):
            stale = np.zeros(system.states.size)
            stale[item.entries] = item.direction
            M -= item.stiffness * np.outer(stale[free], stale[free])
        K = tangent(system, run.t[use], later, free)
        K = 0.5 * (K + K.T)
        least = sla.eigvalsh(M - 0.75 * K, subset_by_index=[0, 0])[0]
        largest = sla.eigvalsh(K, subset_by_index=[len(K) - 1, len(K) - 1])[0]
        # Differences of forces of 1e3 pN over 1e-6 um carry 1e-13/1e-6 of rounding: 1e-4 pN/um.
        assert least > -1e-6 * largest, (look, use)
        assert largest > 1e3
