"""Do two runs of the main job say the same? Every number to its last digit, times apart.

    python -m tests.same_summary OLD/summary.json NEW/summary.json

Prints what differs and ends with exit code 1, or says how many values are equal.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

# What a clock, a path or the version says: equal only by chance.
FREE = ("seconds", "wall_time_s", "full_order_s", "ms", "version", "out", "key")


def leaves(value: object, place: str = "") -> Iterator[tuple[str, object]]:
    """(place, value) of every number, text and null."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield from leaves(part, f"{place}.{name}" if place else str(name))
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from leaves(part, f"{place}[{i}]")
    else:
        yield place, value


def compared(old: object, new: object) -> tuple[list[str], int]:
    """Lines that say what differs, and how many values are equal."""
    known, other = dict(leaves(old)), dict(leaves(new))
    differ, equal = [], 0
    for place in [*known, *(p for p in other if p not in known)]:
        last = place.rsplit(".", 1)[-1].partition("[")[0]
        if any(last == f or last.endswith(f"_{f}") for f in FREE):
            continue
        a, b = known.get(place, "(nothing)"), other.get(place, "(nothing)")
        if a == b or (a != a and b != b):
            equal += 1
        else:
            differ.append(f"{place}: {a!r} -> {b!r}")
    return differ, equal


def main() -> int:
    old, new = (json.loads(Path(name).read_text("utf-8")) for name in sys.argv[1:3])
    differ, equal = compared(old, new)
    print("\n".join(differ) or "nothing differs")
    print(f"{equal} values are equal, {len(differ)} differ; times are not compared")
    return int(bool(differ))


if __name__ == "__main__":
    sys.exit(main())
