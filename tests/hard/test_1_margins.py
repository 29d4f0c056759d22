"""Margins: DC gain near one, the boundary itself, delays, near cancellations, close loci."""

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.response import margins
from tests import naive
from tests.hard.margin_oracle import Plant, compare
from tests.hard.stress import SEED, Case, hold


def turned(rng, *parts):
    """The same system in random orthogonal coordinates, half of the time."""
    A, B, C, D, *rest = parts
    if rng.random() < 0.5 and len(A):
        Q = np.linalg.qr(rng.standard_normal(A.shape))[0]
        A, B, C = Q.T @ A @ Q, Q.T @ B, C @ Q
    return A, B, C, D, *rest


def series(one, two):
    """two after one."""
    A = np.block([[one[0], np.zeros((len(one[0]), len(two[0])))], [two[1] @ one[2], two[0]]])
    B, C = np.vstack([one[1], two[1] @ one[3]]), np.hstack([two[3] @ one[2], two[2]])
    return A, B, C, two[3] @ one[3]


def second_order(pole, zero):
    """(s^2 + 2 a s + b^2)/(s^2 + 2 c s + d^2) with (a, b) the zeros', (c, d) the poles'."""
    (a, b), (c, d) = zero, pole
    A = np.array([[0.0, 1.0], [-d * d, -2 * c]])
    return A, np.array([[0.0], [1.0]]), np.array([[b * b - d * d, 2 * (a - c)]]), np.eye(1)


def random_system(rng, n, q, spread=1.0):
    """Poles of either sign (mostly stable), rates over `spread`."""
    A = rng.standard_normal((n, n)) - rng.uniform(0, 2) * np.eye(n)
    A = A * spread ** rng.uniform(-0.5, 0.5, n)[:, None]
    gain = 10.0 ** rng.uniform(-1, 1.5)
    return A, rng.standard_normal((n, q)), gain * rng.standard_normal((q, n)), np.zeros((q, q))


def sampled(A, B, C, D, dt):
    """Zero-order hold."""
    n, m = B.shape
    F = sla.expm(np.block([[A, B], [np.zeros((m, n + m))]]) * dt)
    return F[:n, :n], F[:n, n:], C, D, dt


def dc_gain_near_one(rng):
    """|lambda(L(0))| within 1e-3 to 1e-9 of 1, on either side, of either sign."""
    n, q = int(rng.integers(1, 5)), int(rng.choice([1, 1, 2]))
    A, B, C, D = random_system(rng, n, q)
    if rng.random() < 0.3:
        A, B, C, D, dt = sampled(A, B, C, D, 0.3)
    else:
        dt = 0.0
    low = np.abs(np.linalg.eigvals(C @ np.linalg.solve((1.0 if dt else 0.0) * np.eye(n) - A, B)))
    low = low[low > 1e-6 * low.max()]
    one = 1 + rng.choice([-1, 1]) * 10.0 ** rng.uniform(-9, -3) * (rng.random() < 0.95)
    return A, B, C * one / rng.choice(low) * rng.choice([-1, 1]), D, dt


def on_the_circle(rng):
    """The same in discrete time: poles or zeros at exp(+-j theta), at 1 and at -1."""
    a, b = rng.uniform(0.1, 3.0, 2)
    inside = rng.uniform(0.3, 0.99)
    kind = rng.integers(3)
    pole, zero = [(1.0, a), (inside, b)][:: 1 if kind else -1]
    (r, p), (s, z) = pole, zero  # z^2 - 2 s cos(z) z + s^2 over the same of r, p
    if kind == 2:
        p, z = 0.0 if rng.random() < 0.5 else np.pi, b
    A = np.array([[0.0, 1.0], [-r * r, 2 * r * np.cos(p)]])
    C = np.array([[s * s - r * r, 2 * (r * np.cos(p) - s * np.cos(z))]])
    lag = (np.array([[rng.uniform(-0.9, 0.9)]]), np.eye(1), np.eye(1) * rng.normal(0, 1), 0)
    lag = (*lag[:3], np.array([[rng.choice([0.0, rng.normal()])]]))
    return *turned(rng, *series((A, np.array([[0.0], [1.0]]), C, np.eye(1)), lag)), 0.1


def on_the_boundary(rng):
    """Undamped poles and zeros, integrators, chains of two, a zero at 0; in discrete time too."""
    w, z = 10.0 ** rng.uniform(-1, 1, 2)
    kind = rng.integers(7)
    if kind == 0:  # undamped poles, rotating 2 x 2
        J = np.array([[0.0, 1.0], [-1.0, 0.0]])
        C = rng.standard_normal() * np.eye(2) + 10.0 ** rng.uniform(-1, 1) * J
        return w * J, np.eye(2), C, np.zeros((2, 2)), 0.0
    if kind == 1:
        return on_the_circle(rng)
    if kind == 2:  # two integrators in each of two channels, damped by their rates
        A = np.kron(np.eye(2), np.array([[0.0, 1.0], [0.0, 0.0]]))
        C = np.kron(rng.standard_normal((2, 2)), [[1.0, w]])
        return *turned(rng, A, np.kron(np.eye(2), [[0.0], [1.0]]), C, np.zeros((2, 2))), 0.0
    lag = (-np.eye(1) * 10.0 ** rng.uniform(-1, 1), np.eye(1), np.eye(1) * rng.normal(0, 3), 0)
    lag = (*lag[:3], np.array([[rng.choice([0.0, 1.0])]]))
    if kind == 3:
        middle = second_order((0.0, w), (10.0 ** rng.uniform(-2, 0), z))
    elif kind == 4:
        middle = second_order((10.0 ** rng.uniform(-2, 0), w), (0.0, z))
    elif kind == 5:
        middle = (np.zeros((1, 1)), np.eye(1), np.eye(1), np.zeros((1, 1)))
        lag = series(lag, (-np.eye(1), np.eye(1), np.eye(1) * w, np.eye(1)))
    else:  # s/(s + w)
        middle = (-w * np.eye(1), np.eye(1), -w * np.eye(1), np.eye(1))
    return *turned(rng, *series(middle, lag)), 0.0


