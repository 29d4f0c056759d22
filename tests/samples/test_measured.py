"""Measured data as they are: jitter, uneven sampling, missing samples, delays, arrays turned."""

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import TransposedDataWarning
from cellsys.samples.measured import even, resampled


def wave(t):
    return np.column_stack([np.sin(0.3 * t), np.cos(0.2 * t)])


def csv(path, t, x, text="{:.17g}"):
    rows = [",".join(text.format(v) for v in row) for row in np.column_stack([t, x])]
    path.write_text("\n".join(["t [s],a,b", *rows]) + "\n")
    return path


def test_float32_and_rounded_stamps_are_even(tmp_path):
    t = 0.1 * np.arange(2000)
    assert even(t.astype(np.float32).astype(float)) == pytest.approx(0.1, rel=1e-6)
    assert even(np.round(t + 3e-5 * np.sin(9 * t), 5)) == pytest.approx(0.1, rel=1e-6)
    # naive: steps compared with their median, which float32 stamps of 200 s do not pass at 1e-6
    assert np.ptp(np.diff(t.astype(np.float32).astype(float))) > 1e-6 * 0.1
    np.savez(tmp_path / "a.npz", x=wave(t), t=t.astype(np.float32))
    assert cs.snapshots([tmp_path / "a.npz"]).dt == pytest.approx(0.1, rel=1e-6)
    late = t.copy()
    late[7] += 0.01
    assert even(late) is None
    with pytest.raises(cs.DataError, match=r"line 8|line 9.*resample="):
        cs.snapshots([csv(tmp_path / "b.csv", late, wave(t))])


def test_uneven_samples_are_put_on_even_times_and_the_error_is_told(tmp_path):
    rng = np.random.default_rng(2)
    t = np.sort(rng.uniform(0, 60, 400))
    t[0], t[-1] = 0.0, 60.0
    for path in (csv(tmp_path / "a.csv", t, wave(t)), tmp_path / "a.npz"):
        np.savez(tmp_path / "a.npz", x=wave(t), t=t)
        data = cs.snapshots([path], resample=0.5)
        assert data.dt == 0.5
        true = wave(0.5 * np.arange(len(data.runs[0].x)))
        miss = np.abs(data.runs[0].x - true).max()
        told = data.source["resampling_error"][path.name]
        # told over the spread of a wave, 0.7: an upper bound, and not a wild one
        assert miss < 0.75 * told < 20 * miss
    straight, error = resampled(t, np.column_stack([2 * t]), 0.5, "x")
    assert error < 1e-9
    np.testing.assert_allclose(straight[:, 0], np.arange(len(straight)), atol=1e-9)
    with pytest.raises(cs.DataError, match="three"):
        cs.snapshots([tmp_path / "a.npz"], resample=50.0)


def test_missing_samples_are_refused_split_or_filled(tmp_path):
    t = np.arange(30.0)
    x = wave(t)
    x[10, 1] = x[11, 0] = x[20, 0] = x[22, 1] = np.nan
    with pytest.raises(cs.DataError, match=r"sample 10, column 1"):
        cs.snapshots([x], dt=1.0)
    split = cs.snapshots([x], dt=1.0, missing="split")
    assert [len(r.x) for r in split.runs] == [10, 8, 7]  # the one between 20 and 22 is too short
    assert split.source["missing_samples"] == 4
    filled = cs.snapshots([x], dt=1.0, missing="fill").runs[0].x
    assert np.abs(filled - wave(t)).max() < 0.05
    good = cs.snapshots([x[:10]], dt=1.0).runs[0].x
    assert np.array_equal(split.runs[0].x, good)
    path = csv(tmp_path / "a.csv", t, x)
    path.write_text(path.read_text().replace("nan", ""))
    assert len(cs.snapshots([path], missing="split").runs) == 3
    with pytest.raises(cs.DataError, match="line 12, column 3"):
        cs.snapshots([path])


def test_delays_hold_what_is_not_measured():
    """One place of an oscillator: a line through its samples cannot turn, with a delay it does."""
    x = np.cos(0.2 * np.arange(80))[:, None]
    data = cs.snapshots([x, 0.5 * x], dt=1.0, delays=1)
    assert [b.name for b in data.states] == ["x", "x.delay1"]
    assert data.source["delays"] == 1
    assert np.array_equal(data.runs[0].x[:, 1], x[:-1, 0])
    poles = cs.poles(cs.reduce(data, order=2, method=cs.LeastSquares()).plant())
    np.testing.assert_allclose(np.sort(np.imag(poles)), [-0.2, 0.2], atol=1e-9)
    alone = cs.poles(
        cs.reduce(cs.snapshots([x], dt=1.0), order=1, method=cs.LeastSquares()).plant()
    )
    assert np.all(np.imag(alone) == 0)
    with pytest.raises(cs.DataError, match="with 9 delays it needs 12"):
        cs.snapshots([x[:10]], dt=1.0, delays=9)


def test_a_transposed_array_is_suspected_and_said():
    x = np.cumsum(np.random.default_rng(0).standard_normal((6, 300)), axis=1)
    with pytest.warns(TransposedDataWarning, match=r"transposed\?"):
        cs.snapshots([x], dt=1.0)
    cs.snapshots([x.T], dt=1.0)  # says nothing
    field = np.sin(0.05 * np.arange(300) + 0.1 * np.arange(20)[:, None])
    cs.snapshots([field], dt=1.0)  # a smooth field in space and time, rightly given


def test_choices_are_refused_where_they_mean_nothing():
    x = wave(np.arange(9.0))
    for bad in ({"resample": 0.0}, {"missing": "drop"}, {"delays": -1}):
        with pytest.raises(cs.CellsysError, match=next(iter(bad))):
            cs.snapshots([x], dt=1.0, **bad)
    run = cs.Trajectory(t=np.arange(9.0), x=x, states=cs.Layout(["a", "b"]))
    with pytest.raises(cs.ParameterError, match="measured data"):
        cs.snapshots([run], delays=1)
