"""The 1-D crawler: equations against hand-coded rates and its bond graph, switching, outcomes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from cellsys.errors import DimensionError, ParameterError, SceneError
from cellsys.geometry.chain import Chain
from cellsys.integrate import DOP853, LSODA, Radau, simulate
from cellsys.mechanics.crawler import Crawler, build_crawlers
from cellsys.mechanics.crawler_run import crawl
from tests.mechanics.crawler_graph import crawler_graph, graph_state
from tests.naive import fixed_step_crawler

LEAD, TRAIL = "lead", "trail breaks"


def random_state(system, rng, size=0.2):
    """A consistent state: nodes on straight lines between the attached ones."""
    K, N, a = len(system.cells), system.chain.nodes, system.chain.spacing
    x = system.x0.copy()
    x[: 8 * K] += size * rng.standard_normal(8 * K)
    held, at = [0], [0.0]
    pairs = []
    for k, cell in enumerate(system.cells):
        b = 8 * k
        x[b + 6] = cell.heading * (x[b + 5] - x[b + 4])
        x[b + 7] = cell.heading * (x[b] - x[b + 1])
        i_lead, i_trail = x[8 * K + N + 2 * k : 8 * K + N + 2 * k + 2]
        pairs += [(i_trail, x[b + 4] - a * i_trail), (i_lead, x[b + 5] - a * i_lead)]
    for i, u in sorted(pairs):
        held.append(i)
        at.append(u)
    x[8 * K : 8 * K + N] = np.interp(np.arange(1, N + 1), [*held, N + 1], [*at, 0.0])
    return x


def hand_rates(system, x):
    """dx/dt by force balance, node by node, in plain numpy: no W, no eta."""
    K, N, ch = len(system.cells), system.chain.nodes, system.chain
    u = np.concatenate([[0.0], x[8 * K : 8 * K + N], [0.0]])
    held = x[8 * K + N :].astype(int)
    stops = sorted([0, N + 1, *held])
    tension = np.zeros(N + 1)  # of the spring between node i and i + 1
    for left, right in itertools.pairwise(stops):
        strain = (u[right] - u[left]) / ((right - left) * ch.spacing)
        tension[left:right] = ch.stiffness * (strain + ch.stiffening * strain**3)
    v = np.zeros(N + 2)
    out = np.zeros_like(x)
    for k, c in enumerate(system.cells):
        b, h = 8 * k, c.heading
        lead, trail, p_lead, p_trail = x[b : b + 4]
        i_lead, i_trail = held[2 * k], held[2 * k + 1]
        at_lead, at_trail = ch.spacing * i_lead + u[i_lead], ch.spacing * i_trail + u[i_trail]
        v_lead, v_trail = p_lead / c.mass, p_trail / c.mass
        s = h * (lead - trail) - c.length
        cell = c.stiffness * s + c.stiffness3 * s**3 + c.damping * h * (v_lead - v_trail)
        pull_lead, pull_trail = (
            c.adhesion_lead * (at_lead - lead),
            c.adhesion_trail * (at_trail - trail),
        )
        v[i_lead] = (tension[i_lead] - tension[i_lead - 1] - pull_lead) / ch.drag
        v[i_trail] = (tension[i_trail] - tension[i_trail - 1] - pull_trail) / ch.drag
        out[b : b + 8] = [
            v_lead, v_trail,
            -h * cell + pull_lead - c.drag * v_lead - c.drag2 * v_lead * abs(v_lead),
            h * cell + pull_trail - c.drag * v_trail - c.drag2 * v_trail * abs(v_trail),
            v[i_trail], v[i_lead], h * (v[i_lead] - v[i_trail]), h * (v_lead - v_trail),
        ]  # fmt: skip
    out[8 * K : 8 * K + N] = np.interp(np.arange(1, N + 1), stops, v[stops])
    return out


CASES = {
    "one": (Crawler(),),
    "left-mover": (Crawler(heading=-1, trail_node=30, lead_node=26),),
    "two": (Crawler(), Crawler(heading=-1, trail_node=37, lead_node=33)),
}


@pytest.mark.parametrize("name", CASES)
def test_W_eta_equals_hand_coded_rates(name):
    """1000 random states; rates reach 20 pN and 40 um/s: rounding of their sums is 1e-14."""
    system = build_crawlers(CASES[name])
    rng = np.random.default_rng(5)
    worst = 0.0
    for _ in range(1000):
        x = random_state(system, rng)
        expected = hand_rates(system, x)
        scale = 1.0 + np.abs(expected).max()
        by_W = system.W_x @ x + system.W_eta @ system.eta(0.0, x) + system.u(0.0, x)
        worst = max(worst, np.abs(by_W - expected).max() / scale)
        worst = max(worst, np.abs(system.rhs(0.0, x) - expected).max() / scale)
    assert worst < 1e-13


def test_W_is_constant_with_simple_entries():
    """48 x 50 and of rank 46: d_ecm and d_cell repeat others [notes: theory, crawler]."""
    system = build_crawlers([Crawler()])
    W = system.W_eta.toarray()
    assert set(np.unique(W)) == {0.0, 1.0, -1.0, -system.chain.drag}
    assert W[:48].shape == (48, 50)
    assert np.linalg.matrix_rank(W[:48]) == 46


def test_bond_graph_gives_the_same_rates():
    cell, chain = Crawler(), Chain()
    system = build_crawlers([cell], chain)
    literal = crawler_graph(cell, chain).equations(literal=True)
    assert literal.W_eta.shape == (8, 13)
    assert set(literal.W_eta.data) == {1.0, -1.0}
    plain = crawler_graph(cell, chain).equations()
    rng = np.random.default_rng(6)
    for _ in range(200):
        x = random_state(system, rng)
        d = system.rhs(0.0, x)
        expected = np.array([d[3], d[2], d[7], d[1] - d[4], d[5] - d[0], d[4], d[5] - d[4], -d[5]])
        for equations in (literal, plain):
            got = equations.system.rhs(0.0, graph_state(cell, chain, x))
            np.testing.assert_allclose(got, expected, rtol=0, atol=1e-13 * (1 + np.abs(d).max()))
    power = plain.power(0.0, graph_state(cell, chain, x))
    assert abs(power["storage"] + power["dissipation"]) < 1e-12 * (1 + power["dissipation"])


@pytest.fixture(scope="module")
def reference():
    """The run of the working set at 1e-12 [notes: measurements, crawler]."""
    return simulate(
        build_crawlers([Crawler()]), DOP853(rtol=1e-12, atol=1e-13), np.linspace(0, 28, 281),
        auxiliaries=False,
    )  # fmt: skip


def test_sixty_switches(reference):
    times = np.array([e.time for e in reference.events])
    assert np.sum(times <= 20) == 45  # 44 and the lead's re-grab at once, at t = 0
    assert times.size == 63
    assert sum(e.name.endswith(TRAIL) for e in reference.events) == 31
    lead = reference.block("cell1.lead")
    assert lead[0] == 8.0
    assert 21 < lead[200] - lead[0] < 23  # travels 22 spacings in 20 s


def test_switch_times_within_1e_7(reference):
    run = simulate(
        build_crawlers([Crawler()]), DOP853(rtol=1e-10, atol=1e-12), np.linspace(0, 28, 29)
    )
    times = [np.array([e.time for e in r.events]) for r in (run, reference)]
    assert [e.name for e in run.events] == [e.name for e in reference.events]
    # 62 switches amplify 1e-10 per step by about 100.
    assert np.abs(times[0] - times[1]).max() <= 1e-7


def test_sixty_switches_by_an_explicit_method():
    system, method = build_crawlers([Crawler()]), DOP853(rtol=1e-8, atol=1e-10)
    run = simulate(system, method, np.linspace(0, 28, 281))
    assert len(run.events) >= 60


def test_fixed_steps_are_first_order_and_miscount(reference):
    """The naive version: end-of-step switching. Its error falls only like the step."""
    system = build_crawlers([Crawler()])
    exact = [e for e in reference.events if 0 < e.time <= 10]
    errors = []
    steps = (0.02, 0.005, 0.00125)
    for step in steps:
        found = [s for s in fixed_step_crawler(system, 10.0, step) if s[0] > step]
        assert len(found) == len(exact)
        errors.append(max(abs(a[0] - b.time) for a, b in zip(found, exact, strict=True)))
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 0.6 < slope < 1.5, errors
    assert errors[-1] > 1e-3  # after 8000 steps; root finding at rtol 1e-6 needs 300
    coarse = [s for s in fixed_step_crawler(system, 28.0, 0.01) if s[0] > 0.01]
    assert len(coarse) != sum(e.time > 0 for e in reference.events)


@pytest.mark.parametrize("method", [DOP853, LSODA, Radau])
def test_energy_balance_between_switches(method):
    """H(t) + dissipated energy is constant up to the first switch, to the tolerance."""
    system = build_crawlers([Crawler(lead=7.4)])
    end = simulate(system, method(rtol=1e-4, atol=1e-6), [0.0, 2.0]).events[0].time
    rtol = 1e-9
    nodes, weights = np.polynomial.legendre.leggauss(40)
    t = np.concatenate([[0.0], 0.5 * 0.95 * end * (1 + nodes), [0.95 * end]])
    run = simulate(system, method(rtol=rtol, atol=1e-11), t)
    assert not run.events
    lost = 0.5 * 0.95 * end * np.dot(weights, [system.dissipation(x) for x in run.x[1:-1]])
    H = system.energy(run.x[0]), system.energy(run.x[-1])
    # Three hundred tolerances: LSODA's global error over the fast start.
    assert abs(H[0] - H[1] - lost) < 300 * rtol * H[0]


def test_reset_keeps_momentum_and_moves_only_the_attachment():
    system = build_crawlers([Crawler()])
    x = random_state(system, np.random.default_rng(7))
    lead = system.events()[0]
    after = lead.reset(0.0, x)
    N = system.chain.nodes
    np.testing.assert_array_equal(after[:5], x[:5])
    assert after[8 + N] == x[8 + N] + 1
    assert after[5] == pytest.approx(9 + x[8 + 8], abs=1e-14)  # node 9 where it was
    stops = [0, after[8 + N + 1], after[8 + N], N + 1]
    u = [0, after[4] - stops[1], after[5] - stops[2], 0]
    np.testing.assert_allclose(
        after[8 : 8 + N], np.interp(np.arange(1, N + 1), stops, u), atol=1e-14
    )


@pytest.mark.parametrize("name", CASES)
def test_guards_are_the_adhesion_stretches(name):
    """Distance of the lead's stretch to `grab`, of `rupture` to the trail's; 1 where blocked."""
    system = build_crawlers(CASES[name])
    x = random_state(system, np.random.default_rng(9))
    for k, cell in enumerate(system.cells):
        lead, trail, _, _, ecm1, ecm2 = x[8 * k : 8 * k + 6]
        guards = [e.guard(0.0, x) for e in system.events() if e.name.startswith(f"cell{k + 1} ")]
        h = cell.heading
        expected = [h * (ecm2 - lead) - cell.grab, cell.rupture - h * (trail - ecm1)]
        np.testing.assert_allclose(guards, expected, atol=1e-15)
    start = 8 * len(system.cells) + system.chain.nodes
    blocked = x.copy()
    blocked[start] = blocked[start + 1] + system.cells[0].heading  # trail right behind the lead
    assert system.events()[1].guard(0.0, blocked) == 1.0
    blocked[start] = 40 if system.cells[0].heading > 0 else 1
    assert system.events()[0].guard(0.0, blocked) == 1.0


@pytest.mark.slow
def test_stiff_chain_drag_wants_an_implicit_method():
    """b_E = 0.005: LSODA takes a small share of DOP853's evaluations, and agrees to 1e-5."""
    system = build_crawlers([Crawler()], Chain(drag=0.005))
    t = np.linspace(0, 6, 7)
    runs = [simulate(system, m(rtol=1e-8, atol=1e-10), t) for m in (LSODA, DOP853)]
    times = [np.array([e.time for e in r.events]) for r in runs]
    np.testing.assert_allclose(times[0], times[1], atol=1e-5)
    assert runs[0].statistics["rhs"] < 0.2 * runs[1].statistics["rhs"]


