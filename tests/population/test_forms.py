"""Poles of the printed couplings: against Kronecker products, 50 digits and the theorem."""

import mpmath as mp
import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.errors import (
    DimensionError,
    MemoryBudgetError,
    ParameterError,
    RepresentationError,
)
from cellsys.integrate import DOP853
from cellsys.model import LatentModel
from cellsys.population import (
    Feedback,
    InteractionGraph,
    MappedSuperposition,
    P_phi,
    Superposition,
    couple,
)
from cellsys.spectra import poles, spectrum, stability
from cellsys.spectra.integrators import MARGINAL
from tests.naive import dense_coupled_poles, kronecker_coupling
from tests.population.systems import match, model

EPS = np.finfo(float).eps


def forms(m, seed=5, size=0.2):
    rng = np.random.default_rng(seed)
    P_map = size * rng.standard_normal((m, m))
    R = np.eye(m) + P_map
    return (
        (Superposition(), None),
        (MappedSuperposition(P_map=P_map), R),
        (Feedback(), None),
        (Feedback(R=R), R),
    )


def condition(M):
    """Largest eigenvalue condition number times |M|: what eps is multiplied with."""
    return spectrum.spectrum(M).condition.max() * sla.norm(M)


@pytest.mark.parametrize("K", [1, 2, 5, 20])
def test_every_form_is_its_kronecker_assembly(K):
    m = model(m=6)
    for form, R in forms(6):
        cells = couple(m, K, form)
        M = kronecker_coupling(form.name, m.A, P_phi(m), K, R)
        assert np.abs(cells.matrix() - M).max() < 1e-12 * np.abs(M).max()
        bound = 100 * EPS * condition(M)
        assert match(cells.poles(), sla.eigvals(M)) < bound
        for coordinates in ("emergent", "isolated"):
            plant = cells.plant(coordinates)
            assert plant.dt == 0
            assert match(poles(plant), sla.eigvals(M)) < bound
        # one transfer function, whatever the coordinates
        s = 0.3j
        first, second = (cells.plant(c)(s) for c in ("emergent", "isolated"))
        assert np.abs(first - second).max() < 1e-10 * np.abs(first).max()


def test_input_block_is_that_of_the_theory():
    """Block I + omega R P on B c and b alike, no stray A."""
    m, K = model(m=4), 3
    for form, R in forms(4):
        R = np.eye(4) if R is None else R
        w = np.ones((K, K)) - np.eye(K)
        expected = (np.eye(4 * K) + np.kron(w, R @ P_phi(m))) @ np.kron(np.eye(K), m.B)
        assert np.abs(couple(m, K, form).plant(offset="drop").B - expected).max() < 1e-13


def test_poles_of_superposition_are_copies():
    m = model(m=8)
    own = sla.eigvals(m.A)
    for K in (1, 2, 7):
        found = couple(m, K).pole_set()
        assert found.count == 8 * K
        assert np.all(found.multiplicity == K)
        assert match(found.values, own) == 0.0
    assert couple(m, 10**9).pole_set().count == 8 * 10**9


def exact_poles(m, K, P_map=None):
    """Poles of [36] or [93] in 50 digits, dense, from the stored A and V."""
    with mp.workdps(50):
        A, V = mp.matrix(m.A.tolist()), mp.matrix(m.V[m.blocks["field"]].tolist())
        P, n = V.T * V, m.order
        RP = P if P_map is None else P + mp.matrix(P_map.tolist()) * P
        N, X = mp.eye(K * n), mp.eye(K * n)
        whole = mp.zeros(K * n)
        for a in range(K):
            whole[a * n : (a + 1) * n, a * n : (a + 1) * n] = A
            for b in range(K):
                if a != b:
                    N[a * n : (a + 1) * n, b * n : (b + 1) * n] = P
                    X[a * n : (a + 1) * n, b * n : (b + 1) * n] = RP
        values = mp.eig(X * whole * mp.inverse(N), left=False, right=False)
        return np.array([complex(v) for v in values])


