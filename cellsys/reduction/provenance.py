"""Where the data of a model come from, and what they cannot show."""

from __future__ import annotations

import hashlib

import numpy as np

from cellsys.reduction.snapshots import Snapshots


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
