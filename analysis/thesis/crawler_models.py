"""Reduced models of the 1-D crawler for `fig07_08_crawler.py`: data preparation and comparisons.

A switching cell is linear between events and jumps at them; `x' = W eta` says nothing of the
jumps. Here: which rows are learned from data (jump-aware), which from structure, what an
event-indexed return map does, and what the baselines score.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from cellsys.errors import IntegrationError
from cellsys.integrate import DOP853, simulate
from cellsys.mechanics.crawler import Crawler, build_crawlers
from cellsys.model import LatentModel
from cellsys.reduction import PCR
from cellsys.samples import RunData, Snapshots
from cellsys.system import Block, Layout

METHOD = DOP853(rtol=1e-8, atol=1e-10)
TRAIL_EVENT = "cell1 trail breaks"
N_X, N_ETA = 48, 50  # thesis x [37] and eta [40] with e_Blead, 40 nodes
EDGES = [0, 1]  # lead, trail
SWITCHING = np.r_[4:7, 8:48]  # states that jump at a switch: attached nodes, their gap, all nodes


@dataclass(frozen=True)
class Run:
    """A full-order run: samples, interval averages, instantaneous laws, switch times."""

    t: np.ndarray
    x: np.ndarray
    eta: np.ndarray
    laws: np.ndarray
    held: np.ndarray
    tension: np.ndarray
    trail_times: np.ndarray
    trail_states: np.ndarray
    event_rows: tuple[int, ...]


def full_order_run(rng: np.random.Generator | None, t: np.ndarray, **start: float) -> Run:
    """One isolated right-moving cell from a random start (or the given one)."""
    if rng is not None:
        start = {
            "trail": 4.0 + rng.uniform(-0.3, 0.3),
            "lead": 8.0 + rng.uniform(-0.6, 0.3),
            "trail_velocity": rng.uniform(-0.5, 0.5),
            "lead_velocity": rng.uniform(-0.5, 0.5),
        }
    system = build_crawlers([Crawler(**start)])
    run = simulate(system, METHOD, t)
    x = np.asarray(run.x)
    chain = system.chain
    u = np.concatenate([np.zeros((len(t), 1)), x[:, 8:48]], axis=1)
    strain = np.diff(u, axis=1) / chain.spacing
    times = np.array([e.time for e in run.events if e.name == TRAIL_EVENT])
    # The state at each trail break, on the run's own samples: cell relative to its trail node.
    states = np.array([np.interp(times, t, x[:, k]) for k in (0, 1, 2, 3)]).T
    rows = sorted({int(np.searchsorted(t, e.time, side="right")) - 1 for e in run.events})
    return Run(
        t, x[:, :N_X], np.asarray(run.eta)[:, :N_ETA], np.array([system.eta(0.0, v) for v in x]),
        x[:, N_X:], chain.stiffness * (strain + chain.stiffening * strain**3), times, states,
        tuple(r for r in rows if 0 <= r < len(t) - 1),
    )  # fmt: skip


def _layouts(system) -> tuple[Layout, Layout]:
    blocks = [b for b in system.states if not b.name.endswith(("i_lead", "i_trail"))]
    return Layout(blocks), system.auxiliaries


def data_of(
    runs: list[Run], dt: float, *, eta: str = "average", events: str = "learn",
    scale: str = "none", extra: bool = False,
) -> Snapshots:  # fmt: skip
    """Snapshots of several runs.

    eta: "average" over the following interval, "laws" at the sample (thesis), "none" (x only).
    events: "learn" keeps the intervals with a switch; "skip" leaves them out.
    extra: adds node tensions e_n to x and their rates to eta [45].
    """
    system = build_crawlers([Crawler()])
    states, auxiliaries = _layouts(system)
    W = sp.csr_array(system.W_eta[:N_X])
    if extra:
        states = states + Layout(
            [Block("chain.tension", (40,), "pN", role="field", kind="internal")]
        )
        auxiliaries = auxiliaries + Layout(
            [Block("chain.tension.rate", (40,), "pN/s", role="field", kind="internal")]
        )
        W = sp.csr_array(sp.block_diag([W, sp.eye_array(40)]))
    if eta == "none":
        auxiliaries, W = Layout(), sp.csr_array((states.size, 0))
    data = []
    for run in runs:
        x = np.hstack([run.x, run.tension]) if extra else run.x
        values = None
        if eta != "none":
            values = run.eta if eta == "average" else run.laws[:-1]
            if extra:
                values = np.hstack([values, np.diff(run.tension, axis=0) / dt])
        first = None
        if eta != "none":
            first = run.laws[0] if not extra else np.concatenate([run.laws[0], values[0, N_ETA:]])
        data.append(
            RunData(
                x=x, eta=values, skip=run.event_rows if events == "skip" else (), eta_start=first
            )
        )
    n = states.size
    return Snapshots(
        runs=tuple(data),
        states=states,
        auxiliaries=auxiliaries,
        dt=dt,
        W_x=sp.csr_array((n, n)),
        W_eta=W,
        command_names=(),
        scale=scale,
        source={},
    )


def jump_aware(data: Snapshots, order: int) -> LatentModel:
    """Eq. 24 with the rows of the states that jump learned from data instead of taken from W.

    A = V_c^T S_c^-1 W_c S V + V_s^T S_s^-1 K_s + V_eta^T S_eta^-1 K
    """
    base = PCR().fit(data, order)
    n, V = data.states.size, base.V
    inverse = np.divide(1.0, base.scale, out=np.zeros_like(base.scale), where=base.scale > 0)
    weight = inverse[:, None] * V
    now, ahead = [], []
    for run in data.runs:
        ks = run.usable()
        full = np.hstack([run.x[:-1], run.eta])
        now.append(full[ks])
        ahead.append(full[ks + 1])
    now, ahead = np.concatenate(now), np.concatenate(ahead)
    Z = np.column_stack([(now - base.mean) @ weight, np.ones(len(now))])
    rate = (ahead - now) / data.dt
    learned = np.r_[SWITCHING, np.arange(n, now.shape[1])]
    K = sla.lstsq(Z, rate[:, learned], cond=1e-12)[0]
    keep = np.setdiff1d(np.arange(n), SWITCHING)
    image = data.W_eta @ (base.scale[n:, None] * V[n:])
    offset = data.W_eta @ base.mean[n:]
    A = weight[keep].T @ image[keep] + weight[learned].T @ K[:-1].T
    b = weight[keep].T @ offset[keep] + weight[learned].T @ K[-1]
    return replace(base, A=A, offset=b, card=None, notes={"method": "jump-aware eq. 24"})


def jacobian_model(run: Run) -> np.ndarray:
    """Affine Jacobian linearisation in the mode and at the state of the run's start: x(t)."""
    system = build_crawlers([Crawler()])
    x0 = np.concatenate([run.x[0], run.held[0]])
    J = np.empty((N_X, N_X))
    for j in range(N_X):
        h = np.zeros(len(x0))
        h[j] = 1e-6
        J[:, j] = (system.rhs(0.0, x0 + h) - system.rhs(0.0, x0 - h))[:N_X] / 2e-6
    f = system.rhs(0.0, x0)[:N_X]
    dt = float(run.t[1] - run.t[0])
    E = sla.expm(dt * np.block([[J, f[:, None]], [np.zeros((1, N_X + 1))]]))
    out = np.empty_like(run.x)
    deviation = np.append(np.zeros(N_X), 1.0)
    for k in range(len(run.t)):
        out[k] = run.x[0] + deviation[:N_X]
        deviation = E @ deviation
    return out