@pytest.mark.slow
def test_outcomes_have_a_reason():
    method = LSODA(rtol=1e-7, atol=1e-9)
    t = np.linspace(0, 20, 41)
    run = crawl(build_crawlers([Crawler()]), method, t)
    assert run.outcome == "finished"
    assert run.switches(TRAIL).size == 22
    assert run.chatter == 0
    soft = crawl(build_crawlers([Crawler()], Chain(stiffness=3.0)), method, t)
    assert soft.outcome == "stalled"
    assert "lead adhesion stays stretched" in soft.reason
    ends = crawl(build_crawlers([Crawler()]), method, np.linspace(0, 60, 61))
    assert "its lead holds the last node of the chain" in ends.reason
    chatty = crawl(build_crawlers([Crawler(grab=0.8, rupture=0.05)]), method, t)
    assert chatty.chatter > 0 or chatty.trajectory.statistics["shortest_interval"] < 0.02
    stopped = crawl(build_crawlers([Crawler()]), DOP853(rtol=1e-7, atol=1e-9, max_steps=50), t)
    assert stopped.outcome == "stopped"
    assert "spent its 50 steps" in str(stopped)


def test_two_cells_meet_and_block_each_other():
    system = build_crawlers(CASES["two"])
    run = crawl(system, DOP853(rtol=1e-8, atol=1e-10), np.linspace(0, 20, 201))
    lead = [run.trajectory.block(f"cell{k}.lead") for k in (1, 2)]
    assert lead[0][0] == 8.0
    assert lead[1][0] == 33.0
    gap = lead[1] - lead[0]
    assert gap[0] == 25.0
    assert 0.5 < gap[-1] < 4.0
    held = np.asarray(run.trajectory.x)[:, -4:]
    assert np.all(held[:, 0] < held[:, 2])  # leads never pass
    assert run.outcome == "stalled"
    assert "holds the node ahead of its lead" in run.reason
    assert run.chatter == 0  # mirror images switch together: no chatter


