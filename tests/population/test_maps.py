"""Field maps of a basis, P_map fitted to data."""

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.errors import DataError, DimensionError, ParameterError, RepresentationError
from cellsys.model import LatentModel
from cellsys.population import MappedSuperposition, P_c, P_F_phi, P_phi, couple, fit_P_map
from cellsys.population.printed.split import field_split
from cellsys.system import Block, Layout
from tests.population.systems import model

ROUNDING = 1e-13  # products of orthonormal matrices of order 10: a few eps


def with_forces(m=6, nodes=4, seed=0):
    """States: 4 membrane nodes and 5 matrix nodes; auxiliaries: forces on the cell, on matrix."""
    rng = np.random.default_rng(seed)
    n_c, n_e = 3 * nodes, 15
    V = sla.qr(rng.standard_normal((2 * (n_c + n_e), m)), mode="economic")[0]
    n = n_c + n_e
    field = np.r_[np.arange(n_c, n), np.arange(n + n_c, 2 * n)]
    states = Layout(
        [
            Block("cell1.position", (nodes, 3), "um", role="component", kind="position"),
            Block("matrix.displacement", (5, 3), "um", role="field", kind="position"),
        ]
    )
    return LatentModel(
        A=-np.eye(m),
        V=V,
        n_states=n,
        states=states,
        blocks={"component": np.setdiff1d(np.arange(2 * n), field), "field": field},
    )


def test_field_maps_are_compressions():
    m = with_forces()
    for P in (P_phi(m), P_F_phi(m), P_c(m)):
        assert np.abs(P - P.T).max() < ROUNDING
        values = sla.eigvalsh(P)
        assert values.min() > -ROUNDING
        assert values.max() < 1 + ROUNDING
        # not idempotent: it compresses a projector
        assert np.abs(P @ P - P).max() > 1e-3
    others = np.setdiff1d(np.arange(len(m.V)), m.blocks["field"])
    V_alpha = m.V[others]
    assert np.abs(P_phi(m) + V_alpha.T @ V_alpha - np.eye(6)).max() < ROUNDING
    # forces alone: V_alpha then holds the matrix positions too
    forces = m.blocks["field"][m.blocks["field"] >= m.n_states]
    rest = np.delete(m.V, forces, axis=0)
    assert np.abs(P_F_phi(m) + rest.T @ rest - np.eye(6)).max() < ROUNDING


def test_centre_map():
    m = with_forces()
    V_c = m.V[:12]
    literal = V_c.T @ np.kron(np.ones((4, 4)) / 4, np.eye(3)) @ V_c
    assert np.abs(P_c(m) - literal).max() < ROUNDING
    by_component = V_c.T @ np.kron(np.eye(3), np.ones((4, 4)) / 4) @ V_c
    assert np.abs(P_c(m, range(12), order="component") - by_component).max() < ROUNDING
    # naive version, ones(n, n)/n over all rows as printed: mixes x, y and z
    assert np.abs(P_c(m) - V_c.T @ (np.ones((12, 12)) / 12) @ V_c).max() > 1e-2


def test_maps_refuse():
    m = with_forces()
    bare = LatentModel(A=-np.eye(3))
    for call in (P_phi, P_F_phi, P_c):
        with pytest.raises(RepresentationError, match="LatentModel has none"):
            call(bare)
    with pytest.raises(RepresentationError, match="names none"):
        P_phi(LatentModel(A=-np.eye(3), V=np.eye(3)))
    with pytest.raises(DimensionError, match="3 rows per membrane node"):
        P_c(m, range(4))
    with pytest.raises(ParameterError, match="node"):
        P_c(m, range(3), order="row")
    with pytest.raises(DimensionError, match="indices from 0"):
        P_phi(m, rows=[99])
    slanted = LatentModel(
        A=-np.eye(2), V=[[1.0, 0.5], [0.0, 1.0], [0.0, 0.0]], blocks={"field": [1]}
    )
    with pytest.raises(DataError, match="not orthonormal"):
        field_split(slanted, np.array([1]), None, "Superposition")


def test_P_map_makes_bonded_pairs_equal_and_opposite():
    m = with_forces()
    n, rng = m.n_states, np.random.default_rng(1)
    on_cell = n + np.arange(12)
    on_matrix = n + 12 + np.array([0, 4, 8, 3, 7, 11, 1, 2, 5, 6, 9, 10])
    # samples in which the bonded rows are equal and opposite: the null space of V_c + V_e
    bonded = m.V[on_cell] + m.V[on_matrix]
    free = sla.null_space(bonded[:3])  # three pairs, m = 6: three free directions
    Z = rng.standard_normal((40, free.shape[1])) @ free.T
    pairs = list(zip(on_cell[:3], on_matrix[:3], strict=True))
    fitted = fit_P_map(m, Z, pairs=pairs)
    assert fitted.mismatch < 1e-12  # constructed so
    assert fitted.residual < 1e-10  # exact relation, conditioned below 1e3
    z = Z[0]
    answer = fitted.matrix @ P_F_phi(m) @ z
    assert np.abs(answer + m.V[on_cell[:3]].T @ (m.V[on_matrix[:3]] @ z)).max() < 1e-10
    # the same from the rows of the cell, since the data are equal and opposite
    same = fit_P_map(m, Z, cell_rows=on_cell[:3])
    assert np.abs(same.matrix - fitted.matrix).max() < 1e-9
    assert np.isnan(same.mismatch)
    assert fitted.dropped == len(z) - free.shape[1]
    # a map goes with the rows it was fitted on: [93] couples on the same
    form = MappedSuperposition(P_map=fitted, rows="forces")
    assert couple(m, 3, form).poles().shape == (18,)
    with pytest.raises(ParameterError, match='rows="forces"'):
        couple(m, 3, MappedSuperposition(P_map=fitted))
    # data that are not equal and opposite are seen
    assert fit_P_map(m, rng.standard_normal((40, 6)), pairs=pairs).mismatch > 0.1
    with pytest.raises(ParameterError, match="give one"):
        fit_P_map(m, Z)
    with pytest.raises(DataError, match="NaN"):
        fit_P_map(m, Z * np.nan, pairs=pairs)
    with pytest.raises(DimensionError, match="latent"):
        fit_P_map(m, Z[:, :2], pairs=pairs)


def test_split_resolves_what_eigenvalues_cannot():
    gap = np.array([0.9, 0.5, 1e-6, 1e-14, 1e-20])
    m = model(m=5, gap=gap)
    found = field_split(m, m.blocks["field"], None, "test").gap
    # sigma is accurate to a few eps absolutely, so sigma^2 = 1e-20 keeps five digits
    assert np.abs(found / gap - 1).max() < 1e-4
    naive = sla.eigvalsh(np.eye(5) - P_phi(m))[::-1]
    assert np.abs(naive[-2:] / gap[-2:] - 1).max() > 1e-2
