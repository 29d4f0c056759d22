"""Data that obey x_k+1 = x_k + dt (W_x x_k + W_eta eta_k + u_k) exactly, and linear systems."""

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from cellsys.samples import RunData, Snapshots
from cellsys.system import Block, Layout


def layout(n, name="x", kinds=("position",)):
    """n entries: the first half component, the rest field."""
    half = n // 2
    return Layout(
        [
            Block(f"cell1.{name}", (half,), "um", role="component", kind=kinds[0]),
            Block(f"matrix.{name}", (n - half,), "um", role="field", kind=kinds[0]),
        ]
    )


def one_step_data(seed=0, runs=3, T=40, n=8, n_eta=6, dt=0.1, scale="block", commands=False):
    """Exact one-step data with nonlinear laws, a random input and a random structure."""
    rng = np.random.default_rng(seed)
    W_x = -0.4 * np.eye(n) + 0.1 * rng.standard_normal((n, n))
    W_eta = rng.standard_normal((n, n_eta))
    M, shift = 0.3 * rng.standard_normal((n_eta, n)), rng.standard_normal(n_eta)
    U = rng.standard_normal((2, n))
    data = []
    for i in range(runs):
        x = np.empty((T, n))
        x[0] = 3.0 + rng.standard_normal(n)
        c = np.cumsum(0.2 * rng.standard_normal((T - 1, 2)), axis=0)
        u = c @ U if commands else rng.standard_normal((T - 1, n))
        eta = np.empty((T - 1, n_eta))
        for k in range(T - 1):
            eta[k] = np.tanh(M @ x[k] + shift) + 0.05 * rng.standard_normal(n_eta)
            x[k + 1] = x[k] + dt * (W_x @ x[k] + W_eta @ eta[k] + u[k])
        data.append(
            RunData(
                x=x,
                eta=eta,
                u=u,
                commands=c if commands else None,
                eta_start=np.tanh(M @ x[0] + shift),
                label=f"run {i}",
            )
        )
    return Snapshots(
        runs=tuple(data),
        states=layout(n),
        auxiliaries=layout(n_eta, "force", ("rate",)),
        dt=dt,
        W_x=sp.csr_array(W_x),
        W_eta=sp.csr_array(W_eta),
        command_names=("a", "b") if commands else (),
        scale=scale,
    )


def stable_matrix(m, rng, slowest=0.2, fastest=2.0):
    """Random real matrix with a pair of oscillating modes and real ones, all stable."""
    rates = np.geomspace(slowest, fastest, m)
    A = np.diag(-rates)
    A[0, 1], A[1, 0] = 1.5 * rates[1], -1.5 * rates[1]
    T = np.eye(m) + 0.3 * rng.standard_normal((m, m))
    return sla.solve(T.T, (T @ A).T).T


def linear_runs(A, B, b, dt, rng, runs=3, T=60):
    """Runs (x, c) of x' = A x + B c + b, c held over each interval of dt: exact."""
    n, k = B.shape
    whole = np.zeros((n + k + 1, n + k + 1))
    whole[:n, :n], whole[:n, n:-1], whole[:n, -1] = A, B, b
    step = sla.expm(dt * whole)
    out = []
    for _ in range(runs):
        x, c = np.empty((T, n)), rng.standard_normal((T - 1, k))
        x[0] = rng.standard_normal(n)
        for j in range(T - 1):
            x[j + 1] = step[:n, :n] @ x[j] + step[:n, n:-1] @ c[j] + step[:n, -1]
        out.append((x, c))
    return out


def state_data(arrays, dt=0.1, scale="block", **more):
    """Snapshots of states alone; `more` goes to every RunData."""
    n = arrays[0].shape[1]
    return Snapshots(
        runs=tuple(RunData(x=x, label=f"run {i}", **more) for i, x in enumerate(arrays)),
        states=layout(n),
        auxiliaries=Layout([]),
        dt=dt,
        W_x=sp.csr_array((n, n)),
        W_eta=sp.csr_array((n, 0)),
        command_names=(),
        scale=scale,
    )


def ar1_data(rho=0.5, N=20_000, dt=0.1, seed=0, runs=2):
    """A rate kept alive by noise (AR(1) with correlation rho) drives one state."""
    rng = np.random.default_rng(seed)
    data = []
    for _ in range(runs):
        noise = rng.standard_normal(N) * np.sqrt(1 - rho**2)
        eta = np.empty(N)
        eta[0] = rng.standard_normal()
        for k in range(1, N):
            eta[k] = rho * eta[k - 1] + noise[k]
        x = np.concatenate([[0.0], dt * np.cumsum(eta)])
        data.append(RunData(x=x[:, None], eta=eta[:, None]))
    return Snapshots(
        runs=tuple(data),
        states=Layout([Block("cell1.position", (1,), "um", role="component", kind="position")]),
        auxiliaries=Layout([Block("force", (1,), "pN", role="component", kind="rate")]),
        dt=dt,
        W_x=sp.csr_array((1, 1)),
        W_eta=sp.csr_array(np.ones((1, 1))),
    )


def spreading_data(seed=0, runs=4, T=120, n=40, n_eta=30, dt=5.0, first=0):
    """Runs like those of a spreading cell: a slow transient, commands that turn, noise that
    switches. Runs `first` to `first + runs` of one endless set, so that sets can be disjoint."""
    rng = np.random.default_rng(seed)
    rates = np.geomspace(2e-4, 0.05, n)
    mix = np.linalg.qr(rng.standard_normal((n, n)))[0]
    W_x = -(mix * rates) @ mix.T
    W_eta = 0.004 * rng.standard_normal((n, n_eta))
    M, U = rng.standard_normal((n_eta, n)) / np.sqrt(n), 0.05 * rng.standard_normal((2, n))
    data = []
    for i in range(first, first + runs):
        own = np.random.default_rng([seed, i])
        heading = np.cumsum(0.15 * own.standard_normal(T - 1)) + own.uniform(0, 2 * np.pi)
        c = np.column_stack([np.cos(heading), np.sin(heading)])
        x, eta = np.empty((T, n)), np.empty((T - 1, n_eta))
        x[0] = 0.05 * own.standard_normal(n)
        for k in range(T - 1):
            eta[k] = np.tanh(M @ x[k]) + 0.2 * own.standard_normal(n_eta)
            x[k + 1] = x[k] + dt * (W_x @ x[k] + W_eta @ eta[k] + c[k] @ U)
        eta_start = np.tanh(M @ x[0])
        data.append(
            RunData(x=x, eta=eta, u=c @ U, commands=c, eta_start=eta_start, label=f"run {i}")
        )
    return Snapshots(
        runs=tuple(data),
        states=layout(n),
        auxiliaries=layout(n_eta, "force", ("rate",)),
        dt=dt,
        W_x=sp.csr_array(W_x),
        W_eta=sp.csr_array(W_eta),
        command_names=("cos", "sin"),
    )