def delays(rng):
    """A sampled lag or two after 1 to 10 samples of delay: as many poles at z = 0."""
    d, q = int(rng.integers(1, 11)), int(rng.choice([1, 1, 1, 1, 2]))
    n = int(rng.integers(1, 3))
    A, B, C, D = random_system(rng, n, q)
    A = A - max(np.linalg.eigvals(A).real.max() + 0.05, 0) * np.eye(n)
    dt = 10.0 ** rng.uniform(-2, 0.5)
    A, B, C, D, dt = sampled(A, B, C, D, dt)
    I = np.eye(q)  # noqa: E741
    shift = (np.kron(np.eye(d, k=-1), I), np.kron(np.eye(d, 1), I), np.kron(np.eye(1, d, d - 1), I))
    return *series((*shift, 0 * I), (A, B, C, D)), dt, Plant(A, B, C, D, dt), d


def near_cancellations(rng):
    """A pole and a zero next to each other and to the axis, beside a lag of any gain."""
    w, gap = 10.0 ** rng.uniform(-1, 1), 10.0 ** rng.uniform(-7, -1)
    damping = 10.0 ** rng.uniform(-6, -1)
    pole = (damping * w, w)
    zero = (damping * w * (1 + rng.uniform(-1, 1)), w * (1 + gap * rng.choice([-1, 1])))
    n = int(rng.integers(1, 3))
    return *turned(rng, *series(second_order(pole, zero), random_system(rng, n, 1))), 0.0


def close_loci(rng):
    """Two loci that differ by 1e-1 to 1e-8, in coordinates up to 1e3 from orthogonal; channels in
    a ring, whose loci are turned copies of one."""
    n, gap = int(rng.integers(1, 4)), 10.0 ** rng.uniform(-8, -1)
    A, B, C, _ = random_system(rng, n, 1)
    d = float(rng.choice([0.0, 0.0, rng.normal()]))
    if rng.random() < 0.2:
        q = int(rng.integers(2, 5))
        ring = np.roll(np.eye(q), 1, axis=0)
        I = np.eye(q)  # noqa: E741
        return np.kron(A, I), np.kron(B, I), np.kron(C, ring), d * ring, 0.0
    T = np.linalg.qr(rng.standard_normal((2, 2)))[0] @ np.diag([1.0, 10.0 ** rng.uniform(0, 3)])
    if rng.random() < 0.5:  # a + j b, a - j b with a small b
        T, C2 = np.eye(2), np.kron(C, np.eye(2)) + gap * np.kron(C, [[0.0, -1.0], [1.0, 0.0]])
        return np.kron(A, np.eye(2)), np.kron(B, np.eye(2)), C2, d * np.eye(2), 0.0
    loops = np.diag([1.0, 1.0 + gap])
    return (np.kron(A, np.eye(2)), np.kron(B, np.linalg.inv(T)), T @ np.kron(C, loops) @ np.eye(
        2 * n), d * np.eye(2), 0.0)  # fmt: skip


def anything(rng):
    """Random loops of one to three channels, with and without D, rates up to 1e6 apart."""
    n, q = int(rng.integers(1, 6)), int(rng.choice([1, 1, 1, 2, 3]))
    n = int(rng.integers(6, 25)) if rng.random() < 0.03 else n
    A, B, C, D = random_system(rng, n, q, spread=10.0 ** rng.choice([0, 0, 3, 6]))
    if rng.random() < 0.3:
        D = rng.normal(0, 1, (q, q))
    if rng.random() < 0.3:
        rate = np.abs(np.linalg.eigvals(A)).max()
        A, B, C, D, dt = sampled(A, B, C, D, 0.5 / rate)
        return A, B, C, D, dt
    return A, B, C, D, 0.0


FAMILIES = {
    "DC gain near one": dc_gain_near_one,
    "poles, zeros on the boundary": on_the_boundary,
    "delays (poles at z = 0)": delays,
    "near cancellations": near_cancellations,
    "close loci": close_loci,
    "any loop": anything,
}


def agree(family, seed):
    """Margins of one random loop against the oracle."""
    loop = FAMILIES[family](np.random.default_rng(seed))
    compare(Plant(*loop), margins(loop[:5]))


def check_of(family):
    """The check of one family, with its seed as its only parameter."""

    def check(seed):
        agree(family, seed)

    return check


CASES = tuple(Case(name, check_of(name), {"seed": SEED}, oracle=True) for name in FAMILIES)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_loops(case):
    hold(case, 12)


@pytest.mark.parametrize("family", FAMILIES)
def test_naive_margins_fail_in_every_family(family):
    # naive: changes of sign between neighbours of a grid, none below it and a pole is one
    for seed in range(20):
        loop = FAMILIES[family](np.random.default_rng(seed))
        found = margins(loop[:5])
        gain, phase, _ = naive.grid_margins(*loop[:5])
        right = (found.gain_margin, abs(found.phase_margin))
        if not np.allclose((gain, abs(phase)), right, rtol=0.1):
            compare(Plant(*loop), found)
            return
    pytest.fail(f"the naive margins hold in twenty loops of {family}")
