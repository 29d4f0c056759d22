"""Runs of coupled cells: closed forms, dense simulation, order of convergence, growth."""

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.errors import IntegrationError, MemoryBudgetError, ParameterError
from cellsys.integrate import DOP853, Exponential, Splitting, simulate
from cellsys.laws.polarity import exact_step, exact_steps
from cellsys.loop import AntiparallelTurn, PolarityLaw
from cellsys.model import LatentModel
from cellsys.population import (
    Feedback,
    InteractionGraph,
    MappedSuperposition,
    P_phi,
    Superposition,
    couple,
)
from tests.naive import kronecker_coupling
from tests.population.systems import match, model

TIGHT = DOP853(rtol=1e-11, atol=1e-11)


def through_system(cells, t, integrator=TIGHT):
    """The same run by an integrator of the whole system: (z, p)."""
    run = simulate(cells.system, integrator, t, auxiliaries=False)
    K, m = cells.n_cells, cells.order
    read = cells.system.whole.read
    z = np.array([read(row[: K * m].reshape(K, m)) for row in run.x])
    return z, run.p


def test_vectorised_polarity_step_is_the_exact_one():
    rng = np.random.default_rng(0)
    p, d = rng.standard_normal((2, 50, 3))
    d[0], p[1], d[2] = 0.0, 0.0, -3.0 * p[2]
    many = exact_steps(p, d, 0.3, 2.0)
    single = np.array([exact_step(a, b, 0.3, 2.0) for a, b in zip(p, d, strict=True)])
    # the same operations, summed in another order
    assert np.abs(many - single).max() < 1e-14
    assert np.array_equal(many[:2], p[:2])


def test_emergent_states_of_superposition_are_N_times_isolated_ones():
    """[34-35] couple no dynamics: z_em(t) = N z(t) + (w 1) (x) V_phi^T mean(phi)."""
    m = model(m=5, centred=True, seed=2)
    t = np.linspace(0, 200, 5)
    z0 = np.random.default_rng(0).standard_normal((4, 5))
    run = couple(m, 4).simulate(t, z0=z0)
    isolated = np.array([m.predict(z, None, t) for z in z0]).transpose(1, 0, 2)
    P = P_phi(m)
    mean = m.V[m.blocks["field"]].T @ m.mean[m.blocks["field"]]
    others = isolated.sum(axis=1, keepdims=True) - isolated
    expected = isolated + others @ P + 3 * mean
    assert np.abs(run.block("z") - expected).max() < 1e-11 * np.abs(expected).max()
    # naive: without the mean field of the neighbours the run is off by it
    assert np.abs(run.block("z") - (expected - 3 * mean)).max() > 0.1


@pytest.mark.parametrize("q", [0, 2])
def test_closed_form_over_a_million_seconds(q):
    """Zero poles (purely matrix directions, an integrator in A) and offsets included."""
    rng = np.random.default_rng(q)
    m_ = 5
    gap = [*np.linspace(0.9, 0.3, m_ - q), *np.zeros(q)]
    A = np.zeros((m_, m_))
    A[1:, 1:] = -np.diag([1e-6, 1e-3, 0.02, 0.3])
    A[1, 2] = 0.01 if q == 0 else 0.0  # symmetric: its compressions are stable too
    b = np.array([1e-4, 0.01, 0.1, 0.2, -0.3])
    T = sla.qr(rng.standard_normal((m_, m_)))[0]
    base = model(m=m_, gap=gap, seed=q, centred=True)
    m = LatentModel(
        A=T @ A @ T.T,
        offset=T @ b,
        V=base.V,
        mean=base.mean,
        blocks=base.blocks,
        z_start=base.z_start,
    )
    K, t = 3, np.array([0.0, 1e3, 3e4, 1e6])
    z0 = rng.standard_normal((K, m_))
    run = couple(m, K).simulate(t, z0=z0)
    P = P_phi(m)
    mean = m.V[m.blocks["field"]].T @ m.mean[m.blocks["field"]]
    # mean of the cells: N_mean times an isolated one; differences: the free motion of the
    # compression C of A to the range U of I - P, and nothing along purely matrix directions
    level, U = sla.eigh(np.eye(m_) - P)
    level, U = level[q:], U[:, q:]
    rates, modes = sla.eigh(U.T @ m.A @ U) if q else (None, None)
    for k, time in enumerate(t):
        if q == 0:
            z = np.array([T @ _closed(A, b, T.T @ z, time) for z in z0])
            expected = z + (z.sum(axis=0) - z) @ P
        else:
            middle = T @ _closed(A, b, T.T @ z0.mean(axis=0), time)
            free = ((z0 - z0.mean(axis=0)) @ U @ modes) * np.exp(rates * time)
            expected = middle + (K - 1) * P @ middle + (free @ modes.T * level) @ U.T
        expected = expected + (K - 1) * mean
        # a stored A is singular to eps |A| only, which t = 1e6 s turns into 1e-10
        error = np.abs(run.block("z")[k] - expected).max()
        assert error < 1e-9 * np.abs(expected).max()


