"""One error boundary: every public callable refuses a wrong kind of argument by its name."""

import dataclasses
import inspect
import types
import typing

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import CellsysError, ParameterError
from cellsys.samples import RunData
from tests.good_arguments import good, hints, oscillator, public
from tests.good_arguments import model as steered

CALLABLES = public()
WRONG = {
    "None": None,
    "text": "text",
    "array": np.arange(6.0).reshape(2, 3),
    "object": object(),
}
FOREIGN = ("None", "object")  # never of the right kind, unless the annotation says so
# These take anything and say themselves what they cannot work with.
ANYTHING = {("write_json", "value"), ("fingerprint", "parts")}


def takes_none(annotation):
    return annotation in (typing.Any, object, type(None)) or (
        typing.get_origin(annotation) in (typing.Union, types.UnionType)
        and type(None) in typing.get_args(annotation)
    )


def takes_text(annotation):
    return str in (annotation, *typing.get_args(annotation))


def said(item, arguments, name, value):
    """What came of a call with `value` for the parameter `name` among good arguments."""
    call = {**arguments, name: value}
    parameters = inspect.signature(item).parameters
    first = [
        call.pop(p.name)
        for p in parameters.values()
        if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) and p.name in arguments
    ]
    try:
        item(*first, **call)
    except CellsysError as error:
        return "named" if name in str(error) else f"not named: {error}"
    except OSError:
        return "no such file"
    except Exception as error:
        return f"raw {type(error).__name__}: {error}"
    return "taken"


@pytest.mark.parametrize("name", CALLABLES)
def test_wrong_kinds_are_refused_by_name(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    item, wrong = CALLABLES[name], []
    arguments, known = good(name, item), hints(item)
    if inspect.isabstract(item):  # what derives from it is made in its place
        given = dict.fromkeys(item.__abstractmethods__, lambda self, *more: None)
        item = type(item.__name__, (item,), given)
    for p in inspect.signature(item).parameters.values():
        if p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD):
            continue
        needed = p.default is p.empty
        for label in WRONG if needed else ("object",):
            if label == "text" and takes_text(known[p.name]):
                continue
            found = said(item, arguments, p.name, WRONG[label])
            free = (name, p.name) in ANYTHING or (label == "None" and takes_none(known[p.name]))
            if found.startswith("raw") or (label in FOREIGN and found != "named" and not free):
                wrong.append(f"{p.name} = {label}: {found}")
    assert not wrong, "\n".join(wrong)


X = np.random.default_rng(0).standard_normal((20, 2)).cumsum(axis=0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: cs.snapshots(X, dt=0.5), r"runs must be a list.*put a single one into \[\.\.\.\]"),
        (lambda: cs.snapshots("a.csv"), "runs must be a list"),
        (lambda: cs.snapshots([RunData(x=X, commands=X[1:, 0])], dt=0.5), "commands of run 0"),
        (lambda: cs.snapshots([RunData(x=X, eta=X[1:, 0])], dt=0.5), "eta of run 0"),
        (lambda: cs.snapshots([RunData(x=X[:, 0])], dt=0.5), "x of run 0"),
        (lambda: cs.snapshots([X], dt=0.5, blocks={}), "each of the 2 columns"),
        (lambda: cs.snapshots([X], dt=10**5000), "dt must be a number"),
        (lambda: cs.simulate(oscillator(), None, [0.0, 1.0]), "integrator must be"),
        (lambda: cs.closed_loop(None), "model must be"),
        (lambda: cs.couple(steered(), 2, controller=[1.0]), "controller must be a PolarityLaw"),
    ],
)
def test_reported_calls(call, words):
    with pytest.raises(CellsysError, match=words):
        call()


@pytest.mark.parametrize("order", [1, 2])
def test_a_model_without_inputs_has_poles(order):
    """python-control takes a B of shape (1, 0) for one of shape (0, 0)."""
    data = cs.snapshots([X], dt=0.5)
    model = cs.reduce(data, order=order, method=cs.LeastSquares())
    expected = np.log(np.linalg.eigvals(np.eye(order) + 0.5 * model.A)) / 0.5
    for plant in (model.plant(), model.plant(output=np.ones((1, order)))):
        # an eigenvalue of a 2 x 2 to rounding, and a logarithm
        np.testing.assert_allclose(np.sort(cs.poles(plant)), np.sort(expected), atol=1e-12)
    assert len(cs.pole_certainty(data, cs.LeastSquares(), order).poles) == order


def test_what_a_model_without_a_loop_cannot_use_is_refused():
    without = dataclasses.replace(steered(), sensor=None)
    for given in ({"headings": [0.0, 1.0]}, {"controller": cs.PolarityLaw()},
                  {"normalise": False}):  # fmt: skip
        with pytest.raises(ParameterError, match=f"{next(iter(given))}.*lacks a sensor"):
            cs.couple(without, 2, **given)
    assert cs.couple(without, 2).n_cells == 2
    assert cs.couple(steered(), 2, headings=[0.0, 1.0]).n_cells == 2
