"""Training of one charge: gradient, contraction, what the constraint buys."""

import dataclasses

import numpy as np
import pytest

from cellsys.cell.training import (
    ChargeData,
    ChargeParameters,
    clip,
    loss_and_gradient,
    one_step,
    port_gain,
    roll_out,
    train,
)
from cellsys.cell.training_kernels import backward, forward


def problem(seed=0, K=30, R=4, m=3, H=3, noise=0.0):
    rng = np.random.default_rng(seed)
    w = np.clip(1 - np.abs(np.linspace(0, H - 1, K)[:, None] - np.arange(H)), 0, None)
    true = ChargeParameters(
        clip(rng.standard_normal((H, m, m)), 0.95), 0.3 * rng.standard_normal((H, m, 2)), 0.0
    )
    u, v = rng.standard_normal((K, R, 2)), rng.standard_normal((K, R, m))
    x = np.zeros((K + 1, R, m))
    x[0] = rng.standard_normal((R, m))
    data = ChargeData(
        x=x, u=u, v=v, w=w, weight=np.array([1.0, 0.5, 0.2]), counts=np.ones((K + 1, R))
    )
    x = roll_out(true, data) + noise * rng.standard_normal(x.shape)
    return true, dataclasses.replace(data, x=x)


def test_roll_out_is_the_recursion_written_out():
    true, data = problem()
    p = dataclasses.replace(true, gamma=0.3)
    x = data.x[0].copy()
    for k in range(len(data.u)):
        A, B = np.tensordot(data.w[k], p.A, 1), np.tensordot(data.w[k], p.B, 1)
        port = 0.3 * 0.5 * data.v[k] @ (np.eye(3) + A).T
        x = x @ A.T + data.u[k] @ B.T - port
    np.testing.assert_allclose(roll_out(p, data)[-1], x, atol=1e-12)


def test_gradient_is_that_of_the_loss():
    """Central differences, error about 1e-10 of the largest entry."""
    true, data = problem(noise=0.1)
    rng = np.random.default_rng(3)
    S = np.eye(3) + 0.3 * rng.standard_normal((3, 3))
    p = ChargeParameters(0.9 * true.A, 1.1 * true.B, 0.2, S)
    _, g = loss_and_gradient(p, data)
    for _ in range(6):
        dA, dB = rng.standard_normal(p.A.shape), rng.standard_normal(p.B.shape)
        dS, dg, h = rng.standard_normal(S.shape), 0.7, 1e-6
        ends = [
            loss_and_gradient(
                ChargeParameters(
                    p.A + s * h * dA, p.B + s * h * dB, p.gamma + s * h * dg, S + s * h * dS
                ),
                data,
            )[0]
            for s in (1, -1)
        ]
        slope = (ends[0] - ends[1]) / (2 * h)
        exact = float(np.sum(g.A * dA) + np.sum(g.B * dB) + g.gamma * dg + np.sum(g.S * dS))
        assert slope == pytest.approx(exact, rel=1e-6, abs=1e-8)


def test_missing_samples_do_not_count():
    _, data = problem(noise=0.1)
    counts = data.counts.copy()
    counts[20:, 1] = 0
    wild = data.x.copy()
    wild[20:, 1] = 1e6
    short = dataclasses.replace(data, counts=counts)
    p = one_step(short, 1e-8, 1.0)
    a = loss_and_gradient(p, short)[0]
    b = loss_and_gradient(p, dataclasses.replace(short, x=wild))[0]
    assert a == b


def test_exact_data_are_recovered_and_training_lowers_the_loss():
    _, data = problem()
    p = one_step(data, 1e-14, 1.0)
    assert loss_and_gradient(p, data)[0] < 1e-16
    _, noisy = problem(noise=0.3)
    start = one_step(noisy, 1e-6, 0.999)
    best, losses = train(start, noisy, iterations=120, rate=5e-3, bound=0.999)
    assert min(losses) < 0.9 * losses[0]
    assert np.linalg.norm(best.A, 2, axis=(1, 2)).max() <= 0.999 + 1e-12


def test_clip_is_the_nearest_contraction():
    rng = np.random.default_rng(2)
    A = rng.standard_normal((4, 5, 5))
    near = clip(A, 1.0)
    assert np.linalg.norm(near, 2, axis=(1, 2)).max() <= 1.0 + 1e-12
    for other in clip(A + 0.1 * rng.standard_normal(A.shape), 1.0)[None]:
        assert np.linalg.norm(near - A) <= np.linalg.norm(other - A)
    inside = 0.1 * A / np.linalg.norm(A, 2, axis=(1, 2))[:, None, None]
    np.testing.assert_array_equal(clip(inside, 1.0), inside)


def test_without_the_constraint_a_long_roll_out_leaves_every_bound():
    """Growing data: the free fit follows them and overflows later, the contractive one cannot."""
    rng = np.random.default_rng(0)
    K, m = 60, 3
    x = np.zeros((K + 1, 2, m))
    x[0] = rng.standard_normal((2, m))
    Q = np.linalg.qr(rng.standard_normal((m, m)))[0]
    for k in range(K):
        x[k + 1] = x[k] @ (1.02 * Q).T
    data = ChargeData(
        x=x,
        u=np.zeros((K, 2, 2)),
        v=np.zeros((K, 2, m)),
        w=np.ones((K, 1)),
        weight=np.ones(m),
        counts=np.ones((K + 1, 2)),
    )
    free = one_step(data, 1e-12, np.inf).A[0]
    kept = one_step(data, 1e-12, 1.0 - 1e-3).A[0]
    z = np.ones(m)
    grown, held = z.copy(), z.copy()
    for _ in range(100_000 // 10):
        grown, held = free @ grown, kept @ held
    assert np.linalg.norm(grown) > 1e50
    assert np.linalg.norm(held) <= np.linalg.norm(z)


def test_port_gain_is_the_least_point_and_zero_where_nothing_is_gained():
    true, data = problem()
    with_port = dataclasses.replace(true, gamma=0.4)
    pushed = dataclasses.replace(data, x=roll_out(with_port, data))
    assert port_gain(true, pushed) == pytest.approx(0.4, rel=1e-9)
    assert port_gain(true, data) == 0.0
    away = dataclasses.replace(data, x=2 * data.x - pushed.x)  # would need a negative gain
    assert port_gain(true, away) == 0.0


def test_compiled_recursions_are_those_of_numpy():
    rng = np.random.default_rng(4)
    for m, rows in ((1, 1), (3, 5), (9, 16)):
        A = 0.6 * rng.standard_normal((20, m, m))
        x = rng.standard_normal((21, rows, m))
        ahead, back = x.copy(), x.copy()
        forward(A, ahead)
        backward(A, back)
        there = x.copy()
        for k in range(20):
            there[k + 1] += there[k] @ A[k]
        np.testing.assert_allclose(ahead, there, rtol=1e-12, atol=1e-12 * np.abs(there).max())
        here = x.copy()
        for k in range(19, 0, -1):
            here[k] += here[k + 1] @ A[k]
        np.testing.assert_allclose(back, here, rtol=1e-12, atol=1e-12 * np.abs(here).max())
