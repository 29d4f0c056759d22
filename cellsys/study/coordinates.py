"""Basis and latent samples of a study, kept beside its runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cellsys.errors import FileFormatError
from cellsys.model.latent import LatentModel
from cellsys.reduction import Basis
from cellsys.reduction.basis import LatentParts, fit_basis
from cellsys.samples import Snapshots
from cellsys.store import fingerprint, load_archive, save_archive
from cellsys.version import __version__
from cellsys.worth.assessment import Encoded

_KIND = "coordinates"


class Coordinates(NamedTuple):
    """One basis, with all runs in it: what every smaller model of a sweep is cut from."""

    basis: Basis
    encoded: tuple[Encoded, Encoded | None]


def learn_coordinates(data: Snapshots, test: Snapshots, order: int, path: Path) -> Coordinates:
    """Fit the basis and encode all runs, or read both back from `path`.

    The file is used when it was made from the same data (labels, sizes, first and last rows),
    order and version; anything else is made again.
    """
    key = fingerprint(
        __version__,
        order,
        data.scale,
        [r.label for r in (*data.runs, *test.runs)],
        *(np.asarray(r.x[i]) for r in (*data.runs, *test.runs) for i in (0, -1)),
    )
    try:
        arrays, meta = load_archive(path, _KIND, 1)
        if meta.get("key") == key:
            return _unpack(arrays, meta, data)
    except (FileNotFoundError, FileFormatError, KeyError):
        pass
    basis = fit_basis(data, order).with_parts(data)
    parts = basis.parts_of(data)
    large = LatentModel(
        A=np.zeros((order, order)),
        V=basis.V,
        mean=basis.mean,
        scale=basis.scale,
        n_states=data.states.size,
    )
    encoded = Encoded.of(large, data, data), Encoded.of(large, test, data)
    arrays = {
        "V": basis.V,
        "singular_values": basis.singular_values,
        "mean": basis.mean,
        "scale": basis.scale,
        "x_now": parts.x_now,
        "x_next": parts.x_next,
        "eta_now": parts.eta_now,
        "eta_next": parts.eta_next,
    }
    arrays |= {f"training {i}": z for i, z in enumerate(encoded[0].runs)}
    arrays |= {f"test {i}": z for i, z in enumerate(encoded[1].runs)}
    save_archive(
        path, _KIND, 1, arrays, {"key": key, "total": basis.total, "dropped": basis.dropped}
    )
    return Coordinates(basis, encoded)


def _unpack(arrays: dict, meta: dict, data: Snapshots) -> Coordinates:
    basis = Basis(
        V=arrays["V"],
        singular_values=arrays["singular_values"],
        mean=arrays["mean"],
        scale=arrays["scale"],
        total=meta["total"],
        dropped=meta["dropped"],
    )
    parts = LatentParts(
        x_now=arrays["x_now"],
        x_next=arrays["x_next"],
        eta_now=arrays["eta_now"],
        eta_next=arrays["eta_next"],
        runs=data.run_ids,
        samples=np.concatenate([r.usable() for r in data.runs]),
        data=data,
    )
    training = [arrays[f"training {i}"] for i in range(len(data.runs))]
    test = [v for k, v in arrays.items() if k.startswith("test ")]
    return Coordinates(
        replace(basis, parts=parts),
        (Encoded(runs=training, training=data), Encoded(runs=test, training=data)),
    )
