"""Mechanics: fibres of no length, buckled networks and films, one bond, mass rupture, cells that
leave the substrate or stand at the rim. Each keeps an invariant and converges as steps halve."""

from functools import cache

import numpy as np
import pytest

from cellsys.errors import IntegrationError
from cellsys.integrate import ExplicitEuler, LinearlyImplicit, simulate
from cellsys.scene.registry import EFFECTS
from tests import naive
from tests.hard.stress import SEED, Case, Choice, Power, Real, hold
from tests.mechanics.small_scenes import tiny_system

SHELL = ("membrane_elasticity", "volume", "cortical_tension", "substrate_contact")
FIBRES = "matrix.matrix_elasticity"
FREE = -1.0


def converges(system, x, step, end, of, floor=1e-9):
    """Steps of a quarter end nearer to steps of an eighth than whole ones do, by half at least.

    First order would give a seventh; extra corrections, which a step makes or not, and kinks
    passed a step later make it irregular. `floor` (um) is allowed besides.
    """
    ends = [
        simulate(system, LinearlyImplicit(step=h), [0.0, end], x, seed=1, auxiliaries=False).x[-1]
        for h in (step, step / 4, step / 8)
    ]
    assert np.all(np.isfinite(ends))
    far, near = (np.abs(e - ends[-1])[of].max() for e in ends[:2])
    assert near < 0.5 * far + floor, (near, far)


def energies(system, x, step, steps):
    """Stored energy (pN um) at every sample of a run of so many steps, and the run."""
    t = step * np.arange(steps + 1)
    run = simulate(system, LinearlyImplicit(step=step), t, x, seed=1, auxiliaries=False)
    return np.array([sum(system.energy(s, y).values()) for s, y in zip(t, run.x, strict=True)]), run


