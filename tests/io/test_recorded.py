"""Recorded runs [thesis A.1]: written, read, and equal to the digits written."""

import dataclasses
import gc

import numpy as np
import pytest

import cellsys as cs
from tests.good_arguments import run

FORCES = np.random.default_rng(3)


def write(folder, T=5, n=4, N=6, between=" ", first=1):
    """Files in the layout, by code of its own: explicit Euler steps of 1 s of given forces, SI.

    Returns x (T, n, 3) and u's places (T, N, 3), m, and the forces of the cell by name, N.
    """
    folder.mkdir(exist_ok=True)
    x, y = FORCES.normal(size=(n, 3)) * 1e-5, FORCES.normal(size=(N, 3)) * 1e-5
    xs, ys, all_forces = [], [], []

    def row(*parts):
        return between.join(f"{v:.12e}" for part in parts for v in np.ravel(part))

    for k in range(T):
        f = {name: FORCES.normal(size=(n, 3)) * 1e-10 for name in ("L", "E", "tract", "T", "v")}
        g = {name: FORCES.normal(size=(N, 3)) * 1e-10 for name in ("E", "tract")}
        g["tract"][: N - 2] = 0.0  # two nodes bear tractions
        f["v"] *= 1e3  # cortex, m/s
        v = (f["tract"] + f["E"] + f["L"] - f["T"] + 1e-3 * f["v"]) / 2e-3
        w = (g["tract"] + g["E"]) / 1e-3
        bonds = np.arange(n) % 2
        stamp = f"{first + k}.000000_s.sav"
        cell = [row([1.0, 0, 0]), row([0.5, 0.5, 0])]
        cell += [
            row(i, x[i], v[i], f["L"][i], f["E"][i], f["tract"][i], bonds[i]) for i in range(n)
        ]
        (folder / f"Cell_1_{stamp}").write_text("\n".join(cell) + "\n")
        rows = [row(i, f["v"][i], f["T"][i]) for i in range(n)]
        (folder / f"Cortical_1_{stamp}").write_text("\n".join(rows))
        rows = [str(N + 9)]
        rows += [row(i, i, y[i], w[i], g["E"][i], g["tract"][i], [0, 0, 0]) for i in range(N)]
        (folder / f"ECM_fiber_{stamp}").write_text("\n".join(rows))
        xs.append(x)
        ys.append(y)
        all_forces.append(f)
        x, y = x + v, y + w
    return np.array(xs), np.array(ys), all_forces


@pytest.mark.parametrize("between", [" ", "\t", "  "])
def test_files_of_another_program(tmp_path, between):
    x, y, forces = write(tmp_path / "a", between=between)
    back = cs.recorded_run(tmp_path / "a")
    assert np.array_equal(back.t, np.arange(1.0, 6.0))
    # written with 12 decimals
    np.testing.assert_allclose(back.block("cell1.position"), 1e6 * x, atol=1e-10)
    np.testing.assert_allclose(
        back.geometry["matrix.rest"] + back.block("matrix.displacement"), 1e6 * y, atol=1e-10
    )
    pull = np.array([1e12 * f["L"] for f in forces[:-1]])
    np.testing.assert_allclose(back.auxiliary("cell1.lamellipodium"), pull, rtol=1e-10)
    tension = np.array([-1e12 * f["T"] for f in forces[:-1]])
    np.testing.assert_allclose(back.auxiliary("cell1.cortical_tension"), tension, rtol=1e-10)
    # Euler steps: the forces explain the rates, to the digits
    assert back.source["closure_share"] < 1e-9
    nodes = back.geometry["cell1.bond_node"]
    assert np.all(nodes[:, ::2] == -1)
    for k in range(5):
        for i in (1, 3):
            loaded = [4, 5]
            near = min(loaded, key=lambda j: np.sum((y[k, j] - x[k, i]) ** 2))
            assert nodes[k, i] == near


def test_the_closure_of_the_thesis_is_one_sample_late(tmp_path):
    """Naive (A.2): diff(x) against the forces of the later sample; here nothing is left over."""
    x, _, forces = write(tmp_path / "a")
    total = np.array([f["tract"] + f["E"] + f["L"] - f["T"] + 1e-3 * f["v"] for f in forces])
    rate = np.diff(x, axis=0)
    assert np.linalg.norm(2e-3 * rate - total[:-1]) < 1e-9 * np.linalg.norm(total)
    assert np.linalg.norm(2e-3 * rate - total[1:]) > 0.5 * np.linalg.norm(total)


def test_several_runs_are_snapshots_without_a_seam(tmp_path):
    write(tmp_path / "a")
    write(tmp_path / "b", first=7)
    data = cs.read_recorded([tmp_path / "a", tmp_path / "b"])
    assert data.n_samples == 6
    assert data.dt == 1.0
    assert np.isfinite(cs.reduce(data, order=2, method=cs.PCR()).A).all()


