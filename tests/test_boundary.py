"""One error boundary: every public callable refuses a wrong kind of argument by its name."""

import inspect
import types
import typing

import numpy as np
import pytest

from cellsys.errors import CellsysError
from tests.good_arguments import good, hints, public

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
    for p in inspect.signature(item).parameters.values():
        if p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD):
            continue
        needed = p.default is p.empty
        for label in WRONG if needed else ("object",):
            if label == "text" and takes_text(known[p.name]):
                continue
            found = said(item, arguments, p.name, WRONG[label])
            free = (name, p.name) in ANYTHING or (label == "None" and takes_none(known[p.name]))
            if found.startswith("raw") or (
                label in FOREIGN and found != "named" and not free
            ):
                wrong.append(f"{p.name} = {label}: {found}")
    assert not wrong, "\n".join(wrong)
