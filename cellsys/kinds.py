"""What an annotation asks of a value: its kind, in words and as a test.

    float, int, bool, str          numbers of Python or numpy; a truth value is no number
    np.ndarray                     what numpy turns into an array of numbers; of a function that
                                   is no method: of real ones, NDArray[...] of any
    Sequence[K], tuple, Mapping    their entries too, where looking uses nothing up
    a class, type[...], Literal    an instance, a subclass, one of the values
    a Protocol                     what the value lacks is named
    Annotated[K, "text"]           K, called by the text in the message
    Annotated[X, Takes(K)]         K: what is given, where what is kept is a narrower X
    Filled[X]                      X or None: of a field left out, `__post_init__` makes the X
    Annotated[X, Kind(...)]        a kind of one's own, such as `Seed`, `Whole` and `Count` below

A class may say in ``_made_by`` how one comes by it. Only the kind is looked at: what a value must
be besides, finite or above zero, is checked where it is used.
"""

from __future__ import annotations

import collections.abc as abc
import functools
import inspect
import operator
import types
import typing
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, SupportsIndex, TypeGuard, TypeVar, Union

import numpy as np

_LONGEST = 60  # characters of a text that a message shows
_NUMBERS = "biufc"  # dtypes of numbers


class Kind(NamedTuple):
    """What a value must be, in words, and what is wrong with one (None: nothing)."""

    what: str
    fault: Callable[[object], str | None]


class Takes(NamedTuple):
    """In ``Annotated[X, Takes(K)]``: a field of type X may be given as K."""

    kind: object


_T = TypeVar("_T")
_OR_NONE = Takes(None)  # beside the kind itself
Filled = Annotated[_T, _OR_NONE]
FILLED: Any = None  # the default of such a field


def given_as(annotation: object) -> object:
    """What may be given where a value is kept as annotated."""
    if typing.get_origin(annotation) is Annotated:
        kept, *notes = typing.get_args(annotation)
        for note in notes:
            if isinstance(note, Takes):
                return kept | None if note is _OR_NONE else note.kind
    return annotation


def shown(value: object) -> str:
    """A value as a message shows it: short, whatever it is."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, int) and value.bit_length() > 128:
        # Python writes no more than 4300 digits.
        return f"a whole number of about {int(value.bit_length() * 0.30103)} digits"
    if isinstance(value, np.generic):  # first: a float64 is a float
        return repr(value.item())
    if value is None or isinstance(value, (bool, int, float, complex)):
        return repr(value)
    if isinstance(value, (str, bytes)):
        return repr(value) if len(value) <= _LONGEST else f"{value[:_LONGEST]!r}..."
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype.name} and shape {value.shape}"
    if isinstance(value, (list, tuple, dict, set, frozenset)):
        return f"a {type(value).__name__} of {len(value)}" if value else repr(value)
    return f"a {type(value).__name__}"


def _must_be(what: str, test: Callable[[object], bool]) -> Kind:
    def fault(value: object) -> str | None:
        return None if test(value) else f" must be {what}, got {shown(value)}"

    return Kind(what, fault)


def _is_real(value: object) -> bool:
    if isinstance(value, float):
        return True
    if isinstance(value, (bool, np.bool_)):
        return False
    if isinstance(value, int):
        return value.bit_length() < 64  # numpy takes no longer one for a number
    return isinstance(value, (np.integer, np.floating)) or (
        isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"
    )


def _is_whole(value: object) -> bool:
    return _is_from(-(2**63), value)


def _is_from(least: int, value: object) -> bool:
    whole = _whole(value)
    return whole is not None and least <= whole < 2**63


def _whole(value: object) -> int | None:
    """A whole number of any size as an int; None where it is none."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, SupportsIndex):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None


def _is_array(value: object, dtypes: str = _NUMBERS) -> bool:
    if isinstance(value, np.ndarray):
        if value.dtype.kind != "O":
            return value.dtype.kind in dtypes
        return all(_is_number(v) for v in value.flat)
    if isinstance(value, (list, tuple, range, int, float, complex, np.generic)):
        try:
            return _is_array(np.asarray(value), dtypes)
        except ValueError:  # rows of different lengths
            return False
    # Arrays that are read when they are needed: maps of a file, tables of other packages.
    return callable(getattr(type(value), "__array__", None))


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, complex, np.number, np.bool_))