@pytest.mark.parametrize("digits", [9, 17])
def test_write_and_read_is_the_run_to_the_digits_written(tmp_path, digits):
    made = run()
    cs.write_recorded(made, tmp_path / "a", digits=digits)
    ours, theirs = cs.snapshots([made]), cs.read_recorded(tmp_path / "a")
    assert (ours.states, ours.auxiliaries) == (theirs.states, theirs.auxiliaries)
    assert ours.command_names == theirs.command_names
    # places up to 60 um with so many decimals, and rates of their differences over 5 s
    error = 60.0 * max(10.0**-digits, 1e-15)
    a, b = ours.runs[0], theirs.runs[0]
    np.testing.assert_allclose(np.asarray(b.x), np.asarray(a.x), atol=error, rtol=10.0**-digits)
    residual = ours.auxiliaries.slice("step_residual").start
    np.testing.assert_allclose(
        np.asarray(b.eta)[:, :residual], np.asarray(a.eta)[:, :residual],
        rtol=10.0**-digits + 1e-15, atol=10.0**-digits,
    )  # fmt: skip
    one, two = (cs.reduce(d, order=1, method=cs.PCR()) for d in (ours, theirs))
    close = max(1e3 * 10.0**-digits, 1e-11)
    np.testing.assert_allclose(two.singular_values, one.singular_values, rtol=close)
    np.testing.assert_allclose(cs.poles(two.plant()), cs.poles(one.plant()), rtol=close)


def test_another_program_finds_the_forces_that_move_the_cell(tmp_path):
    """Without our description the columns alone explain the rates: to the stepping's own part."""
    cs.write_recorded(run(), tmp_path / "a")
    (tmp_path / "a" / "cellsys.json").unlink()
    back = cs.recorded_run(tmp_path / "a")
    assert back.source["closure_share"] < 0.05
    assert back.states.names[0] == "cell1.position[0].x"


def test_a_large_run_lives_on_disk_as_long_as_anybody_reads_it(tmp_path, monkeypatch):
    """Naive: the files go with the run object, which snapshots do not keep."""
    monkeypatch.setattr("cellsys.io.row_file.IN_MEMORY", 0.0)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "t"))
    (tmp_path / "t").mkdir()
    write(tmp_path / "a")
    data = cs.read_recorded(tmp_path / "a")
    gc.collect()
    assert isinstance(data.runs[0].eta, np.memmap)
    small = cs.reduce(data, order=1, method=cs.PCR())
    assert np.isfinite(small.A).all()
    assert list((tmp_path / "t").iterdir())
    del data
    gc.collect()
    assert not list((tmp_path / "t").iterdir())


def test_bad_files_are_named_by_row_and_column(tmp_path):
    folder = tmp_path / "a"
    write(folder)
    name = "Cell_1_2.000000_s.sav"
    lines = (folder / name).read_text().splitlines()
    kept = (folder / name).read_text()
    for row, column, word, kind in ((3, 2, "x", cs.FileFormatError), (4, 8, "nan", cs.DataError)):
        words = lines[row - 1].split()
        words[column - 1] = word
        (folder / name).write_text("\n".join([*lines[: row - 1], " ".join(words), *lines[row:]]))
        with pytest.raises(kind, match=f"{name}, row {row}, column {column}"):
            cs.recorded_run(folder)
    (folder / name).write_text("\n".join([*lines[:4], lines[4] + " 1", *lines[5:]]))
    with pytest.raises(cs.FileFormatError, match="row 5: 18 columns, 17"):
        cs.recorded_run(folder)
    (folder / name).write_text("\n".join(lines[:-1]))
    with pytest.raises(cs.FileFormatError, match="nodes"):
        cs.recorded_run(folder)
    (folder / name).write_text(kept)
    (folder / "Cortical_1_3.000000_s.sav").unlink()
    with pytest.raises(cs.FileFormatError, match="at t = 3"):
        cs.recorded_run(folder)
    with pytest.raises(cs.FileFormatError, match="no recorded run"):
        cs.recorded_run(tmp_path)
    with pytest.raises(FileNotFoundError):
        cs.recorded_run(tmp_path / "nothing")


def test_a_description_that_does_not_fit_is_refused(tmp_path):
    cs.write_recorded(run(), tmp_path / "a", digits=3)
    text = (tmp_path / "a" / "cellsys.json").read_text()
    for old, new in (('"schema": 1', '"schema": 2'), ('"inputs"', '"input"'), ("{", "")):
        (tmp_path / "a" / "cellsys.json").write_text(text.replace(old, new))
        with pytest.raises(cs.FileFormatError, match=r"cellsys\.json"):
            cs.recorded_run(tmp_path / "a")


def test_what_cannot_be_recorded_is_refused(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x").touch()
    with pytest.raises(cs.ParameterError, match="not empty"):
        cs.write_recorded(run(), tmp_path / "a")
    bare = dataclasses.replace(run(), eta=None, u=None)
    with pytest.raises(cs.DataError, match="auxiliaries"):
        cs.write_recorded(bare, tmp_path / "b")
    with pytest.raises(cs.ParameterError, match="digits"):
        cs.write_recorded(run(), tmp_path / "b", digits=18)
