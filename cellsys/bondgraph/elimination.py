"""Exact incremental elimination: the solution set of linear relations, v = Z v_free.

Numbers are integers and fractions, so that a rank decision is never a matter of rounding.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction

Number = int | Fraction


def rational(value: float) -> Number:
    """The simplest fraction that rounds to the same double as `value`: 0.1 -> 1/10, 1/3 -> 1/3."""
    exact = Fraction(value)
    for limit in (10**3, 10**6, 10**9, 10**12):
        near = exact.limit_denominator(limit)
        if float(near) == value:
            exact = near
            break
    return exact.numerator if exact.denominator == 1 else exact


def _divide(a: Number, b: Number) -> Number:
    if b == 1:
        return a
    if b == -1:
        return -a
    quotient = Fraction(a) / b
    return quotient.numerator if quotient.denominator == 1 else quotient


class SolutionSet:
    """All v with given homogeneous relations, each variable a combination of the free ones.

    `relate` adds a relation; `fix` makes a variable one of the free ones for good, by exchanging
    it against a free variable that is not fixed yet. One exchange costs at most
    O(variables x free variables), hence O(n^3) in all; junction structures are sparse and cost
    far less.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.rows: dict[int, dict[int, Number]] = {}
        self.users: dict[int, set[int]] = {k: set() for k in range(size)}
        self.fixed: list[int] = []
        self._is_fixed = [False] * size

    def row(self, variable: int) -> Mapping[int, Number]:
        """The variable as a combination of free variables."""
        return self.rows.get(variable, {variable: 1})

    def free(self) -> list[int]:
        """Free variables that are not fixed: determined by nothing so far."""
        return [k for k in range(self.size) if k not in self.rows and not self._is_fixed[k]]

    def relate(self, coefficients: Mapping[int, Number]) -> bool:
        """Add sum of coefficient x variable = 0; False when it follows from what is there."""
        total: dict[int, Number] = {}
        for variable, c in coefficients.items():
            for k, a in self.row(variable).items():
                total[k] = total.get(k, 0) + c * a
        total = {k: a for k, a in total.items() if a}
        pivot = self._pivot(total)
        if pivot is None:
            return False
        c = total.pop(pivot)
        self._make_basic(pivot, {k: _divide(-a, c) for k, a in total.items()})
        return True

    def fix(self, variable: int) -> bool:
        """Make the variable free and fixed; False when fixed variables already determine it."""
        if variable in self.rows:
            row = dict(self.rows[variable])
            pivot = self._pivot(row)
            if pivot is None:
                return False
            for k in row:
                self.users[k].discard(variable)
            del self.rows[variable]
            c = row.pop(pivot)
            entering = {k: _divide(-a, c) for k, a in row.items()}
            entering[variable] = _divide(1, c)
            self._make_basic(pivot, entering)
        elif self._is_fixed[variable]:
            return False
        self._is_fixed[variable] = True
        self.fixed.append(variable)
        return True

    def release(self, variable: int) -> None:
        """Undo `fix`: the variable stays free, but may be exchanged again."""
        self.fixed.remove(variable)
        self._is_fixed[variable] = False

    def reason(self, variable: int) -> list[int]:
        """The fixed variables that determine this one."""
        return [k for k in self.row(variable) if self._is_fixed[k]]

    def _pivot(self, row: Mapping[int, Number]) -> int | None:
        best, cost = None, None
        for k, a in self._open(row):
            this = (abs(a) != 1, len(self.users[k]))
            if cost is None or this < cost:
                best, cost = k, this
        return best

    def _open(self, row: Mapping[int, Number]) -> Iterable[tuple[int, Number]]:
        return ((k, a) for k, a in row.items() if not self._is_fixed[k])

    def _make_basic(self, variable: int, row: dict[int, Number]) -> None:
        for user in self.users[variable]:
            target = self.rows[user]
            c = target.pop(variable)
            for k, a in row.items():
                value = target.get(k, 0) + c * a
                if value:
                    target[k] = value
                    self.users[k].add(user)
                elif k in target:
                    del target[k]
                    self.users[k].discard(user)
        self.users[variable] = set()
        self.rows[variable] = row
        for k in row:
            self.users[k].add(variable)