def _closed(A, b, z, t):
    """z(t) of z' = A z + b with A upper triangular, an exact zero first, by back substitution."""
    import mpmath as mp

    with mp.workdps(60):
        n = len(A)
        whole = mp.zeros(n + 1)
        for i in range(n):
            for j in range(n):
                whole[i, j] = mp.mpf(A[i, j]) * t
            whole[i, n] = mp.mpf(b[i]) * t
        values, vectors = mp.eig(whole[1:, 1:])  # without the integrator: distinct eigenvalues
        start = mp.matrix([*z[1:].tolist(), 1.0])
        moved = vectors * mp.diag([mp.exp(v) for v in values]) * (mp.inverse(vectors) * start)
        rest = [float(mp.re(v)) for v in moved[: n - 1]]
    return np.array([z[0] + b[0] * t, *rest])  # the integrator: a ramp


def test_modal_run_equals_dense_run():
    """Each cell its own polarity and sensor, centred basis, all forms and both splits."""
    m = model(m=4, steered=True, centred=True, seed=1)
    t, angles = np.linspace(0, 120, 7), np.array([0.0, 1.0, 2.5, -2.0])
    P_map = -0.2 * np.eye(4)
    graph = InteractionGraph.attenuated(np.random.default_rng(0).uniform(0, 40, (4, 2)), 10.0)
    for form in (Superposition(), MappedSuperposition(P_map=P_map), Feedback()):
        for g in (None, graph):
            cells = couple(m, 4, form, headings=angles, graph=g)
            run = cells.simulate(t, Exponential(rtol=1e-9, atol=1e-9))
            z, p = through_system(cells, t)
            size = np.abs(z).max()
            # rtol per step 1e-9, some tens of steps, feedback through the heading
            assert np.abs(run.block("z") - z).max() < 1e-7 * size, (form.name, g)
            assert np.abs(run.p - p).max() < 1e-7
            assert np.abs(np.linalg.norm(run.p, axis=2) - 1).max() < 1e-13
    # and the system itself is the Kronecker assembly
    cells = couple(m, 4, MappedSuperposition(P_map=P_map), headings=angles)
    whole, z = cells.system.whole, np.random.default_rng(1).standard_normal((4, 4))
    c = np.zeros((4, 4))
    x = whole.start(z)
    M = kronecker_coupling("Mapped", m.A, P_phi(m), 4, np.eye(4) + P_map)
    free = whole.read(whole.rate(x, c)) - whole.read(whole.rate(0 * x, c))
    emergent = (whole.read(x) - whole.offset).ravel()
    assert np.abs(free.ravel() - M @ emergent).max() < 1e-11 * np.abs(M @ emergent).max()


def test_one_cell_is_the_closed_loop():
    from cellsys.loop import closed_loop

    m = model(m=4, steered=True, seed=1)
    t = np.linspace(0, 300, 7)
    run = couple(m, 1, headings=[0.7]).simulate(t, Exponential(rtol=1e-10, atol=1e-10))
    loop = closed_loop(m, p0=np.array([np.cos(0.7), np.sin(0.7), 0.0]))
    single = simulate(loop.system, TIGHT, t, auxiliaries=False)
    assert np.abs(run.block("z")[:, 0] - single.x[:, :4]).max() < 1e-8 * np.abs(single.x).max()
    assert np.abs(run.p[:, 0] - single.x[:, 4:]).max() < 1e-8


