"""Random numbers that belong to one thing: a cell's own, the same whatever else a scene holds."""

from __future__ import annotations

import zlib

import numpy as np


def stream(run: np.random.Generator, label: str, t: float, dt: float) -> np.random.Generator:
    """Generator of one step of one thing, from the seed of the run.

    It depends on the run's seed, the label ("cell1.stochastic_adhesion"), t and dt only: not on
    what was drawn before, so that a further cell changes no number of this one, and a run resumed
    at a sample draws what it would have drawn.
    """
    seed = run.bit_generator.seed_seq
    entropy = getattr(seed, "entropy", 0)
    key = (*getattr(seed, "spawn_key", ()), zlib.crc32(label.encode()))
    at = np.array([t, dt], float).view(np.uint32)
    return np.random.default_rng(
        np.random.SeedSequence(entropy=entropy, spawn_key=(*key, *(int(w) for w in at)))
    )
