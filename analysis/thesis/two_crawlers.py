"""Two cells on one chain [thesis 48-59] for `fig07_08_crawler.py`: what coupling is worth.

Superposition [36] and feedback [57] add latent fields of isolated cells; coupling by loads adds
the *forces* on the chain, through its Green function. Every error stands beside the control:
each cell as if it were alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg as sla

from cellsys.geometry.chain import Chain
from cellsys.integrate import DOP853, simulate
from cellsys.mechanics.crawler import Crawler, build_crawlers
from cellsys.model import LatentModel
from cellsys.samples import RunData
from cellsys.trajectory import Trajectory

METHOD = DOP853(rtol=1e-8, atol=1e-10)
RIGHT = Crawler()
LEFT = Crawler(heading=-1, trail_node=37, lead_node=33)
EDGES = ("lead", "trail")


def full_order(cells: tuple[Crawler, ...], t: np.ndarray, chain: Chain | None = None) -> Trajectory:
    """Hybrid simulation of these cells on one chain."""
    return simulate(build_crawlers(cells, chain), METHOD, t)


def edges_of(run: Trajectory, cells: int) -> np.ndarray:
    """(T, 2 cells): lead and trail of each cell."""
    return np.array([run.block(f"cell{k + 1}.{e}") for k in range(cells) for e in EDGES]).T


def field_error(predicted: np.ndarray, true: np.ndarray) -> float:
    """Relative error of node displacements over the run; 1 is "no field at all"."""
    with np.errstate(over="ignore", invalid="ignore"):
        value = float(np.linalg.norm(predicted - true) / np.linalg.norm(true))
    return value if np.isfinite(value) else float("inf")


def edge_error(predicted: np.ndarray, true: np.ndarray) -> float:
    """Rms error of all edges, um."""
    with np.errstate(over="ignore", invalid="ignore"):
        value = float(np.sqrt(np.mean((predicted - true) ** 2)))
    return value if np.isfinite(value) else float("inf")


def linear_chain(chain: Chain, field: np.ndarray) -> Chain:
    """The linear chain whose Green function best gives an *isolated* cell's field from its loads.

    One number, fitted before any pair is looked at: the cubic term stiffens the chain on average.
    """
    answer = chain.displacement(chain.loads(field))
    softer = float(np.sum(answer * field) / np.sum(answer * answer))
    return replace(chain, stiffening=0.0, stiffness=chain.stiffness / softer)


def compare_mechanics(t: np.ndarray) -> tuple[dict[str, dict[str, float]], dict[str, np.ndarray]]:
    """Full-order comparisons; errors by name and the edges that are drawn."""
    chain = Chain()
    both = full_order((RIGHT, LEFT), t)
    alone = [full_order((RIGHT,), t), full_order((LEFT,), t)]
    fitted = linear_chain(chain, alone[0].block("chain.displacement"))
    linear = full_order((RIGHT, LEFT), t, fitted)
    u = both.block("chain.displacement")
    fields = [run.block("chain.displacement") for run in alone]
    true = edges_of(both, 2)
    separate = np.hstack([edges_of(run, 1) for run in alone])
    loads = chain.loads(u)
    table = {
        "no field, cells stand still": (np.zeros_like(u), np.tile(true[0], (len(t), 1))),
        "control: right cell alone": (fields[0], separate),
        "control: left cell alone": (fields[1], separate),
        "superposed isolated fields": (fields[0] + fields[1], separate),
        "loads of the pair, chain at rest": (chain.displacement(loads), true),
        "loads of the pair": (fitted.displacement(loads), true),
        "loads of isolated cells": (
            fitted.displacement(chain.loads(fields[0]) + chain.loads(fields[1])), separate,
        ),
        "cells coupled by loads (linear chain)": (
            linear.block("chain.displacement"), edges_of(linear, 2),
        ),
    }  # fmt: skip
    errors = {
        name: {"field": field_error(f, u), "edges": edge_error(e, true)}
        for name, (f, e) in table.items()
    }
    curves = {"true": true, "alone": separate, "by loads": edges_of(linear, 2), "field": u}
    return errors, curves


def mirror(rows: int, half: int) -> np.ndarray:
    """Field rows seen by the mirrored cell: node order and sign turned round, per block of 40."""
    R = np.zeros((rows, rows))
    for start in range(0, rows, half):
        for i in range(half):
            R[start + i, start + half - 1 - i] = -1.0
    return R


def compare_latent(
    model: LatentModel, start: RunData, t: np.ndarray, curves: dict[str, np.ndarray]
) -> tuple[dict[str, dict[str, float]], dict[str, np.ndarray]]:
    """Superposition [36] and feedback [57] of one model and its mirror image.

    With a centred basis a neighbour adds P z + V_phi^T mean(phi): displacement from rest. [36]
    is z_em = N z of isolated cells and couples no dynamics [notes: theory, superposition].
    """
    rows = np.asarray(model.blocks["field"])
    V, mean, scale = model.V[rows], model.mean[rows], model.scale[rows]
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    R = mirror(len(rows), 40)
    P = (V * inverse[:, None]).T @ R @ (V * scale[:, None])
    shift = (V * inverse[:, None]).T @ R @ mean
    A, b, m = model.A, model.offset, model.order
    z = np.empty((len(t), m))
    z[0] = model.encode(start.x[0], start.eta_start)
    fed = z.copy()
    fed[0] = z[0] + P @ z[0] + shift
    dt = float(t[1] - t[0])
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(t) - 1):
            z[k + 1] = z[k] + dt * (A @ z[k] + b)
            # Both cells are mirror images of each other here: one latent state serves for two.
            rate = A @ fed[k] + b
            fed[k + 1] = fed[k] + dt * (rate + P @ rate)
        paths = {"isolated": z, "[36]": z + z @ P.T + shift, "[57]": fed}
        errors, drawn = {}, {}
        for name, path in paths.items():
            x = model.reconstruct(path)
            edges = np.hstack([x[:, :2], 41.0 - x[:, :2]])
            u = x[:, 8:48]
            if name == "isolated":
                u = u - u[:, ::-1]
            errors[f"latent, {name}"] = {
                "field": field_error(u, curves["field"]),
                "edges": edge_error(edges, curves["true"]),
            }
            drawn[name] = edges
    return errors, drawn


def check_59(model: LatentModel, W: np.ndarray) -> dict[str, float]:
    """|P_alpha + P_chi + P_phi - I| [59] with the model's basis, and with a random one.

    P_s = V^T blkdiag(W M_s W^#, M_s) V: the sum is V_x^T W W^# V_x + V_eta^T V_eta, the identity
    only where range(V_x) lies in range(W).
    """
    n, n_eta = W.shape
    alpha, chi = [0, 1, 2, 3, 9], [4, 5, 6, 7, 8]
    groups = (alpha, chi, list(range(10, n_eta)))
    pinv, rank = sla.pinv(W, atol=1e-10, rtol=0.0, return_rank=True)
    rng = np.random.default_rng(0)
    other = sla.qr(rng.standard_normal((n + n_eta, model.order)), mode="economic")[0]
    out = {"rank of W": float(rank)}
    for name, V in (("model", model.V), ("random", other)):
        total = np.zeros((V.shape[1], V.shape[1]))
        for group in groups:
            M = np.zeros(n_eta)
            M[group] = 1.0
            total += V[:n].T @ (W * M) @ (pinv @ V[:n]) + (V[n:].T * M) @ V[n:]
        out[name] = float(np.abs(total - np.eye(len(total))).max())
    return out
