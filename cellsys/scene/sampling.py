"""Samples fill the whole of a run, at equal intervals."""

from __future__ import annotations

import numpy as np

from cellsys.errors import SceneError

_EQUAL = 1e-9  # of the duration: quantities such as "1/3 s" are rounded, not other ones


def intervals(duration: float, sample: float, table: str = "") -> int:
    """Number of sampling intervals in a run: duration / sample, a whole number.

    A last interval of another length would be refused by everything that learns from equally
    spaced samples, and another duration than the one asked for would be obeyed by none.

    Parameters
    ----------
    duration, sample : float
        s.
    table : str
        Table of the scene file that holds the two, such as ``training.``.

    Raises
    ------
    SceneError
        Where one is no finite time > 0, or sample does not divide duration: with the two nearest
        samples that do, and the two nearest durations.
    """
    for name, value in (("duration", duration), ("sample", sample)):
        if not (np.isfinite(value) and value > 0):
            raise SceneError(f"{table}{name} must be > 0 s, got {value!r}")
    ratio = duration / sample
    if not np.isfinite(ratio):
        raise SceneError(
            f"{table}sample = {sample:g} s is too short for {table}duration = {duration:g} s; "
            "sample less often"
        )
    count = round(ratio)
    if count >= 1 and abs(count * sample - duration) <= _EQUAL * duration:
        return count
    below = int(ratio)
    if below < 1:
        raise SceneError(
            f"{table}sample = {sample:.10g} s is longer than {table}duration = {duration:.10g} s; "
            f"take sample = '{duration:.10g} s' or duration = '{sample:.10g} s'"
        )
    above = below + 1
    raise SceneError(
        f"{table}sample = {sample:.10g} s does not divide {table}duration = {duration:.10g} s: "
        f"{below} intervals end at {below * sample:.10g} s and {above} at {above * sample:.10g} s; "
        f"take sample = '{duration / above:.10g} s' or '{duration / below:.10g} s', or "
        f"duration = '{below * sample:.10g} s' or '{above * sample:.10g} s'"
    )