def latent_edges(model: LatentModel, run: Run, data_run: RunData) -> np.ndarray:
    """(T, n) states of a latent roll-out; inf from where it diverges."""
    z0 = model.encode(data_run.x[0], data_run.eta_start)
    try:
        return model.reconstruct(model.predict(z0, None, run.t))
    except IntegrationError:
        return np.full_like(data_run.x, np.inf)


class ReturnMap:
    """Event-indexed affine map: (time, cell) at one trail break -> at the next; phase template.

    The state at break k is taken relative to the node index, so the same map serves every step.
    """

    def __init__(self, runs: list[Run]) -> None:
        before, after, starts, firsts, shapes = [], [], [], [], []
        for run in runs:
            s = self._relative(run)
            before.append(np.column_stack([s[:-1], np.arange(len(s) - 1), np.ones(len(s) - 1)]))
            after.append(np.column_stack([s[1:], np.diff(run.trail_times)]))
            starts.append(np.append(self._start(run), 1.0))
            firsts.append(np.append(s[0], run.trail_times[0]))
            shapes += list(self._shapes(run))
        self.step = sla.lstsq(np.concatenate(before), np.concatenate(after))[0]
        self.first = sla.lstsq(np.array(starts), np.array(firsts))[0]
        self.template = np.mean(shapes, axis=0)

    @staticmethod
    def _start(run: Run) -> np.ndarray:
        return run.x[0, [0, 1, 2, 3]]

    @staticmethod
    def _relative(run: Run) -> np.ndarray:
        s = run.trail_states.copy()
        s[:, :2] -= np.arange(len(s))[:, None]
        return s

    @staticmethod
    def _shapes(run: Run, points: int = 21):
        for a, b in zip(run.trail_times[:-1], run.trail_times[1:], strict=True):
            s = a + (b - a) * np.linspace(0, 1, points)
            edges = np.array([np.interp(s, run.t, run.x[:, k]) for k in EDGES]).T
            line = edges[0] + np.linspace(0, 1, points)[:, None] * (edges[-1] - edges[0])
            yield edges - line

    def predict(self, run: Run) -> tuple[np.ndarray, np.ndarray]:
        """(edges (T, 2), switch times) of a run from its start."""
        head = np.append(self._start(run), 1.0) @ self.first
        times, states = [head[4]], [head[:4]]
        while times[-1] < run.t[-1] and len(times) < 200:
            row = np.concatenate([states[-1], [len(times) - 1, 1.0]]) @ self.step
            times.append(times[-1] + max(row[4], 1e-3))
            states.append(row[:4])
        knots = np.concatenate([[0.0], times])
        edges = np.vstack([run.x[0, EDGES], [s[:2] + k for k, s in enumerate(states)]])
        out = np.array([np.interp(run.t, knots, edges[:, k]) for k in (0, 1)]).T
        phase = np.linspace(0, 1, len(self.template))
        for a, b in itertools.pairwise(times):
            inside = (run.t >= a) & (run.t < b)
            share = (run.t[inside] - a) / (b - a)
            for k in (0, 1):
                out[inside, k] += np.interp(share, phase, self.template[:, k])
        return out, np.array(times)