def test_order_of_the_extrapolated_splitting():
    # raw d: a normalised one turns fast where it passes zero, and no step then is small
    cells = couple(model(m=4, steered=True, seed=1), 3, headings=[0.0, 1.0, 2.0], normalise=False)
    t = np.array([0.0, 80.0])
    exact = cells.simulate(t, Exponential(rtol=1e-13, atol=1e-13)).x[-1]
    error = [np.abs(cells.simulate(t, Splitting(step=h)).x[-1] - exact).max() for h in (5.0, 2.5)]
    assert 40 < error[0] / error[1] < 110  # order 6: 64


def test_tolerance_is_met():
    cells = couple(model(m=4, steered=True, seed=1), 3, headings=[0.0, 1.0, 2.0])
    t = np.linspace(0, 200, 3)
    exact = cells.simulate(t, TIGHT).x
    for tol in (1e-4, 1e-6, 1e-8):
        run = cells.simulate(t, Exponential(rtol=tol, atol=tol))
        # error per step, added up over the run's memory of a few steps
        assert np.abs(run.x - exact).max() < 30 * tol * np.abs(exact).max()


def test_unstable_cells_are_reported_with_their_growth_rate():
    steered = model(m=6, steered=True, seed=0)
    for m, integrator in ((model(m=6, seed=0), None), (steered, Exponential(rtol=1e-6, atol=1e-6))):
        cells = couple(m, 5, Feedback())
        rate = cells.stability().spectral_abscissa
        assert rate > 0.02
        z0 = np.random.default_rng(0).standard_normal((5, 6))
        for t in (np.linspace(0, 1e5, 11), np.array([0.0, 1e6])):
            with pytest.raises(IntegrationError, match=f"grows at {rate:.6g} 1/s"):
                cells.simulate(t, integrator, z0=z0)


def test_matrix_free_runs():
    """Weights that are not symmetric, above the dense limit: the integrator works on the whole."""
    m = model(m=4, steered=True, seed=1)
    rng = np.random.default_rng(0)
    w = rng.uniform(0, 1.0, (12, 12)) * 0.05
    np.fill_diagonal(w, 0.0)
    t = np.array([0.0, 40.0])
    for form in (Superposition(), Feedback(), MappedSuperposition(P_map=-0.3 * np.eye(4))):
        cells = couple(m, graph=w, coupling=form, headings=rng.uniform(0, 6, 12))
        dense = cells.simulate(t, TIGHT)
        free = couple(m, graph=w, coupling=form, headings=cells.headings)
        free.__dict__["route"] = "matrix-free: forced by the test"
        other = free.simulate(t, TIGHT)
        assert np.abs(other.x - dense.x).max() < 1e-9 * np.abs(dense.x).max()
        with pytest.raises(ParameterError, match="integrator"):
            cells.simulate(t)
    strong = couple(m, graph=30 * w)
    strong.__dict__["route"] = "matrix-free: forced by the test"
    with pytest.raises(MemoryBudgetError, match="nonsingular"):
        strong.simulate(t, TIGHT)


def test_refusals():
    cells = couple(model(m=3, steered=True), 2)
    with pytest.raises(ParameterError, match="rtol and atol"):
        cells.simulate([0.0, 1.0])
    with pytest.raises(ParameterError, match="no heading"):
        cells.simulate([0.0, 1.0], TIGHT, p0=[0.0, 0.0, 1.0])
    with pytest.raises(ParameterError, match="NaN"):
        cells.simulate([0.0, 1.0], TIGHT, z0=np.full(3, np.nan))
    with pytest.raises(ParameterError, match="heading features"):
        couple(model(m=3), 2, controller=PolarityLaw())
    with pytest.raises(ParameterError, match="controller"):
        couple(model(m=3), 2).linearize()


