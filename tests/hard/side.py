"""Cases with an oracle in processes of their own, beside the rest of the stress command.

They are cheap, and 5000 of them a minute are wanted; among a hundred other cases that share the
time evenly they would have a twentieth of it.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from cellsys.scene.workers import end_with_parent
from tests.hard import stress
from tests.hard.families import FAMILIES

Chosen = Mapping[str, tuple[stress.Case, ...]]


def processors() -> int:
    """Processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def split(chosen: Chosen, oracle: bool) -> dict[str, tuple[stress.Case, ...]]:
    """The cases with an oracle, or those without."""
    parts = {f: tuple(c for c in group if c.oracle == oracle) for f, group in chosen.items()}
    return {family: group for family, group in parts.items() if group}


def run(chosen: Chosen, seconds: float, seed: int, jobs: int) -> dict[str, stress.Count]:
    """`stress.run` with the oracles in `jobs` processes beside the one of the rest.

    With one job everything takes its turn in this process. Each process draws instances of its
    own.
    """
    with_oracle, rest = split(chosen, True), split(chosen, False)
    beside = jobs
    if beside < 2 or not with_oracle:
        return stress.run(chosen, seconds, seed)
    names = {family: [case.name for case in group] for family, group in with_oracle.items()}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(beside, context, end_with_parent) as pool:
        started = [
            pool.submit(_of_names, names, seconds, seed, (number, beside))
            for number in range(beside)
        ]
        counts = stress.run(rest, seconds, seed) if rest else {}
        for one in started:
            for name, count in one.result().items():
                counts[name] = counts.get(name, stress.Count()) + count
    return counts


def _of_names(
    names: Mapping[str, list[str]], seconds: float, seed: int, share: tuple[int, int]
) -> dict[str, stress.Count]:
    chosen = {f: tuple(c for c in FAMILIES[f] if c.name in kept) for f, kept in names.items()}
    return stress.run(chosen, seconds, seed, partial(print, flush=True), share)
