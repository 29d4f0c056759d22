"""Where the data of a model come from, and what they cannot show."""

from __future__ import annotations

import hashlib

import numpy as np

from cellsys.samples.snapshots import RunData, Snapshots, read_rows


def data_hash(data: Snapshots) -> list[str]:
    """Twelve hex digits per run, of its first and last state and its commands."""
    out = []
    for run in data.runs:
        digest = hashlib.sha256()
        for part in (run.x[0], run.x[len(run.x) - 1], run.commands):
            if part is not None:
                digest.update(np.ascontiguousarray(part, dtype=float).tobytes())
        out.append(digest.hexdigest()[:12])
    return out


def constant_commands(data: Snapshots) -> tuple[str, ...]:
    """A warning where every run keeps one command: such a set cannot rank models."""
    tables = [np.asarray(r.commands) for r in data.runs if r.commands is not None]
    if not tables or not data.command_names or any(np.ptp(t, axis=0).max() > 1e-6 for t in tables):
        return ()
    return (
        "the training runs keep one heading each: up to a rotation they are one trajectory, so "
        "they cannot rank models; add turning commands",
    )


_SAME = 1e-6  # of the motion: runs closer than this are one run


def repeated_runs(test: Snapshots, known: Snapshots) -> list[int]:
    """Numbers of the held-out runs that are a training run again, sample by sample.

    What was fitted to the one was fitted to the other: no error on them is held out.
    """
    return [
        i for i, run in enumerate(test.runs) if any(_same_run(run, other) for other in known.runs)
    ]


def repeats(numbers: list[int], test: Snapshots | None) -> tuple[str, ...]:
    """A warning that names the held-out runs that do not count."""
    if not numbers or test is None:
        return ()
    names = ", ".join(test.runs[i].label or f"run {i}" for i in numbers[:4])
    more = f" and {len(numbers) - 4} more" if len(numbers) > 4 else ""
    return (
        f"held-out runs that are training runs again do not count: {names}{more}; hold out others",
    )


def _same_run(a: RunData, b: RunData) -> bool:
    if a is b:
        return True
    last = min(len(a.x), len(b.x)) - 1
    if a.x.shape[1] != b.x.shape[1] or last < 1:
        return False
    at = np.unique(np.linspace(0, last, 20).astype(int))
    rows = [np.stack([read_rows(r.x, int(k), int(k) + 1)[0] for k in at]) for r in (a, b)]
    moved = float(np.linalg.norm(rows[1] - rows[1][0]))
    return float(np.linalg.norm(rows[0] - rows[1])) <= _SAME * moved
