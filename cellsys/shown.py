"""What a notebook shows of a result: its first line, and its table."""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Mapping, Sequence
from numbers import Number

import numpy as np

_ROWS = 60  # of a table


class Shown:
    """Mixin of results that say what they are in `str`: `repr` is its first line.

    A notebook draws the table: the rows of the result where it has any, else its text.
    """

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        # `dataclass` writes a __repr__ of all fields unless the class has one of its own.
        if cls.__str__ is not object.__str__ and "__repr__" not in vars(cls):
            cls.__repr__ = Shown.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        if type(self).__str__ is object.__str__:
            return object.__repr__(self)
        return str(self).partition("\n")[0]

    def _repr_html_(self) -> str:
        head, _, rest = str(self).partition("\n")
        found = self._rows()
        body = table_html(*found) if found else f"<pre>{html.escape(rest)}</pre>" * bool(rest)
        return f"<p>{html.escape(head)}</p>{body}"

    def _rows(self) -> tuple[Sequence[str], Sequence[Sequence[object]]] | None:
        """Names and rows of the table: of the first field that holds rows; None without one."""
        for field in _fields(self):
            value = getattr(self, field.name)
            if isinstance(value, (tuple, list)) and value and dataclasses.is_dataclass(value[0]):
                names = [
                    f.name for f in dataclasses.fields(value[0])
                    if isinstance(getattr(value[0], f.name), (str, Number))
                ]  # fmt: skip
                if names:
                    return names, [[getattr(row, n) for n in names] for row in value]
            if (
                isinstance(value, Mapping)
                and value
                and all(isinstance(v, Mapping) and v for v in value.values())
            ):
                names = list(dict.fromkeys(n for v in value.values() for n in v))
                return ["", *names], [[k, *(v.get(n, "") for n in names)] for k, v in value.items()]
        return self._columns()

    def _columns(self) -> tuple[Sequence[str], Sequence[Sequence[object]]] | None:
        """The fields that are columns of one length, where there are two or more."""
        found: dict[int, dict[str, np.ndarray]] = {}
        for field in _fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray) and value.ndim == 1 and value.size:
                found.setdefault(len(value), {})[field.name] = np.asarray(value)
        columns = max(found.values(), key=len, default={})
        if len(columns) < 2:
            return None
        rows = zip(*(c.tolist() for c in columns.values()), strict=True)
        return list(columns), [list(row) for row in rows]


def _fields(item: object) -> tuple[dataclasses.Field[object], ...]:
    if isinstance(item, type) or not dataclasses.is_dataclass(item):
        return ()
    return dataclasses.fields(item)


def table_html(names: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """An HTML table; numbers with four digits, at most 60 rows and a line that says the rest."""

    def cell(value: object) -> str:
        number = isinstance(value, (float, complex)) and not isinstance(value, bool)
        return html.escape(f"{value:.4g}" if number else str(value))

    head = "".join(f"<th>{html.escape(n)}</th>" for n in names)
    lines = [f"<tr>{''.join(f'<td>{cell(v)}</td>' for v in row)}</tr>" for row in rows[:_ROWS]]
    if len(rows) > _ROWS:
        lines.append(f'<tr><td colspan="{len(names)}">... and {len(rows) - _ROWS} more</td></tr>')
    return f"<table><tr>{head}</tr>{''.join(lines)}</table>"