@pytest.mark.parametrize(
    ("K", "size"), [(2, 6), (3, 5), pytest.param(3, 12, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("gap", [1e-3, 1e-8, 1e-12])
def test_superposition_against_fifty_digits(K, size, gap):
    m = model(m=size, gap=[*np.linspace(0.9, 0.2, size - 1), gap], seed=size)
    exact = exact_poles(m, K)
    # eigenvalue condition x eps: what the poles of A itself are known to
    bound = 100 * EPS * condition(m.A)
    assert match(couple(m, K).poles(), exact) < bound
    naive = match(dense_coupled_poles(m, K), exact)
    assert naive < 1e-7 if gap == 1e-3 else naive > 1e-4  # the dense double version fails


@pytest.mark.parametrize("gap", [1e-2, 1e-5])
def test_mapped_superposition_against_fifty_digits(gap):
    m = model(m=5, gap=[0.9, 0.7, 0.5, 0.3, gap], seed=2)
    P_map = 0.1 * gap * np.random.default_rng(3).standard_normal((5, 5))
    cells = couple(m, 2, MappedSuperposition(P_map=P_map))
    # P has an error of eps, and [93] divides it by 1 - lambda
    bound = 100 * EPS * max(condition(b.M) for b in cells.blocks()) / gap
    assert match(cells.poles(), exact_poles(m, 2, P_map)) < bound


def test_sweep_to_the_singular_split_has_no_spurious_pole():
    worst = -np.inf
    for gap in np.geomspace(1e-2, 1e-16, 29):
        m = model(m=6, gap=[0.9, 0.7, 0.5, 0.3, 0.1, gap], seed=1)
        for K in (2, 5, 20):
            found = couple(m, K).pole_set()
            top = sla.eigvals(m.A).real.max()
            assert found.abscissa == top  # exactly A's: nothing is divided by the gap
            assert found.determined == (gap >= 1e-7)
            if not found.determined:
                other = found.alternative
                assert other.count == 6 * K
                assert other.zeros == K - 1
                rest = other.values[(other.omega == -1.0) & (other.values != 0)]
                assert match(rest, sla.eigvals(_compression(m))) < 1e-9
                assert "not determined by the data" in found.note
            worst = max(worst, dense_coupled_poles(m, K).real.max())
    assert worst > 1e2  # naive: a relative cut-off of a dense pseudo-inverse


def _compression(m):
    """U^T A U on the range of V_alpha without its smallest direction."""
    V_alpha = m.V[m.blocks["component"]]
    U = sla.svd(V_alpha)[2][:-1].T
    return U.T @ m.A @ U


@pytest.mark.parametrize("q", [1, 3])
def test_purely_field_directions(q):
    gap = [*np.linspace(0.9, 0.3, 7 - q), *np.zeros(q)]
    m = model(m=7, gap=gap, seed=4)
    V_alpha = m.V[m.blocks["component"]]
    U = sla.svd(V_alpha)[2][: 7 - q].T
    for K in (2, 3, 50):
        found = couple(m, K).pole_set()
        assert found.zeros == (K - 1) * q  # exact zeros
        assert found.count == 7 * K
        assert found.determined
        expected = np.concatenate(
            [sla.eigvals(m.A), np.tile(sla.eigvals(U.T @ m.A @ U), K - 1), np.zeros((K - 1) * q)]
        )
        assert match(couple(m, K).poles(), expected) < 1e-10
        if K < 10:
            M = kronecker_coupling("Superposition", m.A, P_phi(m), K)
            # pinv with its own cut-off is right here: the gap from 0.3 to 0 is wide
            assert match(couple(m, K).poles(), sla.eigvals(M)) < 1e-7
    report = couple(m, 3).stability()
    assert report.integrators == 2 * q


def test_more_directions_than_cell_rows():
    """m > rank V_alpha: the split is singular as a matter of structure."""
    rng = np.random.default_rng(0)
    V = sla.qr(rng.standard_normal((20, 8)), mode="economic")[0]
    m = LatentModel(
        A=-np.eye(8) + 0.1 * rng.standard_normal((8, 8)), V=V, blocks={"field": range(5, 20)}
    )
    cells = couple(m, 4)
    assert cells.rank.purely_field == 3
    assert cells.pole_set().zeros == 9
    assert "purely matrix" in str(cells)


def test_mapped_with_zero_map_is_superposition():
    for gap in (None, [0.9, 0.5, 0.3, 1e-10], [0.9, 0.5, 0.0, 0.0]):
        m = model(m=4, gap=gap)
        a, b = couple(m, 5), couple(m, 5, MappedSuperposition(P_map=np.zeros((4, 4))))
        assert np.array_equal(a.poles(), b.poles())


def test_limits_for_many_cells():
    m = model(m=6, seed=3)
    for form, R in forms(6):
        cells = couple(m, 2, form)
        limit = cells.limit_poles()
        P = P_phi(m)
        R = np.eye(6) if R is None else R
        if isinstance(form, Feedback):
            assert match(limit, sla.eigvals(R @ P @ m.A)) < 1e-12
        else:
            assert match(limit, sla.eigvals(sla.solve(P, R @ P @ m.A))) < 1e-10
        error = []
        for K in (10**3, 10**4, 10**5):
            found = couple(m, K, form).pole_set()
            mean = found.values[np.isnan(found.omega) | (found.omega == K - 1)]
            scale = K - 1 if isinstance(form, Feedback) else 1
            error.append(match(mean / scale, limit))
        if isinstance(form, Superposition):
            assert max(error) < 1e-12
        else:  # O(1/K): each ten times more cells, ten times closer
            assert 8 < error[0] / error[1] < 12
            assert 8 < error[1] / error[2] < 12


def test_limit_is_refused_where_poles_grow():
    m = model(m=4, gap=[1.0, 0.5, 0.4, 0.3])
    cells = couple(m, 3, MappedSuperposition(P_map=0.1 * np.ones((4, 4))))
    with pytest.raises(ParameterError, match="grow like K"):
        cells.limit_poles()


def test_feedback_of_a_dissipative_cell_is_stable_for_every_K():
    rng = np.random.default_rng(0)
    A = rng.standard_normal((6, 6))
    A = A - A.T - 0.1 * np.eye(6)
    report = couple(model(m=6, A=A), 10**6, Feedback()).stability()
    assert report.verdict == "stable for every K"
    assert "A + A^T < 0" in report.reason
    cells = couple(model(m=6, seed=0), 5, Feedback())
    report = cells.stability()
    assert report.verdict == "unstable"
    assert report.spectral_abscissa == cells.pole_set().abscissa


def test_stability_says_when_the_data_do_not_decide():
    # A non-normal: stable itself, its compression is not
    A = np.array([[0.1, -1.0], [1.0, -0.5]]) * 0.1
    V = np.array([[1.0, 0.0], [0.0, 1e-6], [0.0, np.sqrt(1 - 1e-12)]])
    m = LatentModel(A=A, V=V, blocks={"field": [2]})
    assert sla.eigvals(A).real.max() < 0
    report = couple(m, 3).stability()
    assert report.verdict == "not decided"
    assert "not determined by the data" in report.reason


def test_integrators_are_said_as_of_one_system():
    """As `stability` says it of the assembled whole. Naive: the verdict on what is left, alone."""
    still = np.diag([-0.1, -0.2, 0.0])
    for form, scope in ((Feedback(), ""), (Superposition(), " for every K")):
        cells = couple(model(m=3, A=still), 3, form)
        report = cells.stability()
        assert report.verdict == stability(cells.matrix()).verdict + scope == MARGINAL + scope
        assert report.integrators == 3
        assert report.reason.endswith("; set apart: 3 integrators")
    chain = np.diag([-0.1, 0.0, 0.0]) + np.eye(3, k=1) * [[0.0], [1.0], [0.0]]
    for form in (Feedback(), Superposition()):
        cells = couple(model(m=3, A=chain), 3, form)
        assert cells.stability().verdict == stability(cells.matrix()).verdict == "unstable"


# Routes


def graph_matrix(form, m, w, R):
    return kronecker_coupling(form.name, m.A, P_phi(m), len(w), R, w)


def test_graph_route_is_its_kronecker_assembly():
    rng = np.random.default_rng(0)
    m = model(m=5)
    graph = InteractionGraph.attenuated(rng.uniform(0, 50, (7, 2)), 15.0)
    for form, R in forms(5):
        cells = couple(m, graph=graph, coupling=form)
        assert cells.route.startswith("graph")
        M = graph_matrix(form, m, graph.weights, R)
        assert np.abs(cells.matrix() - M).max() < 1e-11 * np.abs(M).max()
        assert match(cells.poles(), sla.eigvals(M)) < 1000 * EPS * condition(M)
        assert cells.stability().verdict in ("stable", "unstable")
        # a complete graph is the modal route
        full = couple(m, graph=np.ones((4, 4)) - np.eye(4), coupling=form)
        assert full.route.startswith("modal")
        assert match(full.poles(), couple(m, 4, form).poles()) == 0.0


def test_dense_route_for_weights_that_are_not_symmetric():
    rng = np.random.default_rng(1)
    m = model(m=4)
    w = rng.uniform(0, 0.3, (5, 5))
    np.fill_diagonal(w, 0.0)
    for form, R in forms(4):
        cells = couple(m, graph=w, coupling=form)
        assert cells.route.startswith("dense")
        M = graph_matrix(form, m, w, R)
        assert np.abs(cells.matrix() - M).max() < 1e-11 * np.abs(M).max()
        assert match(cells.poles(), sla.eigvals(M)) < 1000 * EPS * condition(M)
        assert match(poles(cells.plant("isolated")), sla.eigvals(M)) < 1000 * EPS * condition(M)
    singular = model(m=4, gap=[0.9, 0.5, 0.0, 0.0])
    w = np.ones((3, 3)) - np.eye(3)
    w[0, 1] = 0.5
    cells = couple(singular, graph=w)
    M = graph_matrix(Superposition(), singular, w, None)
    # one N is singular in some directions; the pseudo-inverse of the whole says which
    assert match(cells.poles(), sla.eigvals(M)) < 1e-7


def test_singular_graph_mode():
    """N is singular where omega lambda(P) = -1, also away from omega = -1."""
    m = model(m=4, gap=[0.5, 0.4, 0.3, 0.2])
    pair = np.array([[0.0, 2.0, 0.5], [2.0, 0.0, 0.5], [0.5, 0.5, 0.0]])  # omega = -2, 1/0.5 = 2
    cells = couple(m, graph=pair)
    assert cells.route.startswith("graph")
    assert np.any(np.isclose(cells.modes.omega, -2.0, atol=1e-12))
    assert cells.pole_set().zeros == 1
    M = graph_matrix(Superposition(), m, pair, None)
    assert match(cells.poles(), sla.eigvals(M)) < 1e-7


def test_refusals_name_the_route_that_works():
    m = model(m=20, slowest=0.1)
    with pytest.raises(MemoryBudgetError, match="pole_set"):
        couple(m, 10**6).poles()
    with pytest.raises(MemoryBudgetError, match="pole_set"):
        couple(m, 1000).plant()
    w = np.triu(np.ones((300, 300)), 1) * 1e-3
    cells = couple(m, graph=w)
    assert cells.route.startswith("matrix-free")
    for call in (cells.poles, cells.pole_set, cells.stability, cells.plant):
        with pytest.raises(MemoryBudgetError, match="symmetric"):
            call()
    for form in (Superposition(), Feedback(), MappedSuperposition(P_map=np.eye(20))):
        with pytest.raises(RepresentationError, match=f"{form.name} needs the rows of V"):
            couple(LatentModel(A=-np.eye(20)), 3, form)
    with pytest.raises(RepresentationError, match="blocks="):
        couple(LatentModel(A=-np.eye(3), V=np.eye(3)), 3)
    for wrong in (0, -1, 2.5, True):
        with pytest.raises(ParameterError, match="n_cells"):
            couple(m, wrong)
    with pytest.raises(ParameterError, match="n_cells="):
        couple(m)
    with pytest.raises(DimensionError, match="differ"):
        couple(m, 3, positions=np.zeros((2, 2)))
    with pytest.raises(ParameterError, match="coupling must be"):
        couple(m, 3, "feedback")
    with pytest.raises(DimensionError, match="P_map"):
        couple(m, 3, MappedSuperposition(P_map=np.eye(2)))


def test_large_sparse_graphs_are_matrix_free():
    """Symmetric weights of more cells than an eigenvalue problem can take: no dense matrix."""
    import scipy.sparse as sp

    K, m = 30_000, model(m=3, slowest=0.1)
    ring = sp.diags_array([np.full(K - 1, 0.1)] * 2, offsets=[-1, 1], shape=(K, K))
    cells = couple(m, graph=InteractionGraph(sp.csr_array(ring)), coupling=Feedback())
    assert cells.route.startswith("matrix-free: too many cells")
    with pytest.raises(MemoryBudgetError, match="modal route"):
        cells.poles()
    run = cells.simulate([0.0, 5.0], DOP853(rtol=1e-6, atol=1e-6))
    # ends apart, every cell has the same two neighbours and the same start
    inner = run.block("z")[-1][100:-100]
    assert np.abs(inner - inner[0]).max() < 1e-9
    rounded = np.ones((4, 4)) - np.eye(4)
    rounded[0, 1] += 1e-16
    assert couple(m, graph=rounded).route.startswith(("modal", "graph"))


def test_rightmost_poles_of_the_matrix_free_route():
    m = model(m=6, slowest=0.1)
    rng = np.random.default_rng(0)
    w = rng.uniform(0, 0.02, (60, 60))
    np.fill_diagonal(w, 0.0)
    cells = couple(m, graph=w, coupling=Feedback())
    exact = np.sort(cells.poles().real)[::-1][:4]
    assert np.abs(np.sort(cells.rightmost(4).real)[::-1] - exact).max() < 1e-8
