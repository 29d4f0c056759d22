"""The printed split of cell, interface and matrix against its own definition."""

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DimensionError, ParameterError

CHI, PHI = [2, 4], [1, 5, 6]
MEMBER = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -1.0]])


def parts(m=4, n_x=5, n_eta=7, seed=0):
    rng = np.random.default_rng(seed)
    V = np.linalg.qr(rng.standard_normal((n_x + n_eta, m)))[0]
    return V[:n_x], V[n_x:], rng.standard_normal((n_x, n_eta))


def test_groups_add_up_and_rates_come_back():
    V_x, V_eta, W = parts()
    found = cs.printed_interface(V_x, V_eta, W, chi=CHI, phi=PHI, M_chi_phi=MEMBER)
    assert found.ranks == (5, 4)
    assert found.remainder < 1e-13  # W has full row rank: V_x lies in its range
    # A rate z' whose eta and eta' have chi = M_chi_phi eta_phi is what its parts add up to [49].
    rng = np.random.default_rng(1)
    eta, rate = rng.standard_normal((2, 7))
    for v in (eta, rate):
        v[CHI] = MEMBER @ v[PHI]
    both = np.concatenate([eta, rate])
    V = np.vstack([V_x, V_eta])
    whole = V.T @ np.concatenate([W @ eta, rate])
    matrix = V.T @ found.W_bar @ found.M_phi @ both
    shared = V.T @ found.W_bar @ found.C @ found.M_phi @ both
    cell = V.T @ found.W_bar @ found.M_alpha @ both
    np.testing.assert_allclose(cell + shared + matrix, whole, atol=1e-13)
    np.testing.assert_allclose(found.C @ found.M_phi @ both, found.M_chi @ both, atol=1e-14)


def test_a_rank_deficient_w_leaves_a_remainder():
    V_x, V_eta, W = parts()
    W[4] = W[3]  # naive: P_alpha + P_chi + P_phi = I for any W
    found = cs.printed_interface(V_x, V_eta, W, chi=CHI, phi=PHI, M_chi_phi=MEMBER)
    assert found.ranks[0] == 4
    gone = np.array([0, 0, 0, 1.0, -1.0]) / np.sqrt(2)
    lost = np.outer(gone @ V_x, gone @ V_x)
    assert abs(found.remainder - np.linalg.norm(lost, 2)) < 1e-12


def test_r_is_taken_by_feedback():
    V_x, V_eta, W = parts()
    found = cs.printed_interface(V_x, V_eta, W, chi=CHI, phi=PHI, M_chi_phi=MEMBER)
    assert np.abs(found.R - np.eye(4)).max() > 1e-3
    alone = cs.printed_interface(V_x, V_eta, W, chi=CHI, phi=PHI, M_chi_phi=0 * MEMBER)
    np.testing.assert_array_equal(alone.R, np.eye(4))
    assert cs.Feedback(R=found.R) is not None
    with pytest.raises(DimensionError, match="M_chi_phi"):
        cs.printed_interface(V_x, V_eta, W, chi=CHI, phi=PHI, M_chi_phi=MEMBER.T)
    with pytest.raises(DimensionError, match="W_eta"):
        cs.printed_interface(V_x, V_eta, W.T, chi=CHI, phi=PHI, M_chi_phi=MEMBER)
    with pytest.raises(ParameterError, match="chi and phi"):
        cs.printed_interface(V_x, V_eta, W, chi=[1, 4], phi=PHI, M_chi_phi=MEMBER)
