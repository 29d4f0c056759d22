"""M_pol: signed angle over the full turn, periodic columns, what the literal 0/1 map explains."""

import numpy as np
import pytest

from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.geometry.membrane import sphere
from cellsys.laws.lamellipodium import protrusion
from cellsys.loop import MPol
from tests import naive

SHAPE = {"height": 3.0, "edge": 0.5, "full": 0.9, "downward": 0.1}


@pytest.fixture(scope="module")
def position():
    """A flattened cell: half a sphere pressed to the substrate."""
    x = sphere(8.0, (0.0, 0.0, 8.0)).position.copy()
    x[:, 2] *= 0.3
    return x


def heading(degree):
    return np.array([np.cos(np.radians(degree)), np.sin(np.radians(degree)), 0.0])


def logged_input(position, count=200, seed=0):
    rng = np.random.default_rng(seed)
    p = np.array([heading(a) for a in rng.uniform(-180, 180, count)])
    u = np.array([protrusion(position, row, 600.0, *SHAPE.values()).ravel() for row in p])
    return u, p


def test_every_degree_finds_its_own_column():
    table = np.zeros((3, 360))
    table[0] = np.arange(360.0)
    for lookup in ("interpolate", "nearest"):
        m = MPol(table, lookup)
        for degree in range(-180, 540, 7):
            # arctan2 and back: a few roundings of 360
            assert abs(m.at(heading(degree))[0] - degree % 360) < 1e-10 or degree % 360 == 0
        assert m.at(heading(0.0))[0] in (0.0, 360.0)
    reached = {int(m.at(heading(d))[0]) for d in range(360)}
    assert len(reached) == 360
    # the printed arctan of a ratio of absolute values reaches a quarter, of a signed ratio a half
    assert naive.columns_reached_by_arctan() <= 181


def test_length_and_height_of_p_do_not_matter(position):
    m = MPol.from_membrane(position, **SHAPE)
    p = heading(33.3)
    assert np.array_equal(m.at(7.0 * p), m.at(p)) or np.abs(m.at(7.0 * p) - m.at(p)).max() < 1e-12
    assert np.abs(m.at(p + [0, 0, 0.5]) - m.at(p)).max() < 1e-12


def test_interpolation_is_periodic_and_continuous(position):
    m = MPol.from_membrane(position, **SHAPE)
    step = 1e-6
    largest = np.abs(np.diff(np.column_stack([m.table, m.table[:, :1]]), axis=1)).max()
    for degree in (0.0, 360.0, 359.9999999, 180.0, -180.0, 90.0, 17.0):
        jump = np.abs(m.at(heading(degree + step)) - m.at(heading(degree - step))).max()
        # piecewise linear: two steps times the steepest slope, and rounding of the angle
        assert jump < 2.1 * step * largest + 1e-10
    assert np.abs(m.at(heading(359.5)) - 0.5 * (m.table[:, 359] + m.table[:, 0])).max() < 1e-10
    nearest = MPol(m.table, "nearest")
    assert np.array_equal(nearest.at(heading(359.6)), m.table[:, 0])
    assert np.array_equal(nearest.at(heading(359.4)), m.table[:, 359])


def test_signed_map_explains_the_input_and_the_literal_one_does_not(position):
    u, p = logged_input(position)
    signed = MPol.from_membrane(position, **SHAPE)
    literal = MPol.from_membrane(position, directions="none", **SHAPE)
    # between two columns the pattern is not linear in the angle: 1e-3 at most for 1 degree
    assert signed.explained(u, p) > 0.999
    assert literal.explained(u, p) < 0.15
    assert set(np.unique(literal.table)) == {0.0, 1.0}
    half = MPol(naive.half_turn_table(signed.table))
    assert half.explained(u, p) < 0.6


def test_no_heading_no_edge(position):
    m = MPol.from_membrane(position, **SHAPE)
    assert not m.at(np.array([0.0, 0.0, 1.0])).any()
    assert not m.at(np.zeros(3)).any()


def test_refusals(position):
    with pytest.raises(DimensionError, match=r"\(3 n, 360\)"):
        MPol(np.zeros((3, 180)))
    with pytest.raises(DimensionError):
        MPol(np.zeros((4, 360)))
    with pytest.raises(DataError, match="NaN"):
        MPol(np.full((3, 360), np.nan))
    with pytest.raises(ParameterError, match="lookup"):
        MPol(np.zeros((3, 360)), "round")
    with pytest.raises(ParameterError, match="directions"):
        MPol.from_membrane(position, directions="yes", **SHAPE)
    m = MPol(np.zeros((3, 360)))
    for bad in (np.array([1.0, np.nan, 0.0]), np.zeros(2)):
        with pytest.raises(DimensionError, match="three finite"):
            m.at(bad)
    with pytest.raises(DimensionError, match="u must have shape"):
        m.explained(np.zeros((4, 6)), np.eye(4, 3))
    assert m.explained(np.zeros((2, 3)), np.eye(2, 3)) == 0.0