def test_antiparallel_choice_is_followed():
    m = model(m=3, steered=True, seed=1)
    base = couple(m, 2)
    d = base.simulate([0.0, 1.0], TIGHT).d[0, 0]
    p0 = -d / np.linalg.norm(d)
    still = couple(m, 2, controller=PolarityLaw(1 / 60))
    moved = couple(m, 2, controller=PolarityLaw(1 / 60, AntiparallelTurn(angle=0.01)))
    a = still.simulate([0.0, 1e-3], Exponential(rtol=1e-8, atol=1e-8), p0=p0).p[-1, 0]
    b = moved.simulate([0.0, 1e-3], Exponential(rtol=1e-2, atol=1e-2), p0=p0).p[-1, 0]
    assert np.arccos(min(1.0, a @ p0)) < 1e-4
    assert np.arccos(b @ p0) > 5e-3


def test_closed_loops_interact_through_the_sensed_field():
    """[36] moves no pole of the plant; the loops closed over the shared field do move theirs."""
    m = model(m=4, steered=True, seed=1)
    z = np.random.default_rng(2).standard_normal(4)
    at = (z, np.array([np.cos(0.4), np.sin(0.4), 0.0]))
    one = couple(m, 1).linearize(at)
    own = couple(m, 1).loop.linearize(at)
    assert match(one.poles.values, own.poles) < 1e-12
    for K in (2, 4):
        found = couple(m, K).linearize(at)
        assert found.plant_poles.abscissa == one.plant_poles.abscissa
        # dense: x isolated, z = N x, every cell at the same point
        N = np.eye(4 * K) + np.kron(np.ones((K, K)) - np.eye(K), P_phi(m))
        read = own.kappa * np.kron(np.eye(K), own.S_heading[None]) @ N
        drive = np.kron(np.eye(K), own.B_heading[:, None])
        M = np.block(
            [[np.kron(np.eye(K), m.A), drive], [read, -own.kappa * own.strength * np.eye(K)]]
        )
        assert match(np.repeat(found.poles.values, found.poles.multiplicity), sla.eigvals(M)) < 1e-9
        mean = found.poles.values[found.poles.omega == K - 1]
        assert match(mean, one.poles.values) > 1e-3


def test_memory_grows_linearly_with_the_cells():
    import tracemalloc

    m, peaks = model(m=10, steered=True, seed=1), []
    for K in (100, 400):
        cells = couple(m, K, headings=np.linspace(0, 6, K))
        tracemalloc.start()
        cells.simulate(np.linspace(0, 100, 11), Exponential(rtol=1e-4, atol=1e-4))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 6 * peaks[0]


@pytest.mark.parametrize("graph", [False, True])
@pytest.mark.slow
def test_the_estimate_covers_the_error(graph):
    """On the modal route, and on the dense one that the integrator takes as a whole."""
    weights = np.array([[0.0, 0.2, 0.1], [0.3, 0.0, 0.1], [0.0, 0.2, 0.0]])
    how = {"graph": InteractionGraph(weights)} if graph else {"n_cells": 3}
    t, ratios = np.linspace(0, 200, 9), []
    for seed in range(8):
        cells = couple(model(m=4, steered=True, seed=seed), headings=[0.0, 1.0, 2.0], **how)
        assert (cells.modes is None) == graph
        method = DOP853 if graph else Exponential
        exact = cells.simulate(t, method(rtol=1e-11, atol=1e-11)).x
        for tol in (1e-4, 1e-6):
            run = cells.simulate(t, method(rtol=tol, atol=tol))
            ratios.append(run.error.absolute.max() / np.abs(run.x - exact).max())
            assert "a tenth of the tolerance" in str(run)
    assert np.mean(np.array(ratios) >= 1) >= 0.9
    assert 0.5 < min(ratios)
    assert max(ratios) < 20


def test_without_controllers_only_rounding_is_estimated():
    cells = couple(model(m=4, seed=1), 3)
    run = cells.simulate(np.linspace(0, 1e4, 5), z0=np.ones(4))
    assert run.error.relative < 1e-10
    assert "exact flow" in str(run)