def test_mirror_image():
    """A left-mover's run is the mirror image of a right-mover's."""
    t = np.linspace(0, 8, 81)
    method = DOP853(rtol=1e-9, atol=1e-11)
    right = simulate(build_crawlers([Crawler()]), method, t)
    left = simulate(build_crawlers([Crawler(heading=-1, trail_node=37, lead_node=33)]), method, t)
    np.testing.assert_allclose(
        41.0 - left.block("cell1.lead"), right.block("cell1.lead"), atol=1e-6
    )
    assert len(right.events) == len(left.events)


def random_crawler(rng):
    def log(low, high):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    cell = Crawler(
        mass=log(0.02, 2), drag=log(0.05, 5), drag2=log(0.01, 1), stiffness=log(0.2, 20),
        stiffness3=log(0.01, 5), damping=log(0.01, 5), length=rng.uniform(1, 8),
        adhesion_trail=log(0.5, 60), adhesion_lead=log(0.5, 60), grab=rng.uniform(-0.2, 1.0),
        rupture=rng.uniform(0.0, 1.0), trail_node=4, lead_node=int(rng.integers(5, 12)),
    )  # fmt: skip
    return cell, Chain(stiffness=log(3, 1000), stiffening=log(0.1, 100), drag=log(0.005, 5))