def switch_times(trail_node: np.ndarray, t: np.ndarray, start: float = 4.0) -> np.ndarray:
    """Times at which a predicted trail attachment passes the middle between two nodes."""
    out, target = [], start + 0.5
    trail_node = np.minimum(trail_node, 60.0)  # the chain ends at 41; a diverged model does not
    for a, b, ta, tb in zip(trail_node[:-1], trail_node[1:], t[:-1], t[1:], strict=True):
        while a < target <= b:
            out.append(ta + (tb - ta) * (target - a) / (b - a))
            target += 1.0
    return np.array(out)


def mse(edges: np.ndarray, run: Run, after: float = 0.0) -> float:
    """Mean over time and over (lead, trail) of the squared error, um^2 [86]."""
    rows = run.t >= after
    with np.errstate(over="ignore", invalid="ignore"):
        value = np.mean((edges[rows][:, EDGES] - run.x[rows][:, EDGES]) ** 2)
    return float(value) if np.isfinite(value) else float("inf")


def switch_error(times: np.ndarray, run: Run) -> float:
    """Rms error of the switch times that exist in both, s; NaN where fewer than half do."""
    n = min(len(times), len(run.trail_times))
    if n < 0.5 * len(run.trail_times):
        return float("nan")
    return float(np.sqrt(np.mean((times[:n] - run.trail_times[:n]) ** 2)))
