"""Files of an equivariant model with an entry of another type or shape: refused as damaged."""

import json

import numpy as np
import pytest

from cellsys.errors import CellsysError, FileFormatError
from cellsys.model import LatentModel
from tests.cell.runs import model


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    with np.load(model().save(tmp_path_factory.mktemp("m") / "m.npz")) as stored:
        arrays = {k: stored[k] for k in stored.files}
    return json.loads(str(arrays.pop("cellsys"))), arrays


def loaded(path, header, arrays):
    np.savez(path, cellsys=np.array(json.dumps(header)), **arrays)
    return LatentModel.load(path)


def test_entries_of_another_type(parts, tmp_path):
    header, arrays = parts
    meta, refused = header["metadata"], 0
    tables = [("metadata", meta), ("card", meta["card"])]
    for where, table in tables:
        for k, key in enumerate(table):
            # Two of four each, so that every kind of value meets every kind of entry somewhere.
            for value in ((None, [[1]]), ("text", 10**400))[k % 2]:
                changed = {**table, key: value}
                changed = changed if where == "metadata" else {**meta, "card": changed}
                try:
                    found = loaded(tmp_path / "m.npz", {**header, "metadata": changed}, arrays)
                    assert str(found)
                except CellsysError:
                    refused += 1
    assert refused > 30  # most entries have one type


@pytest.mark.parametrize("change", ["complex", "text", "empty", "large"])
def test_arrays_of_another_kind_or_shape(parts, tmp_path, change):
    header, arrays = parts
    makes = {
        "complex": lambda a: a.astype(complex), "text": lambda a: a.astype("U8"),
        "empty": lambda a: np.zeros(0), "large": lambda a: np.full(a.shape, 1e300),
    }  # fmt: skip
    for name in arrays:
        if (
            arrays[name].dtype.kind == "U"
            or not arrays[name].size
            or (name.startswith("sensor ") and change == "large")
        ):
            continue
        changed = {**arrays, name: makes[change](arrays[name])}
        try:
            loaded(tmp_path / "m.npz", header, changed)
        except FileFormatError:
            continue
        except CellsysError:
            assert change == "empty"  # refused by the model that would be made of it
            continue
        assert change == "empty"
