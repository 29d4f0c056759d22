"""Quantities at the boundary: every accepted string gives the right number, all else is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellsys.errors import CellsysError, UnitError
from cellsys.units import UNITS, parse_unit, quantity

finite = st.floats(-1e12, 1e12, allow_nan=False)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("5 kPa", "pN/um^2", 5000.0),
        ("1/60 1/s", "1/s", 1.0 / 60.0),
        ("1e-3 N s/m", "pN s/um", 1000.0),
        ("0.6 nN", "pN", 600.0),
        ("60 um", "um", 60.0),
        ("2 min", "s", 120.0),
        ("0.5 h", "s", 1800.0),
        ("90 deg", "rad", math.pi / 2),
        ("1 nm/s", "um/s", 1e-3),
        ("1 mN/m", "pN/um", 1000.0),
        ("20 %", "1", 0.2),
        ("1 J", "pN um", 1e18),
        (0.3, "1", 0.3),
        ("-2", "1", -2.0),
        ("1 kg_", "pN", None),
    ],
)
def test_known_conversions(text, unit, value):
    if value is None:
        with pytest.raises(UnitError):
            quantity(text, unit)
        return
    # One multiplication and one division: a few units in the last place.
    assert quantity(text, unit) == pytest.approx(value, rel=4e-16 * 8)


@given(finite, st.sampled_from(sorted(UNITS)))
def test_printing_and_reading_gives_the_number_times_the_factor(number, unit):
    factor, _ = parse_unit(unit)
    assert quantity(f"{number!r} {unit}", unit) == pytest.approx(number * factor, rel=1e-15)


@given(finite, st.sampled_from(["um", "pN", "s", "rad", "pN/um", "1/s"]))
def test_internal_units_have_factor_one(number, unit):
    # The factors are products of powers of ten: exact up to rounding of 1e6 * 1e-6.
    assert quantity(f"{number!r} {unit}", unit) == pytest.approx(number, rel=1e-15)


@given(st.sampled_from(sorted(UNITS)), st.sampled_from(sorted(UNITS)), st.integers(1, 3))
def test_units_multiply_and_divide(a, b, power):
    fa, da = parse_unit(a)
    fb, db = parse_unit(b)
    factor, dimension = parse_unit(f"{a}^{power} / {b}")
    assert factor == pytest.approx(fa**power / fb, rel=1e-14)
    assert dimension == tuple(power * x - y for x, y in zip(da, db, strict=True))


@given(st.sampled_from(sorted(UNITS)), st.sampled_from(sorted(UNITS)))
def test_other_dimensions_are_refused(a, b):
    if parse_unit(a)[1] == parse_unit(b)[1]:
        quantity(f"1 {a}", b)
    else:
        with pytest.raises(UnitError):
            quantity(f"1 {a}", b)


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [
        ("5", "pN", "has no unit"),
        (5.0, "pN", "has no unit"),
        ("5 kPaa", "Pa", "did you mean 'kPa'"),
        ("5 s", "um", "wrong dimension"),
        ("five um", "um", "not a number"),
        ("", "um", "not a number"),
        ("1/0 1/s", "1/s", "divides by zero"),
        (float("nan"), "1", "finite"),
        (float("inf"), "1", "finite"),
        ("1e999 um", "um", "finite"),
        (True, "1", "must be a quantity"),
        (None, "um", "must be a quantity"),
        ([1], "um", "must be a quantity"),
        ("nan um", "um", "not a number"),
        ("3 um um", "um", "wrong dimension"),
    ],
)
def test_refusals_say_what_and_how(value, unit, words):
    with pytest.raises(UnitError, match=words) as caught:
        quantity(value, unit, name="matrix.modulus")
    assert "matrix.modulus" in str(caught.value) or "unknown unit" in str(caught.value)
    assert isinstance(caught.value, (CellsysError, ValueError))


@given(st.text(max_size=30))
def test_any_text_gives_a_number_or_a_unit_error(text):
    try:
        value = quantity(text, "um")
    except UnitError:
        return
    assert math.isfinite(value)


@given(st.text(max_size=12))
def test_any_unit_text_parses_or_is_refused(text):
    try:
        factor, _ = parse_unit(text)
    except UnitError:
        return
    assert math.isfinite(factor)