def outcomes(n, seed):
    rng = np.random.default_rng(seed)
    found = {"finished": 0, "stalled": 0, "stopped": 0}
    for _ in range(n):
        cell, chain = random_crawler(rng)
        method = LSODA(rtol=1e-6, atol=1e-8, max_steps=60_000)
        run = crawl(build_crawlers([cell], chain), method, np.linspace(0, 10, 11))
        found[run.outcome] += 1
        assert (run.outcome == "finished") == (run.reason == "")
        if run.trajectory is not None:
            assert np.all(np.isfinite(run.trajectory.x))
    return found


@pytest.mark.slow
def test_random_parameters_finish_stall_or_stop_with_a_reason():
    found = outcomes(60, 1)
    assert found["finished"] > 0
    assert found["stalled"] > 0


@pytest.mark.slow
def test_twenty_other_random_parameter_sets():
    """The family "crawlers" of `python -m tests.hard` goes on from here."""
    found = outcomes(20, 2)
    assert sum(found.values()) == 20


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: Crawler(mass=0.0), ParameterError, "mass must be > 0"),
        (lambda: Crawler(grab=np.nan), ParameterError, "grab must be finite"),
        (lambda: Crawler(heading=2), ParameterError, "heading must be 1 or -1"),
        (lambda: Crawler(lead_node=3), ParameterError, "must lie ahead"),
        (lambda: Chain(nodes=1), ParameterError, "nodes must be"),
        (lambda: Chain(drag=-1.0), ParameterError, "drag must be > 0"),
        (lambda: build_crawlers([]), SceneError, "at least one cell"),
        (lambda: build_crawlers([Crawler(lead_node=60)]), SceneError, "chain.s nodes 1..40"),
        (
            lambda: build_crawlers([Crawler(), Crawler(trail_node=7, lead_node=12)]),
            SceneError,
            "overlap on nodes 7..8",
        ),
        (lambda: Chain().displacement(np.zeros(7)), DimensionError, "40 nodes"),
    ],
)
def test_bad_input(make, error, words):
    with pytest.raises(error, match=words):
        make()


def test_green_function_inverts_the_linear_chain():
    chain = Chain(stiffening=0.0)
    loads = np.random.default_rng(8).standard_normal((5, 40))
    np.testing.assert_allclose(chain.loads(chain.displacement(loads)), loads, atol=1e-11)
