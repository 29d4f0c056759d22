"""Fingerprints: one hash for everything a result depends on."""

from __future__ import annotations

import hashlib
import json

import numpy as np

from cellsys.arguments import checked


@checked
def fingerprint(*parts: object) -> str:
    """SHA-256 (hex) of JSON-able values and arrays, in order.

    Arrays are hashed with their dtype and shape; floats by their shortest exact repr.
    """
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype.str}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        elif isinstance(part, bytes):
            digest.update(part)
        else:
            digest.update(json.dumps(part, sort_keys=True, allow_nan=True).encode())
        digest.update(b"\x00")
    return digest.hexdigest()
