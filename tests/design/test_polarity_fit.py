"""The polarity law from measured headings: coverage of its intervals, and what is no attraction."""

import dataclasses

import numpy as np
import pytest

import cellsys as cs
from cellsys.tracks import chained

KAPPA, SIGMA, OFF, DT = 1 / 60, 0.05, 0.1, 5.0


def headings(seed, cells=15, T=60, kappa=KAPPA, dt=DT, phi=0.0):
    """Headings (T, cells) of the law towards phi, measured with an error of OFF rad."""
    rng = np.random.default_rng(seed)
    theta, rows, fine = rng.uniform(-np.pi, np.pi, cells), [], dt / 5
    for _ in range(T):
        rows.append(theta)
        for _ in range(5):
            theta = theta + kappa * np.sin(phi - theta) * fine
            theta = theta + SIGMA * np.sqrt(fine) * rng.standard_normal(cells)
    return np.array(rows) + OFF * rng.standard_normal((T, cells))


def tracks_of(theta, start=None, dt=DT):
    """Cells that make a step of 1 um along each heading."""
    T, cells = theta.shape
    step = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    place = np.concatenate([np.zeros((1, cells, 2)), np.cumsum(step, axis=0)])
    place = place + (0.0 if start is None else start)
    frame, track = np.repeat(np.arange(T + 1), cells), np.tile(np.arange(cells), T + 1)
    flat = np.column_stack([place.reshape(-1, 2), np.zeros(len(frame))])
    return cs.Tracks(frame=frame, t=dt * frame, place=flat, track=track,
                     links=chained(track, frame))  # fmt: skip


def test_intervals_cover_what_was_simulated():
    """Of 25 sets, 95 % intervals: at least 20 cover (one in a hundred sets of 25 has fewer)."""
    fits = [cs.fit_polarity(tracks_of(headings(seed)), cue=0.0) for seed in range(25)]
    for name, true in (("kappa", KAPPA), ("noise", SIGMA)):
        covered = [
            low <= true <= high for low, high in (getattr(f, f"{name}_interval") for f in fits)
        ]
        assert sum(covered) >= 20, name
    assert np.mean([f.kappa for f in fits]) == pytest.approx(KAPPA, rel=0.06)
    assert np.mean([f.measurement for f in fits]) == pytest.approx(OFF, rel=0.15)
    assert np.mean([f.cue_gain for f in fits]) == pytest.approx(2 * KAPPA / SIGMA**2, rel=0.2)
    # single cells too: each 60 turns
    single = [c for f in fits for c in f.cells.values()]
    assert np.mean([c.low <= KAPPA <= c.high for c in single]) > 0.85


def test_naive_regression_is_biased_by_the_error_of_headings():
    found = []
    for seed in range(20):
        theta = headings(seed)
        turn = (np.diff(theta, axis=0) + np.pi) % (2 * np.pi) - np.pi
        pull = np.sin(-theta[:-1]) * DT
        found.append((turn * pull).sum() / (pull**2).sum())
    assert np.mean(found) > 1.2 * KAPPA


def test_the_fitted_law_drops_into_a_loop():
    fit = cs.fit_polarity(tracks_of(headings(1)), cue=0.0)
    law = fit.controller()
    assert isinstance(law, cs.PolarityLaw)
    assert law.kappa == fit.kappa
    idle = cs.fit_polarity(tracks_of(headings(2, kappa=0.0)), cue=0.0)
    with pytest.raises(cs.DataError, match="do not show"):
        idle.controller()


def test_a_run_gives_back_the_gain_it_was_made_with():
    """p and d without noise: exact, but for the step, over which the law is not linear."""
    law, dt, p = cs.PolarityLaw(kappa=0.02), 1.0, [np.array([-1.0, 0.2, 0.0])]
    t = dt * np.arange(200)
    d = np.column_stack([np.cos(0.03 * t), np.sin(0.03 * t), 0 * t])
    for k in range(199):
        p.append(law.step(p[-1], d[k], dt))
    p = np.array(p) / np.linalg.norm(p[0])
    run = cs.Trajectory(t=t, x=np.zeros((200, 1)), states=cs.Layout(["x"]), p=p[:, None],
                        d=d[:, None])  # fmt: skip
    fit = cs.fit_polarity(run)
    assert fit.kappa == pytest.approx(0.02, rel=0.03)
    # a cue of half the strength: twice the kappa by the law with lengths, the same by the unit one
    weak = dataclasses.replace(run, d=0.5 * np.asarray(run.d))
    assert cs.fit_polarity(weak).kappa == pytest.approx(2 * fit.kappa)
    assert cs.fit_polarity(weak, unit_cue=True).kappa == pytest.approx(fit.kappa)
    assert fit.noise < 1e-3


def pairs(seed, kappa, n=12, T=40):
    """Movies of two cells 60 um apart, each turning to the other."""
    out = []
    for k in range(n):
        left = headings(100 * seed + 2 * k, cells=1, T=T, kappa=kappa, phi=0.0)
        right = headings(100 * seed + 2 * k + 1, cells=1, T=T, kappa=kappa, phi=np.pi)
        turn = 2 * np.pi * k / n  # pairs lie every way
        both = np.column_stack([left, right]) + turn
        axis = np.array([np.cos(turn), np.sin(turn)])
        out.append(tracks_of(both, start=np.stack([-60 * axis, 60 * axis])))
    return out


def test_attraction_beyond_chance():
    found = cs.pair_attraction(pairs(1, kappa=0.02), shuffles=200)
    assert found.p_value < 0.02
    assert found.interval[0] > 0
    assert abs(found.null.mean()) < 0.2
    idle = cs.pair_attraction(pairs(2, kappa=0.0), shuffles=200)
    assert idle.p_value > 0.02
    assert idle.interval[0] < 0 < idle.interval[1] + 0.2


def test_neighbours_are_the_cue_of_tracks():
    fit = cs.fit_polarity(pairs(3, kappa=KAPPA))
    assert fit.kappa == pytest.approx(KAPPA, rel=0.3)
    assert fit.kappa_interval[0] > 0


def test_what_says_nothing_is_refused():
    with pytest.raises(cs.DataError, match="turns"):
        cs.fit_polarity(tracks_of(headings(0, cells=1, T=6)), cue=0.0)
    still = tracks_of(np.zeros((40, 3)))
    with pytest.raises(cs.DataError, match="do not leave"):
        cs.fit_polarity(still, cue=0.0)
    with pytest.raises(cs.DataError, match="at least four"):
        cs.pair_attraction(tracks_of(headings(0, cells=1)))
    with pytest.raises(cs.ParameterError, match="level"):
        cs.fit_polarity(still, level=1.0)
    with pytest.raises(cs.ParameterError, match="empty"):
        cs.fit_polarity([])
