"""The room as a whole: bad input is refused everywhere in one way, docstrings are complete."""

from __future__ import annotations

import dataclasses
import inspect
import pathlib
import re

import numpy as np
import pytest

import cellsys.response as response
from cellsys.errors import CellsysError
from tests.response import gallery

CALLS = {
    "poles": response.poles,
    "zeros": response.zeros,
    "damping": response.damping,
    "frequency_response": lambda s: response.frequency_response(s, [1.0]),
    "margins": response.margins,
    "stability": response.stability,
    "pseudospectra": lambda s: response.pseudospectra(s, points=3),
    "pseudospectral_abscissa": lambda s: response.pseudospectral_abscissa(s, 0.1),
    "root_locus": lambda s: response.root_locus(s, [0.0, 1.0]),
    "sensitivity": response.sensitivity,
    "error_system": lambda s: response.error_system(s, s),
    "step_response": lambda s: response.step_response(s, [0.0, 1.0]),
    "impulse_response": lambda s: response.impulse_response(s, [0.0, 1.0]),
    "forced_response": lambda s: response.forced_response(s, [0.0, 1.0]),
    "c2d": lambda s: response.c2d(s, 0.1),
    "d2c": response.d2c,
    "h2_norm": response.h2_norm,
    "hinf_norm": response.hinf_norm,
    "norm": response.norm,
    "controllability_gramian": response.controllability_gramian,
    "observability_gramian": response.observability_gramian,
    "hankel_singular_values": response.hankel_singular_values,
    "balanced_truncation": lambda s: response.balanced_truncation(s, order=1),
    "bandwidth": lambda s: response.bandwidth(s, input=0, output=0),
    "dcgain": response.dcgain,
    "feedback": response.feedback,
    "minreal": response.minreal,
    "stabsep": response.stabsep,
    "step_info": lambda s: response.step_info(s, input=0, output=0),
    "participation": response.participation,
    "realization": response.realization,
}
PUBLIC = [name for name in response.__all__ if inspect.isfunction(getattr(response, name))]


def test_every_public_function_is_called_here() -> None:
    assert sorted(CALLS) == sorted(PUBLIC)


@pytest.mark.parametrize("name", CALLS)
def test_bad_systems_are_refused(name: str) -> None:
    A, B, C, D = gallery.random_stable(3, 1, 1, 0)
    bad = A.copy()
    bad[1, 2] = np.nan
    for system in (
        (bad, B, C, D),
        (A, B, C * np.inf, D),
        (A[:2], B, C, D),
        (A, B, C[:, :1], D),
        (A, B, C),
        (A, B, C, D, -0.1),
        "plant",
        None,
    ):
        with pytest.raises(CellsysError), np.errstate(invalid="ignore"):
            CALLS[name](system)


@pytest.mark.parametrize("name", sorted(set(CALLS) - {"d2c"}))
def test_good_systems_are_left_alone(name: str) -> None:
    system = gallery.random_stable(3, 1, 1, 0)
    before = [M.copy() for M in system]
    CALLS[name](system)
    for one, two in zip(before, system, strict=True):
        np.testing.assert_array_equal(one, two)
        assert two.flags.writeable


@pytest.mark.parametrize("name", PUBLIC)
def test_docstrings_name_their_sections(name: str) -> None:
    function = getattr(response, name)
    text = inspect.getdoc(function)
    for section in ("Parameters", "Returns", "Raises"):
        assert f"{section}\n---" in text, section
    for parameter in inspect.signature(function).parameters.values():
        assert parameter.kind != inspect.Parameter.VAR_KEYWORD
        assert re.search(rf"^.*\b{parameter.name}\b.* :", text, re.MULTILINE), parameter.name


def test_results_are_frozen() -> None:
    found = response.margins(gallery.lag_chain(2, 1.0))
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.gain_margin = 1.0
    for name in response.__all__:
        item = getattr(response, name)
        if dataclasses.is_dataclass(item):
            assert item.__dataclass_params__.frozen, name


def test_source_keeps_the_rules_of_the_house() -> None:
    for path in pathlib.Path(response.__file__).parent.glob("*.py"):
        text = path.read_text()
        assert len(text.splitlines()) <= 400, path.name
        assert not re.search(r"^\s*assert\b", text, re.MULTILINE), path.name
        assert not re.search(r"\bp?inv\(|except:", text), path.name
        assert not re.search(
            r"^(import|from) (control|matplotlib|casadi|numba)", text, re.MULTILINE
        ), path.name
