"""What each annotation takes and refuses: a table by hand, value by value."""

import collections.abc as abc
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, runtime_checkable

import numpy as np
import pytest

from cellsys.kinds import Count, Filled, Kind, Seed, Takes, Whole, kind_of, shown


@runtime_checkable
class Speaks(Protocol):
    volume: float

    def say(self) -> str: ...


class Dog:
    volume = 3.0

    def say(self):
        return "woof"


class Mute:
    volume = 0.0


class Lazily:
    """Its parts are made when they are asked for."""

    def __getattr__(self, name):
        if name in ("volume", "say"):
            return lambda: name
        raise AttributeError(name)


def numbers():
    yield 1.0


NUMBERS = [1.0, -2, np.float32(3), np.int64(4), np.array(5.0)]
NO_NUMBERS = [True, np.True_, "1", None, [1.0], 1j, np.array([1.0]), 2**64, np.array(1j)]
WHOLE = [0, -3, np.int8(4), np.array(7), 2**63 - 1, -(2**63)]
NO_WHOLE = [True, 1.0, "1", None, np.array([1]), 2**63, -(2**63) - 1, np.float64(2)]
ARRAYS = [np.zeros(3), [1, 2.5], (1, 2), [[1, 2], [3, 4]], 3.0, range(3), np.array([1, 2], object)]
NO_ARRAYS = [
    "text",
    None,
    [[1], [1, 2]],
    np.array(["a"]),
    {"a": 1},
    np.array([None], object),
    ["a"],
]
TABLE = [
    (float, NUMBERS, NO_NUMBERS),
    (int, WHOLE, NO_WHOLE),
    (bool, [True, np.False_], [0, 1, "True", None]),
    (str, ["", "a"], [b"a", None, 1, Path("a")]),
    (Path, [Path("a")], ["a", None]),
    (complex, [1j, 1.0, 2, np.complex64(1)], [True, "1j", None]),
    (np.ndarray, ARRAYS, NO_ARRAYS),
    (None, [None], [0, False, ""]),
    (Seed, [0, 5, 2**200], [-1, 1.5, True, "3", None]),
    (Whole, [0, 5], [-1, 2**63, True, 0.0]),
    (Count, [1, 5], [0, -1, 2**63, True]),
    (Literal["up", "down"], ["up", "down"], ["Up", "", None, 1, ["up"]]),
    (type, [int, Dog], [1, None, Dog()]),
    (type[Dog], [Dog], [Mute, Dog(), None]),
    (float | None, [None, 1.0], ["1", True]),
    (Filled[float], [None, 1.0], ["1"]),
    (Annotated[float, Takes(str)], ["x"], [1.0, None]),
    (Annotated[int, "a year"], [2026], ["2026", 1.0]),
    (Annotated[float, "a rate", 3], [1.0], ["1"]),
    (Annotated[float, 3], [1.0], ["1"]),
    (Any, [None, 1, Dog()], []),
    (Callable[[float], float], [len, lambda x: x, Dog], [1, "len", None]),
    (Sequence[float], [[], [1.0, 2], (3,), np.zeros(2), np.arange(3)],
     ["12", b"12", [1.0, "a"], np.zeros((2, 2)), np.array(1.0), None, 3.0, numbers(), {1.0: 2}]),
    (Sequence[int], [[1], np.arange(2)], [np.zeros(2), [1.0]]),
    (Sequence[complex], [np.zeros(2), np.array([1j]), [1j]], [np.array(["a"]), [None]]),
    (Sequence[str], [["a"], ("a", "b"), {"a": 1}.keys(), {"a"}], ["a", ["a", 1], np.zeros(2)]),
    (Iterable[float], [[1.0], np.zeros(2), numbers(), iter([1])], ["1", b"1", 1.0, None, [None]]),
    (list, [[], [None, "a"]], ["a", None, 3]),
    (abc.Set[str], [{"a"}, frozenset(), {"a": 1}.keys()], [{1}, "a", None]),
    (tuple[float, str], [(1.0, "a"), [2, "b"]], [("a", 1.0), (1.0,), (1.0, "a", "b"), "ab", None]),
    (tuple[float, float], [np.zeros(2)], [np.zeros(3), np.array(1.0), np.zeros((2, 2))]),
    (tuple[float, ...], [(), (1.0,) * 5], [(None,), "1"]),
    (Mapping[str, float], [{}, {"a": 1}], [{"a": "b"}, {1: 1.0}, [("a", 1)], None]),
    (Mapping, [{1: None}], [[], None]),
    (Dog, [Dog()], [Dog, Mute(), None]),
    (Speaks, [Dog(), Lazily()], [Mute(), None, 3]),
]  # fmt: skip
CASES = [
    pytest.param(kind, value, good, id=f"{kind}-{shown(value)}"[:70])
    for kind, taken, refused in TABLE
    for good, values in ((True, taken), (False, refused))
    for value in values
]


@pytest.mark.parametrize(("annotation", "value", "good"), CASES)
def test_what_is_taken(annotation, value, good):
    found = kind_of(annotation)
    assert isinstance(found, Kind)
    fault = found.fault(value)
    assert (fault is None) == good, fault
    assert found.fault(value) == fault  # a union that remembers what it took says the same


def test_an_iterator_is_not_used_up():
    given = numbers()
    assert kind_of(Iterable[float]).fault(given) is None
    assert next(given) == 1.0


@pytest.mark.parametrize(
    ("annotation", "value", "words"),
    [
        (float, "5 um", "must be a number, got '5 um'"),
        (float, 2**64, "write it as 1e30"),
        (int, 2**64, r"a whole number between -2\^63 and 2\^63"),
        (int, 1.5, "must be a whole number, got 1.5"),
        (float | None, "x", "must be a number or None, got 'x'"),
        (float | str | None, [1], "must be a number, a text or None, got a list of 1"),
        (Literal["a", "b"], 1, "must be 'a' or 'b', got 1"),
        (Sequence[float], [1.0, "a"], r"\[1\] must be a number, got 'a'"),
        (Sequence[str], np.zeros(1), "put a single one into"),
        (Mapping[str, float], {"k": None}, r"\['k'\] must be a number, got None"),
        (Mapping[str, float], {3: 1.0}, ": a key must be a text, got 3"),
        (tuple[float, str], (1.0, 2.0), r"\[1\] must be a text, got 2.0"),
        (tuple[float, str], (1.0,), "must be 2 values: a number, a text; got a tuple of 1"),
        (Annotated[int, "a year"], "x", "must be a year, got 'x'"),
        (Dog, 1, "must be a Dog, got 1"),
        (Speaks, Mute(), "say"),
    ],
)  # fmt: skip
def test_the_message_names_what_is_wrong(annotation, value, words):
    fault = kind_of(annotation).fault(value)
    assert fault is not None
    assert re.search(words, fault), fault


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Dog, "the class Dog"), (10**5000, "a whole number of about 5000 digits"), (None, "None"),
        (2**128 - 1, str(2**128 - 1)), (np.float64(2.5), "2.5"), ("a" * 60, repr("a" * 60)),
        ("a" * 61, repr("a" * 60) + "..."), ([], "[]"), ([1, 2], "a list of 2"), ({}, "{}"),
        (np.zeros((2, 3)), "an array of float64 and shape (2, 3)"), (Dog(), "a Dog"),
    ],
    ids=range(12),
)  # fmt: skip
def test_a_value_is_shown_short(value, text):
    assert shown(value) == text
