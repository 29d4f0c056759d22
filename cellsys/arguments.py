"""Arguments of public functions: one of a wrong kind is refused by its name.

`checked` stands before a public function or class and holds every argument against its
annotation (`cellsys.kinds`); `needs` does the same for one value. Where an array is taken, lists
of numbers are handed on as one.
"""

from __future__ import annotations

import functools
import inspect
import types
import typing
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from cellsys.errors import ParameterError
from cellsys.kinds import REAL_ARRAY, given_as, kind_of

_T = TypeVar("_T", bound=Callable[..., object])
_MANY = 100  # arguments of a *name that are looked at
_LISTED = (list, tuple, range, int, float, complex)  # what becomes an array where one is taken


def needs(value: object, kind: object, name: str) -> None:
    """Refuse a value of a wrong kind.

    Parameters
    ----------
    value : object
    kind : annotation
        A class, a union, a Protocol or any other annotation of the list above.
    name : str
        What the value is called in the message.

    Raises
    ------
    ParameterError
        With the name, what is needed, and what was given or what it lacks.
    """
    fault = kind_of(kind).fault(value)
    if fault is not None:
        raise ParameterError(f"{name}{fault}")


def checked(item: _T) -> _T:
    """Hold the arguments of a public function, or class, against their annotations.

    Of a class, those of its constructor and of the public methods written in it; `unchecked` ones
    are left alone.

    Parameters
    ----------
    item : function or class

    Returns
    -------
    function or class
        Which raises `ParameterError` for an argument of a wrong kind, before anything is done.
    """
    if not isinstance(item, type):
        return _guarded(item, item, REAL_ARRAY.fault)
    made = "__init__" if "__init__" in vars(item) else "__new__"
    for name, part in list(vars(item).items()):
        function = part.__func__ if isinstance(part, (staticmethod, classmethod)) else part
        if not isinstance(function, types.FunctionType) or hasattr(function, "_unchecked"):
            continue
        if name == made:
            # The fields of a base class are annotated in its own module.
            fields = issubclass(item, tuple) or "__dataclass_fields__" in vars(item)
            setattr(item, name, _guarded(function, item if fields else function))
        elif not name.startswith("_") or name == "__call__":
            around = type(part) if part is not function else lambda f: f
            setattr(item, name, around(_guarded(function, function)))
    return item


def unchecked(method: _T) -> _T:
    """A method that `checked` leaves alone: of an inner loop, or given CasADi symbols."""
    method._unchecked = True  # type: ignore[attr-defined]
    return method


def _hints(item: Callable[..., object] | type) -> dict[str, object]:
    """Resolved annotations of the fields of a class, or of the parameters of a function."""
    if isinstance(item, type):
        return typing.get_type_hints(item, include_extras=True)

    def taking() -> None:
        """Not what it returns: that may be named for type checkers alone."""

    written = inspect.unwrap(item)
    given = inspect.get_annotations(written)
    taking.__annotations__ = {name: kind for name, kind in given.items() if name != "return"}
    return typing.get_type_hints(taking, written.__globals__, include_extras=True)


def _guarded(
    function: Callable[..., object],
    annotated: Callable[..., object],
    of_arrays: Callable[[object], str | None] | None = None,
) -> Any:
    """The function behind its checks; `of_arrays`: that of arrays, where it is another one."""
    parameters = list(inspect.signature(function).parameters.values())
    known: dict[str, _Place] = {}
    places: list[_Place] = []

    def prepare() -> None:
        # At the first call: the modules that the annotations name are all loaded by then.
        hints = _hints(annotated)
        found = {p.name: _Place(p.name, hints.get(p.name, Any), of_arrays) for p in parameters}
        places[:] = [
            found[p.name]
            for p in parameters
            if p.kind not in (p.KEYWORD_ONLY, p.VAR_KEYWORD)
            for _ in range(_MANY if p.kind is p.VAR_POSITIONAL else 1)
        ]
        known.update(found)

    @functools.wraps(function)
    def guarded(*args: object, **kwargs: object) -> object:
        if not known:
            prepare()
        given = [place.take(value) for place, value in zip(places, args, strict=False)]
        given += args[len(given) :]
        for name, value in kwargs.items():
            if name in known:
                kwargs[name] = known[name].take(value)
        return function(*given, **kwargs)

    guarded._prepare = prepare  # type: ignore[attr-defined]
    return guarded


class _Place:
    """A parameter: its name and what it takes."""

    def __init__(
        self, name: str, annotation: object, of_arrays: Callable[[object], str | None] | None
    ) -> None:
        self.name, self.fault = name, kind_of(annotation).fault
        self.is_array = given_as(annotation) in (np.ndarray, np.ndarray | None)
        # None is looked for first: most parameters are left out most of the time.
        self.optional = self.fault(None) is None
        if self.is_array and of_arrays is not None:
            self.fault = of_arrays

    def take(self, value: object) -> object:
        """The value, numbers in lists as an array; ParameterError for a wrong kind."""
        if value is None and self.optional:
            return None
        if (fault := self.fault(value)) is not None:
            raise ParameterError(self.name + fault)
        return np.asarray(value) if self.is_array and isinstance(value, _LISTED) else value
