"""Model files that only an enemy writes: refused as damaged, or shown without obeying them."""

import contextlib
import copy
import dataclasses
import io
import json
import os
import warnings
import zipfile

import numpy as np
import pytest
import typer

from cellsys.cli import app
from cellsys.cli.output import say
from cellsys.errors import CellsysError, FileFormatError
from cellsys.model import Card, LatentModel
from cellsys.printable import printable
from tests.population.systems import model

RED = "\x1b[31mred\x9b0m\x07"
ODD = (None, -1, "text", [[1]], {"a": 1}, 10**400)
CARD = Card(
    order=4,
    method="PCR",
    scale="block",
    samples=10,
    columns=4,
    runs=("a",),
    spectral_abscissa=-0.1,
    training={"cell": {"model": 0.1, "floor": 0.1, "mse": 0.2}},
    held_out={"cell": {"model": 0.1, "floor": 0.1}},
    verdict="fine",
    facts={"h": 1.0, "t": {"a": [1.0]}},
    floors={"a": 0.1},
    growth=(0.1, 0.2),
    warnings=("w",),
)


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Header and arrays of a good model of every field."""
    good = model(m=3, steered=True)
    good = dataclasses.replace(
        good, card=CARD, notes={"horizon_s": 100.0}, refits=np.stack([good.A] * 3)
    )
    with np.load(good.save(tmp_path_factory.mktemp("m") / "m.npz")) as stored:
        arrays = {k: stored[k] for k in stored.files}
    return json.loads(str(arrays.pop("cellsys"))), arrays


def write(path, header, arrays):
    np.savez(path, cellsys=np.array(json.dumps(header)), **arrays)
    return path


def places(value, at=()):
    """Keys that lead to every entry, lists by their first two."""
    keys = value if isinstance(value, dict) else range(min(len(value), 2))
    for key in keys:
        yield (*at, key)
        if isinstance(value[key], (dict, list)):
            yield from places(value[key], (*at, key))


def put(table, at, value):
    table = copy.deepcopy(table)
    place = table
    for key in at[:-1]:
        place = place[key]
    place[at[-1]] = value
    return table


def command(*arguments):
    """What a command writes; the error of the package where it refuses."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        typer.main.get_command(app).main([str(a) for a in arguments], standalone_mode=False)
    return out.getvalue()


def test_any_entry_of_another_type_is_damage(parts, tmp_path):
    header, arrays = parts
    fields = {k: v for k, v in header["metadata"].items() if k != "card"}
    refused = 0
    for at in [*places(fields), *(("card", *at) for at in places(header["metadata"]["card"]))]:
        for value in ODD:
            changed = {**header, "metadata": put(header["metadata"], at, value)}
            try:
                loaded = LatentModel.load(write(tmp_path / "m.npz", changed, arrays))
                assert str(loaded)
                assert str(loaded.card)
                assert len(loaded.pole_set()) == 3
            except CellsysError:
                refused += 1
    assert refused > 60  # most of them are no such field's type


@pytest.mark.parametrize(
    "field", ["order", "method", "samples", "runs", "spectral_abscissa", "training", "held_out",
              "input_share_explained", "verdict", "facts", "floors", "warnings", "growth", "unit"],
)  # fmt: skip
def test_card_fields_of_another_type_are_named(parts, tmp_path, field):
    header, arrays = parts
    wrong = 5 if field not in ("order", "samples", "spectral_abscissa", "input_share_explained",
                               ) else "five"  # fmt: skip
    changed = {**header, "metadata": put(header["metadata"], ("card", field), wrong)}
    with pytest.raises(FileFormatError, match="damaged"):
        LatentModel.load(write(tmp_path / "m.npz", changed, arrays))


def test_any_array_of_another_shape_or_kind_is_refused(parts, tmp_path):
    header, arrays = parts
    for name, a in arrays.items():
        for value in (a.astype(complex), a[..., None, None], np.full(a.shape, 1e300)):
            path = write(tmp_path / "m.npz", header, {**arrays, name: value})
            with contextlib.suppress(CellsysError):
                command("couple", path, "-K", 2)


@pytest.mark.parametrize(
    "value", [0, -1, "text", None, [], float("nan"), 10**400], ids=lambda v: repr(v)[:5]
)
def test_a_horizon_that_is_none(parts, tmp_path, value):
    header, arrays = parts
    changed = {**header, "metadata": put(header["metadata"], ("notes", "horizon_s"), value)}
    path = write(tmp_path / "m.npz", changed, arrays)
    for what in ("bode", "poles"):
        with pytest.raises(CellsysError, match="horizon_s"):
            command(what, path)


def test_a_whole_number_of_5000_digits(parts, tmp_path):
    header, arrays = parts
    text = json.dumps(header).replace('"n_states": ', '"n_states": ' + "9" * 5000)
    np.savez(tmp_path / "m.npz", cellsys=np.array(text), **arrays)
    with pytest.raises(FileFormatError, match=r"m\.npz"):
        LatentModel.load(tmp_path / "m.npz")
    nested = json.dumps(header).replace('"notes": {', '"notes": {"a": ' + "[" * 9000, 1)
    np.savez(tmp_path / "m.npz", cellsys=np.array(nested), **arrays)
    with pytest.raises(FileFormatError, match=r"m\.npz"):
        LatentModel.load(tmp_path / "m.npz")


def test_two_entries_of_one_name(parts, tmp_path):
    path = write(tmp_path / "m.npz", *parts)
    with warnings.catch_warnings():  # zipfile warns of what is wanted here
        warnings.simplefilter("ignore")
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr("A.npy", archive.read("A.npy"))
    with pytest.raises(FileFormatError, match="'A' twice"):
        LatentModel.load(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_pipes_and_devices(tmp_path):
    os.mkfifo(tmp_path / "m.npz")
    for path in (tmp_path / "m.npz", "/dev/zero", tmp_path):
        with pytest.raises(FileFormatError, match="no regular file"):
            LatentModel.load(path)
        with pytest.raises(FileFormatError, match="no regular file"):
            command("poles", path)


def test_escape_sequences_do_not_reach_the_terminal(parts, tmp_path, capsys):
    header, arrays = parts
    meta = header["metadata"]
    for at in places(meta):
        value = meta
        for key in at:
            value = value[key]
        if isinstance(value, str):
            meta = put(meta, at, value + RED)
    meta["card"]["facts"][RED] = {RED: [RED]}
    meta["card"]["training"][RED] = {"model": 1.0, RED: 1.0}
    path = tmp_path / "m.npz"
    write(path, {**header, "metadata": meta}, arrays)
    texts = []
    for what, *more in (("poles",), ("stability",), ("poles", "--json"), ("couple", "-K", 2)):
        try:
            texts.append(command(what, path, *more))
        except CellsysError as error:
            say(str(error))
            texts.append(capsys.readouterr().err)
    with contextlib.suppress(CellsysError):
        texts.append(str(LatentModel.load(path).card))
    say(RED)
    texts.append(capsys.readouterr().err)
    for text in texts:
        assert text
        assert not set(text) & {"\x1b", "\x9b", "\x07"}
    assert "\\x1b[31mred" in texts[-1]


def test_printable_leaves_text_alone():
    text = "µ, ‖v‖ and\ttabs\nand lines, 日本"
    assert printable(text) == text
    assert printable("a\rb\u202ec\x00") == "a\\rb\\u202ec\\x00"