def falls(E):
    """Energy of something left to itself falls.

    A step starts from where the last one's velocity would lead, so that a start far from rest is
    overshot: rises stay below a hundredth of the first energy, and never lead above it.
    """
    assert np.all(E[1:] <= E[0] * (1 + 1e-12))
    assert np.all(np.diff(E) < 0.01 * E[0] + 1e-12)
    assert E[-1] <= E[len(E) // 2] + 1e-9 * E[0]


def forces(system, x, block):
    """A nodal block of eta (nodes, 3), pN."""
    return system.auxiliaries.view(system.efforts(0.0, x), block)


def balanced(force, places, *, torque=True):
    """Sum of forces (and of torques) is zero to rounding of its terms."""
    size = np.abs(force).max() + 1e-300
    # at most some thousand terms of either sign
    assert np.abs(force.sum(axis=0)).max() < 1e-11 * size * len(force) ** 0.5
    if torque:
        arm = np.abs(places).max()
        moment = np.cross(places, force).sum(axis=0)
        assert np.abs(moment).max() < 1e-11 * size * arm * len(force) ** 0.5


# The network alone


@cache
def network(law, spring):
    """A disc of fibres without cells; the compiled laws and the mesh are made once."""
    return tiny_system(
        "matrix_elasticity", "foundation", cells=0,
        matrix_elasticity={"law": law}, foundation={"spring": f"{spring} pN/um"},
    )  # fmt: skip


def fibres_of_no_length(law, share, count, seed):
    """Fibres shrunk to `share` of their length: balance, falling energy, halving."""
    system, rng = network(law, 500), np.random.default_rng(seed)
    disc, x = system.matrix, system.x0.copy()
    u = system.states.view(x, "matrix.displacement")
    free = np.flatnonzero(~disc.clamped[disc.fibres[:, 1]])
    for k in rng.choice(free, count, replace=False):
        i, j = disc.fibres[k]
        u[j] = disc.position[i] + u[i] + share * (disc.position[j] - disc.position[i])
        u[j] -= disc.position[j]
    now = disc.position + u
    f = forces(system, x, FIBRES)
    assert np.all(np.isfinite(f))
    balanced(f, now)
    E, _ = energies(system, x, 0.25, 40)
    falls(E)
    assert E[-1] < 0.01 * E[0]
    converges(system, x, 0.5, 5.0, system.states.slice("matrix.displacement"))


@pytest.mark.slow
def test_a_fibre_of_no_length():
    for law in ("linear", "buckling", "stiffening"):
        fibres_of_no_length(law, 0.0, 1, 0)
        fibres_of_no_length(law, 1e-15, 3, 1)
    # naive: k (L - L0) d/L
    assert np.isnan(naive.spring_force(np.zeros(3), np.zeros(3), 1.0, 5.0)).all()


def pressed(disc, x, states, amount, rng):
    """Free nodes squeezed towards the middle by `amount`, and thrown out of the plane a little."""
    u = states.view(x, "matrix.displacement")
    move = ~disc.clamped
    u[move] = -amount * disc.position[move] + 1e-3 * rng.standard_normal((move.sum(), 3))


def a_buckled_network_unfolds(amount, law, seed):
    """Every fibre in compression at once: balance, energy falls to (almost) nothing, halving."""
    system, rng = network(law, 500), np.random.default_rng(seed)
    disc, x = system.matrix, system.x0.copy()
    pressed(disc, x, system.states, amount, rng)
    balanced(forces(system, x, FIBRES), disc.position + x.reshape(-1, 3))
    E, run = energies(system, x, 0.5, 200)
    falls(E)
    # the disc is held at its rim without stress, so that its rest is at zero
    assert E[-1] < 0.05 * E[0]
    assert np.abs(run.x[-1]).max() < np.abs(x).max()
    converges(system, x, 0.5, 5.0, system.states.slice("matrix.displacement"))


def test_the_whole_tangent_of_a_buckled_network_is_indefinite():
    """A step of 5 s with the tangent as it is (C/dt + K) goes uphill; ours, with its bound, not."""
    system = network("linear", 0)
    disc, x = system.matrix, system.x0.copy()
    pressed(disc, x, system.states, 0.3, np.random.default_rng(0))
    K = naive.fibre_tangent(disc.position + x.reshape(-1, 3), disc)
    free = np.flatnonzero(np.repeat(~disc.clamped, 3))
    M = K[np.ix_(free, free)] + 2.0 / 5.0 * system.drag()[free[0]] * np.eye(len(free))
    assert np.linalg.eigvalsh(M).min() < 0
    for block in system.majorant(0.0, x, 5.0):
        bound = block.matrix().toarray()
        assert np.linalg.eigvalsh(0.5 * (bound + bound.T)).min() > -1e-9 * np.abs(bound).max()
    a_buckled_network_unfolds(0.3, "linear", 0)


def a_floppy_film_under_tension_is_quiet(strain, bump, step, seed):
    """No foundation: out of the plane only tension holds the film. No two-cycle, energy falls."""
    system, rng = network("linear", 0), np.random.default_rng(seed)
    disc, x = system.matrix, system.x0.copy()
    u = system.states.view(x, "matrix.displacement")
    u[:] = strain * disc.position  # the held rim too: the film stays stretched
    u[~disc.clamped, 2] += bump * rng.standard_normal((~disc.clamped).sum())
    E, run = energies(system, x, step, 60)
    falls(E)
    z = run.x.reshape(61, -1, 3)[:, ~disc.clamped, 2]
    v = np.diff(z, axis=0)
    loud = np.abs(v[20:-1]).max(axis=0) > 1e-9
    flips = np.mean(np.sign(v[21:]) != np.sign(v[20:-1]), axis=0)[loud]
    # modes that decay change sign once or twice in 40 steps; a two-cycle changes it in all
    assert not loud.any() or flips.max() < 0.5
    converges(system, x, step, 10 * step, system.states.slice("matrix.displacement"))


def test_a_film_stepped_without_its_tension_has_a_two_cycle():
    a_floppy_film_under_tension_is_quiet(0.05, 1e-3, 2.0, 0)
    system = network("linear", 0)
    disc, x = system.matrix, system.x0.copy()
    u = system.states.view(x, "matrix.displacement")
    u[:] = 0.05 * disc.position
    u[~disc.clamped, 2] += 1e-3 * np.random.default_rng(0).standard_normal((~disc.clamped).sum())
    # naive: stiffness along the fibres alone; the heights are then stepped explicitly
    heights = naive.film_without_tension(system, disc, x, 20.0, 30)
    v = np.diff(heights, axis=0)
    worst = np.argmax(np.abs(v[-1]))
    assert np.abs(v[-1, worst]) > 10 * np.abs(v[0]).max()
    assert np.all(np.sign(v[-6:, worst]) == -np.sign(v[-7:-1, worst]))


# Bonds


@cache
def bonded(bond_stiffness, kinetics="switching"):
    """A cell on its matrix; clusters bind within some 1e12 s, so that those given are all."""
    given = {
        "kinetics": kinetics, "bind_rate": "1e-12 1/s", "gain_rate": "1e-12 1/s",
        "bond_stiffness": f"{bond_stiffness} pN/um", "contraction_speed": "0 um/s",
    }  # fmt: skip
    return tiny_system(
        *SHELL, "focal_adhesion", "matrix_elasticity", "foundation", cells=1, focal_adhesion=given
    )


def bind(system, x, nodes, number):
    """Clusters of `number` bonds from membrane nodes to the nearest free surface nodes each."""
    disc, rest = system.matrix, system.matrix.position
    place = system.states.view(x, "cell1.position")
    taken = set()
    for i in nodes:
        away = np.linalg.norm(rest[disc.surface] - place[i], axis=1)
        j = next(j for j in disc.surface[np.argsort(away)] if int(j) not in taken)
        taken.add(int(j))
        system.states.view(x, "cell1.bond_partner")[i] = j
        system.states.view(x, "cell1.bond_number")[i] = number
        system.states.view(x, "cell1.bond_length")[i] = np.linalg.norm(rest[j] - place[i])


def lowest(system, x, count):
    return np.argsort(system.states.view(x, "cell1.position")[:, 2])[:count]


def of_bonds(system, x):
    """Forces of the clusters on cell and matrix (pN), and where they act (um)."""
    cell = forces(system, x, "cell1.focal_adhesion")
    matrix = forces(system, x, "matrix.focal_adhesion.cell1")
    places = system.matrix.position + system.states.view(x, "matrix.displacement")
    return (
        np.concatenate([cell, matrix]),
        np.concatenate([system.states.view(x, "cell1.position"), places]),
    )


def one_bond_carries_everything(stiffness, pull, angle):
    """A cell drawn aside by up to 3 um that hangs on one cluster: balance, energy, halving."""
    system = bonded(float(f"{stiffness:.3g}"))
    x = system.x0.copy()
    (node,) = lowest(system, x, 1)
    bind(system, x, [node], 1.0)
    nodes = system.states.view(x, "cell1.position")
    partner = int(system.states.view(x, "cell1.bond_partner")[node])
    away = np.arctan2(*(nodes[node] - system.matrix.position[partner])[1::-1]) + angle
    nodes[:, :2] += pull * np.array([np.cos(away), np.sin(away)])
    balanced(*of_bonds(system, x))
    drawn = forces(system, x, "cell1.focal_adhesion")
    assert np.count_nonzero(np.abs(drawn).max(axis=1)) == 1
    # what moves the cell as a whole is that one force and the substrate's: the shell is internal
    C = system.drag()[system.states.slice("cell1.position")].reshape(-1, 3)
    whole = (C * system.states.view(system.rhs(0.0, x), "cell1.position")).sum(axis=0)
    given = drawn.sum(axis=0) + forces(system, x, "cell1.substrate_contact").sum(axis=0)
    terms = sum(
        np.abs(forces(system, x, f"cell1.{name}")).sum()
        for name in ("membrane_elasticity", "volume", "cortical_tension", "substrate_contact")
    )
    assert np.abs(whole - given).max() < 1e-13 * (terms + np.abs(given).max())
    # first order; a cluster that opens one step later at the thinnest margin moves its node
    converges(system, x, 0.25, 4.0, system.states.slice("cell1.position"), 2e-3)


def test_explicit_steps_throw_a_node_off_its_bond():
    one_bond_carries_everything(1e4, 0.3, 0.5)
    system = bonded(1e6)
    x = system.x0.copy()
    bind(system, x, lowest(system, x, 1), 1.0)
    system.states.view(x, "cell1.position")[:, 0] += 0.3
    with pytest.raises(IntegrationError):
        simulate(system, ExplicitEuler(step=0.25), [0.0, 20.0], x, auxiliaries=False)


def all_bonds_break_in_one_step(pull, count, height):
    """Up to all clusters loaded beyond any hold: gone in one step, together and wholly."""
    system = bonded(40.0)
    x = system.x0.copy()
    nodes = lowest(system, x, count)
    bind(system, x, nodes, 5.0)
    system.states.view(x, "cell1.position")[:] += [pull, 0.0, height]
    before, loads = system.energy(0.0, x), of_bonds(system, x)
    balanced(*loads)
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        # the bonds as they open under their load over one step, nothing else moved
        end = x.copy()
        system.advance_internal(0.0, x, end, 0.25)
        torn, events = system.between_steps(0.25, end, 0.25, np.random.default_rng(0))
    assert [e.name for e in events] == ["rupture"] * count
    assert np.all(system.states.view(torn, "cell1.bond_partner") == FREE)
    left, _ = of_bonds(system, torn)
    assert not left.any()  # exactly: on the matrix as on the cell
    after = system.energy(0.0, torn)
    assert after.pop("cell1.focal_adhesion") == 0.0
    before.pop("cell1.focal_adhesion")
    assert after == before  # nothing else took the energy of the bonds
    E, _ = energies(system, torn, 0.25, 40)
    falls(E)
    converges(system, torn, 0.25, 4.0, slice(0, system.x0.size), 1e-6)


def test_a_rupture_that_frees_one_side_only():
    all_bonds_break_in_one_step(20.0, 12, 0.0)
    system = bonded(40.0)
    x = system.x0.copy()
    bind(system, x, lowest(system, x, 12), 5.0)
    system.states.view(x, "cell1.position")[:, 0] += 20.0
    force, _ = of_bonds(system, x)
    # naive: the cell's clusters are cleared, the matrix keeps last step's loads
    assert np.abs(naive.one_sided_rupture(force, len(system.cells[0].body.membrane.position))
                  .sum(axis=0)).max() > 0.1 * np.abs(force).max()  # fmt: skip


# Leaving the substrate, and its rim


@cache
def clutched():
    return tiny_system(
        *SHELL, "focal_adhesion", "matrix_elasticity", "foundation", cells=1,
        focal_adhesion={"kinetics": "clutch"},
    )  # fmt: skip


@cache
def shell():
    return tiny_system("membrane_elasticity", "volume", "cortical_tension", cells=1, matrix=False)


def held(system, x, strength, stretch, rng):
    """Clutches of the lowest nodes at `strength`, stretched by up to `stretch` um in the plane."""
    low = lowest(system, x, 40)
    system.states.view(x, "cell1.bond_strength")[low] = strength
    system.states.view(x, "cell1.bond_stretch")[low] = stretch * rng.uniform(-1, 1, (len(low), 2))


def volume(system, x):
    nodes, faces = system.states.view(x, "cell1.position"), system.cells[0].body.membrane.triangles
    a, b, c = (nodes[faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum()) / 6.0


def a_cell_leaves_the_substrate(height, strength, seed):
    """Lifted by up to 20 um, clutches closed or open: what it loses the matrix gains, its volume is
    that of a cell alone, clutches out of reach open at their own rate, and steps converge."""
    system, rng = clutched(), np.random.default_rng(seed)
    x = system.x0.copy()
    held(system, x, strength, 0.05, rng)
    rest = volume(system, x)
    system.states.view(x, "cell1.position")[:, 2] += height
    force, places = of_bonds(system, x)
    # a clutch is spread over nodes by weights: forces balance, moments need not
    balanced(force, places, torque=False)
    t = np.array([0.0, 0.5, 1.0, 10.0])
    run = simulate(system, LinearlyImplicit(step=0.25), t, x, seed=1, auxiliaries=False)
    left = np.array([volume(system, y) for y in run.x]) / rest
    # clutches that still hold at 20 um pull with 10 nN each, which pressure has to carry
    assert np.all((left > 0.5) & (left < 1.6))
    if strength == 0.0 and height > 2.0:
        # it is alone: the same as the cell of a scene without a matrix, but for the number of
        # corrections, which the matrix has a say in
        alone = shell()
        free = simulate(alone, LinearlyImplicit(step=0.25), t, auxiliaries=False)
        assert np.abs([volume(alone, y) / rest for y in free.x] - left).max() < 2e-3
    n = np.array([system.states.view(y, "cell1.bond_strength") for y in run.x])
    assert np.all((n >= 0) & (n <= 1))
    z = np.array([system.states.view(y, "cell1.position")[:, 2] for y in run.x[1:]])
    lost = z.min(axis=0) > 3.0  # binding at 3 um: exp(-(3 - 0.9)/0.2) = 3e-5 of its rate
    if lost.any():
        # unloaded clutches open at their own rate, loaded ones faster
        rate = EFFECTS["focal_adhesion"]().off_rate
        assert np.all(n[-1, lost] <= n[0, lost] * np.exp(-t[-1] * rate) + 1e-3)
    # first order; the kink of contact is passed at some step or the next: 2 nm. Far above it is
    # the largest move that sets the steps, alike in all three runs: 0.2 % of the way
    converges(system, x, 0.25, 4.0, system.states.slice("cell1.position"), 2e-3 * (1.0 + height))


@pytest.mark.slow
def test_a_zipper_that_knows_no_reach():
    a_cell_leaves_the_substrate(20.0, 1.0, 0)
    system = clutched()
    x = system.x0.copy()
    held(system, x, 1.0, 0.0, np.random.default_rng(0))
    system.states.view(x, "cell1.position")[:, 0] += 200.0  # beside the disc: nothing in reach
    force, _ = of_bonds(system, x)
    assert not force.any()
    # naive: weights of the nodes in reach, normalised by their sum
    assert np.isnan(naive.normalised_weights(
        system.states.view(x, "cell1.position"), system.matrix.position, 3.0)).all()  # fmt: skip


def a_cell_at_the_rim(radius, angle, strength, seed):
    """Centre at 0.5 to 1.5 radii of the disc: no new bonds beyond 0.9, balance, halving."""
    system, rng = clutched(), np.random.default_rng(seed)
    x = system.x0.copy()
    nodes = system.states.view(x, "cell1.position")
    R = system.matrix.radius
    nodes[:, :2] += radius * R * np.array([np.cos(angle), np.sin(angle)]) - nodes[:, :2].mean(0)
    held(system, x, strength, 0.05 * (strength > 0), rng)
    balanced(*of_bonds(system, x), torque=False)
    out = np.hypot(nodes[:, 0], nodes[:, 1]) > 0.9 * R + 0.5
    t = np.array([0.0, 2.0, 6.0])
    run = simulate(system, LinearlyImplicit(step=0.25), t, x, seed=seed, auxiliaries=False)
    n = system.states.view(run.x[-1], "cell1.bond_strength")
    # beyond the rim bonds only open, at 1/80 1/s at least
    assert np.all(n[out] <= strength * np.exp(-t[-1] / 80.0) + 1e-12)
    clamped = np.repeat(system.matrix.clamped, 3)
    matrix = system.states.slice("matrix.displacement")
    assert not np.any(run.x[:, matrix][:, clamped])  # held nodes stay where they are, exactly
    # first order; the kinks of contact and rim are passed at some step or the next: 2 nm
    # a node that leaves the reach of the last surface node lets go at once, a step later: 10 nm
    converges(system, x, 0.25, 4.0, system.states.slice("cell1.position"), 1e-2)


LAWS = Choice("linear", "buckling", "stiffening")
CASES = (
    Case(
        "fibres of no length",
        fibres_of_no_length,
        {"law": LAWS, "share": Power(-16, -1), "count": Choice(1, 3, 10), "seed": SEED},
    ),
    Case(
        "buckled network",
        a_buckled_network_unfolds,
        {"amount": Power(-3, -0.3), "law": LAWS, "seed": SEED},
    ),
    Case(
        "floppy film",
        a_floppy_film_under_tension_is_quiet,
        {"strain": Power(-4, -1), "bump": Power(-6, -2), "step": Power(-1, 1), "seed": SEED},
    ),
    Case(
        "one bond",
        one_bond_carries_everything,
        {"stiffness": Power(1, 5), "pull": Power(-3, 0.5), "angle": Real(-1.2, 1.2)},
    ),
    Case(
        "mass rupture",
        all_bonds_break_in_one_step,
        {"pull": Real(5, 200), "count": Choice(1, 5, 20), "height": Real(0, 2)},
    ),
    Case(
        "leaving the substrate",
        a_cell_leaves_the_substrate,
        {"height": Power(-1, 1.3), "strength": Choice(0.0, 0.3, 1.0), "seed": SEED},
    ),
    Case(
        "at the rim",
        a_cell_at_the_rim,
        {"radius": Real(0.5, 1.5), "angle": Real(0, 6.28), "strength": Real(0, 1), "seed": SEED},
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 3)