def _fault_of_real(value: object) -> str | None:
    if _is_real(value):
        return None
    long = isinstance(value, int) and not isinstance(value, bool)
    return f" must be a number, got {shown(value)}" + ("; write it as 1e30" if long else "")


def _fault_of_whole(value: object) -> str | None:
    if _is_whole(value):
        return None
    bound = "" if _whole(value) is None else " between -2^63 and 2^63"
    return f" must be a whole number{bound}, got {shown(value)}"


_FUNCTION: object = abc.Callable
_ANYTHING = Kind("anything", lambda value: None)
_PLAIN: dict[object, Kind] = {
    Any: _ANYTHING,
    object: _ANYTHING,
    float: Kind("a number", _fault_of_real),
    int: Kind("a whole number", _fault_of_whole),
    complex: _must_be("a number", lambda v: _is_number(v) and not isinstance(v, bool)),
    bool: _must_be("True or False", lambda v: isinstance(v, (bool, np.bool_))),
    str: _must_be("a text", lambda v: isinstance(v, str)),
    Path: _must_be("a path", lambda v: isinstance(v, Path)),
    np.ndarray: _must_be("an array of numbers", _is_array),
    type(None): _must_be("None", lambda v: v is None),
    None: _must_be("None", lambda v: v is None),
}
REAL_ARRAY = _must_be("an array of real numbers", lambda v: _is_array(v, "biuf"))


def _is_seed(value: object) -> bool:
    whole = _whole(value)
    return whole is not None and whole >= 0


ComplexArray = Annotated[np.ndarray, _must_be("an array of numbers", _is_array)]
Seed = Annotated[int, _must_be("a whole number >= 0", _is_seed)]
Whole = Annotated[int, _must_be("a whole number >= 0", lambda v: _is_from(0, v))]
Count = Annotated[int, _must_be("a whole number >= 1", lambda v: _is_from(1, v))]


@functools.cache
def kind_of(annotation: object) -> Kind:
    """The kind that an annotation stands for; annotations it does not know hold for anything."""
    annotation = given_as(annotation)
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    origin, inside = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        for note in inside[1:]:
            if isinstance(note, Kind):
                return note
            if isinstance(note, str):
                return _called(kind_of(inside[0]), note)
        return kind_of(inside[0])
    if origin in (Union, types.UnionType):
        return _any_of([kind_of(a) for a in inside])
    if origin is Literal:
        return _must_be(
            _listed([repr(v) for v in inside]), lambda v: isinstance(v, str) and v in inside
        )
    if origin is type:
        wanted = inside[0]
        if not isinstance(wanted, type):
            return _must_be("a class", lambda v: isinstance(v, type))
        return _must_be(
            f"a class of {wanted.__name__}",
            lambda v: isinstance(v, type) and issubclass(v, wanted),
        )
    if origin is np.ndarray:
        return _PLAIN[np.ndarray]
    if origin is tuple and Ellipsis not in inside:
        return _tuple_of([kind_of(a) for a in inside])
    found = origin or annotation
    if not isinstance(found, type):
        return _ANYTHING  # a type variable
    if issubclass(found, abc.Mapping):
        return _mapping_of(*(map(kind_of, inside) if len(inside) == 2 else (_ANYTHING,) * 2))
    if found is _FUNCTION:
        return _must_be("a function", callable)
    if found in (list, tuple, set, frozenset) or found in (abc.Sequence, abc.Iterable, abc.Set):
        return _many_of(kind_of(inside[0]) if inside else _ANYTHING, found is abc.Iterable)
    if getattr(found, "_is_protocol", False):
        return _with_parts_of(found)
    return _instance_of(found)


def _listed(names: Iterable[str]) -> str:
    *first, last = dict.fromkeys(names)
    return f"{', '.join(first)} or {last}" if first else last


def _called(kind: Kind, text: str) -> Kind:
    def fault(value: object) -> str | None:
        return None if kind.fault(value) is None else f" must be {text}, got {shown(value)}"

    return Kind(text, fault)


def _any_of(kinds: list[Kind]) -> Kind:
    none = _PLAIN[None]
    others = [k for k in kinds if k is not none]
    what = _listed([k.what for k in others] + ["None"] * (len(others) < len(kinds)))

    usual: dict[type, Kind] = {}  # what took a value of this type before is asked first

    def fault(value: object) -> str | None:
        before = usual.get(type(value))
        if before is not None and before.fault(value) is None:
            return None
        for kind in kinds:
            if kind.fault(value) is None:
                usual[type(value)] = kind
                return None
        if len(others) == 1 and value is not None:
            return others[0].fault(value)
        return f" must be {what}, got {shown(value)}"

    return Kind(what, fault)


