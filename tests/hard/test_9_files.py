"""Process, files: model files and archives that are cut, changed, forged or hostile."""

import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cellsys.errors import FileFormatError
from cellsys.model import LatentModel
from cellsys.samples import snapshots
from cellsys.store import RunReader
from tests import naive
from tests.hard.damage import (
    ARRAYS,
    META,
    ODD,
    Payload,
    bounded,
    forged,
    header,
    model_file,
    nothing_outside,
    npy,
    same_model,
)
from tests.hard.stress import SEED, Case, Int, Real, hold


def a_truncated_model_file_is_refused(share, seed):
    with tempfile.TemporaryDirectory() as name:
        path, _ = model_file(Path(name), seed)
        whole = path.read_bytes()
        path.write_bytes(whole[: int(share * (len(whole) - 1))])
        with pytest.raises(FileFormatError, match=r"m\.npz"):
            LatentModel.load(path)


def test_a_model_file_cut_at_every_hundredth_is_refused(tmp_path):
    path, model = model_file(tmp_path)
    whole = path.read_bytes()
    for percent in range(100):
        path.write_bytes(whole[: percent * len(whole) // 100])
        with pytest.raises(FileFormatError, match=r"m\.npz"):
            LatentModel.load(path)
    # naive: the array's bytes read from where they should be are its numbers, or garbage
    assert np.array_equal(np.sort(naive.array_by_offset(whole, "A")), np.sort(model.A.ravel()))
    got = naive.array_by_offset(whole[: len(whole) // 4], "A")
    assert not np.array_equal(np.sort(got), np.sort(model.A.ravel()))


def a_changed_model_file_is_the_model_or_refused(seed, changes):
    with tempfile.TemporaryDirectory() as name:
        path, model = model_file(Path(name))
        rng, data = np.random.default_rng(seed), bytearray(path.read_bytes())
        for _ in range(changes):
            data[int(rng.integers(len(data)))] = int(rng.integers(256))
        path.write_bytes(bytes(data))
        # The CRC of every entry is checked, so what is read is what was written.
        assert same_model(LatentModel.load(path), model)


def a_forged_model_file_is_a_model_or_refused(seed, changes):
    """Right container, wrong contents: other types, shapes, names."""
    rng = np.random.default_rng(seed)
    meta = dict(META)
    arrays = {"A": -np.eye(2), "B": np.ones((2, 1)), "V": np.ones((3, 2)), "offset": np.zeros(2)}
    names = ("A", "B", "offset", "V", "mean", "scale", "singular_values", "z_start", "block field",
             "sensor K_d", "../A", "block ../../x")  # fmt: skip
    for _ in range(changes):
        if rng.random() < 0.4:
            meta[str(rng.choice(list(META)))] = ODD[int(rng.integers(len(ODD)))]
        else:
            arrays[names[int(rng.integers(len(names)))]] = ARRAYS[int(rng.integers(len(ARRAYS)))]
    with tempfile.TemporaryDirectory() as name, nothing_outside(Path(name)) as folder:
        path = folder / "m.npz"
        with zipfile.ZipFile(path, "w") as archive:
            for key, value in (arrays | {"cellsys": header(meta)}).items():
                archive.writestr(f"{key}.npy", npy(value))
        model = LatentModel.load(path)
        assert np.all(np.isfinite(model.A))
        assert model.A.shape == (model.order, model.order)
        model.save(folder / "again.npz")
        assert same_model(LatentModel.load(folder / "again.npz"), model)


@pytest.mark.parametrize(
    "entry",
    [
        forged((10**12,)),
        forged((10**9, 4)),
        forged((2**62, 2**62)),
        forged((-5,)),
        forged((10**9,), "<U1000"),
        forged((3,), "|V100000000000"),
        b"\x93NUMPY\x01\x00\xff\xff{",
        b"",
    ],
)
@pytest.mark.parametrize("reader", ["model", "data"])
def test_huge_promises_are_refused_without_the_memory(entry, reader, tmp_path):
    path = tmp_path / "h.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("cellsys.npy", npy(header()))
        archive.writestr("A.npy" if reader == "model" else "x.npy", entry)
    with bounded(0.05), pytest.raises(FileFormatError, match=r"h\.npz"):
        LatentModel.load(path) if reader == "model" else snapshots([path], dt=1.0)


def test_an_archive_that_unpacks_to_all_of_memory_is_refused(tmp_path):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("cellsys.npy", npy(header()))
        with archive.open("A.npy", "w", force_zip64=True) as entry:
            entry.write(forged((120 * 10**6 // 8,)))
            for _ in range(120):
                entry.write(bytes(10**6))
    assert path.stat().st_size < 10**6
    with bounded(0.05), pytest.raises(FileFormatError, match="unpacks to 120 MB"):
        LatentModel.load(path)
    assert naive.unpacked_size(path) > 100 * path.stat().st_size


def test_a_header_nested_without_end_is_refused(tmp_path):
    path = tmp_path / "deep.npz"
    np.savez(path, cellsys=np.array("[" * 10**5 + "]" * 10**5))
    with pytest.raises(FileFormatError, match=r"deep\.npz"):
        LatentModel.load(path)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("[" * 10**5 + "]" * 10**5)
    with pytest.raises(FileFormatError):
        RunReader(tmp_path / "run")


def test_a_pickle_in_a_file_is_never_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    objects = np.array([Payload()], dtype=object)
    np.savez("m.npz", A=objects, cellsys=header())
    for read in (LatentModel.load, lambda p: snapshots([p], dt=1.0)):
        with pytest.raises(FileFormatError):
            read("m.npz")
    assert not Path("pickle was run").exists()
    naive.load_everything("m.npz")
    assert Path("pickle was run").exists()


CASES = (
    Case("model file cut", a_truncated_model_file_is_refused, {"share": Real(0, 1), "seed": SEED}),
    Case(
        "model file changed",
        a_changed_model_file_is_the_model_or_refused,
        {"changes": Int(1, 30), "seed": SEED},
    ),
    Case(
        "model file forged",
        a_forged_model_file_is_a_model_or_refused,
        {"changes": Int(1, 5), "seed": SEED},
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 3)