def _is_row(value: object) -> TypeGuard[Sequence[object]]:
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, (tuple, list))


def _tuple_of(kinds: list[Kind]) -> Kind:
    what = f"{len(kinds)} values: {', '.join(k.what for k in kinds)}"

    def fault(value: object) -> str | None:
        if not _is_row(value) or len(value) != len(kinds):
            return f" must be {what}; got {shown(value)}"
        both = zip(kinds, value, strict=True)
        return _first_fault((f"[{i}]", k, v) for i, (k, v) in enumerate(both))

    return Kind(what, fault)


def _many_of(kind: Kind, once: bool) -> Kind:
    """Several values; an array where they are numbers. `once`: an iterator will do, unread."""
    what = "a list" if kind is _ANYTHING else f"a list, each entry {kind.what}"
    dtypes = {_PLAIN[int]: "iu", _PLAIN[float]: "iuf", _PLAIN[complex]: "iufc"}.get(kind, "")

    def fault(value: object) -> str | None:
        if isinstance(value, np.ndarray) and value.ndim > 0:
            if kind is _ANYTHING or (value.ndim == 1 and value.dtype.kind in dtypes):
                return None
            alone = "" if dtypes else "; put a single one into [...]"
            return f" must be {what}, got {shown(value)}{alone}"
        if isinstance(value, (abc.Sequence, abc.Set, abc.KeysView, abc.ValuesView)) and not (
            isinstance(value, (str, bytes))
        ):
            return _first_fault((f"[{i}]", kind, v) for i, v in enumerate(value))
        if once and isinstance(value, abc.Iterable) and not isinstance(value, (str, bytes)):
            return None
        return f" must be {what}, got {shown(value)}"

    return Kind(what, fault)


def _mapping_of(key: Kind, entry: Kind) -> Kind:
    what = "a mapping" if key is _ANYTHING else f"a mapping from {key.what} to {entry.what}"

    def fault(value: object) -> str | None:
        if not isinstance(value, abc.Mapping):
            return f" must be {what}, got {shown(value)}"
        return _first_fault((": a key", key, k) for k in value) or _first_fault(
            (f"[{shown(k)}]", entry, v) for k, v in value.items()
        )

    return Kind(what, fault)


def _first_fault(entries: Iterable[tuple[str, Kind, object]]) -> str | None:
    for place, kind, value in entries:
        if (fault := kind.fault(value)) is not None:
            return place + fault
    return None


def _instance_of(wanted: type) -> Kind:
    made_by = getattr(wanted, "_made_by", None)
    article = "an" if wanted.__name__[0] in "AEIO" else "a"
    what = f"{article} {wanted.__name__}" + (f", made by {made_by}" if made_by else "")
    return _must_be(what, lambda v: isinstance(v, wanted))


def parts_of(protocol: type) -> tuple[str, ...]:
    """Names that a Protocol asks for."""
    found: dict[str, None] = {}
    for base in protocol.__mro__:
        if getattr(base, "_is_protocol", False):
            found |= dict.fromkeys(n for n in vars(base) if not n.startswith("_"))
            found |= dict.fromkeys(inspect.get_annotations(base))
    return tuple(found)


def _has(value: object, name: str) -> bool:
    """Whether it has the attribute, without computing it; what is made on demand is asked for."""
    if name in getattr(value, "__dict__", ()) or hasattr(type(value), name):
        return True
    missing = object()
    if inspect.getattr_static(value, name, missing) is not missing:
        return True
    return hasattr(type(value), "__getattr__") and hasattr(value, name)


def _with_parts_of(protocol: type) -> Kind:
    wanted = parts_of(protocol)
    first = (protocol.__doc__ or protocol.__name__).strip().partition("\n")[0].rstrip(".")
    what = first[0].lower() + first[1:]

    def fault(value: object) -> str | None:
        lacks = wanted if isinstance(value, type) else [n for n in wanted if not _has(value, n)]
        if not lacks:
            return None
        if len(lacks) == len(wanted):
            return f" must be {what}, got {shown(value)}"
        return f" must be {what}; {shown(value)} has no {', '.join(lacks)}"

    return Kind(what, fault)
