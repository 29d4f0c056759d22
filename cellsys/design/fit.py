"""`fit`: parameters of a loop from recorded headings or places, by multiple shooting."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg as sla
from scipy import stats

from cellsys.arguments import checked
from cellsys.design.decoupled import decoupled
from cellsys.design.fitted import Fitted, ParameterProfile, whiteness
from cellsys.design.recording import Recording
from cellsys.design.shooting import Shooting, ShotGrid, substeps_of
from cellsys.errors import (
    DataError,
    DimensionError,
    IntegrationError,
    ParameterError,
    RankError,
)
from cellsys.kinds import Count
from cellsys.loop import ClosedLoop, ScheduledLoop
from cellsys.model.sensor import StiffnessSensor
from cellsys.symbols.build import SymbolicSource, symbolic
from cellsys.symbols.form import SymbolicLoop
from cellsys.symbols.parts import PARAMETERS
from cellsys.trajectory import Trajectory

_LOST = 1e-9  # a direction whose slope is below this share of the largest is not there at all
_ANGLE = 2e-3  # rad, what steps between samples may leave of a heading
_CLOSE = np.pi / 3  # rad, from where a run in one piece finds its way
_PIECE = 15  # intervals of a piece unless told


@checked
def fit(
    loop: SymbolicSource,
    data: Recording | Trajectory,
    parameters: Sequence[str] = ("kappa",),
    *,
    per_cell: bool = False,
    place: np.ndarray | None = None,
    pieces: Count | None = None,
    level: float = 0.95,
    profile: bool = True,
) -> Fitted:
    """Parameters of a loop, with their errors, from recorded headings or places.

    Least squares by multiple shooting on `casadi.Opti` and IPOPT (Bock, in Springer Ser. Chem.
    Phys. 18, 1981); the heading of each cell at the start is fitted besides, its latent state is
    that of the loop. Standard errors are those of the linearised problem, a profile shows how far
    it is from linear.

    Parameters
    ----------
    loop : a loop that `cs.symbolic` takes
        Its parameters are where the search starts.
    data : Recording or Trajectory
        Of a trajectory its headings.
    parameters : sequence of str
        Names as in `cs.symbolic`, such as "kappa" or "sensor.gain", or of single entries, such as
        "K_d[0,3]".
    per_cell : bool
        Each cell has its own kappa, K_d, sensor.gain and force.
    place : (2, 1 + m), optional
        Map of [1; z] to the place of a cell, um; needed for positions of a plain model.
    pieces : int, optional
        Pieces of the recording that are shot on their own and joined. Default one, where the loop
        as it is stays within 60 degrees of what was seen, else one per 15 samples: pieces find
        their way from far off, and cost a slope by every state.
    level : float
        Of the intervals.
    profile : bool
        Work out the profiles too.

    Raises
    ------
    RankError
        The data do not determine a parameter; rank and condition are named.
    ParameterError, DataError, DimensionError
        An unknown parameter, a recording of other cells, or samples off the loop's steps.
    IntegrationError
        IPOPT did not converge.
    """
    began = clock.perf_counter()
    seen = Recording.of(data) if isinstance(data, Trajectory) else data
    if not 0 < level < 1:
        raise ParameterError(f"level must be between 0 and 1, got {level!r}")
    if pieces is not None and (len(seen.t) - 1) % pieces:
        raise ParameterError(
            f"pieces must divide the {len(seen.t) - 1} intervals of t, got {pieces!r}"
        )
    shot = _shooting(loop, seen, parameters, per_cell, place)
    given, weights, sigma = _data(seen, shot)
    q = np.concatenate([shot.form.p0[shot.free] / shot.scale, _first_headings(seen, shot)])
    names = (*(shot.form.parameters[i] for i in shot.free), *_start_names(shot.K))
    _excited(np.asarray(shot.slopes(q, given)[1]), names)
    built = clock.perf_counter() - began
    solved = shot.solve(q, given, pieces or _pieces(shot, q, given))
    q, spent = solved.q, solved.spent
    r, J = (np.asarray(v) for v in shot.slopes(q, given))
    r, kept = r.ravel(), weights.ravel(order="F") > 0
    samples, n = int(kept.sum()), len(q)
    if samples <= n:
        raise DataError(f"{samples} samples do not determine {n} unknowns; record more")
    noise = 1.0 if seen.known_noise else float(np.sqrt(r @ r / (samples - n)))
    scale = np.concatenate([shot.scale, np.ones(shot.K)])
    covariance, rank, condition = _covariance(J, noise, names, q)
    if solved.status:
        raise IntegrationError(
            f"the fit did not converge: IPOPT says {solved.status} after "
            f"{spent['iterations']:g} iterations; start from other values or in more pieces",
            time=float(seen.t[0]),
            state_norm=float(np.linalg.norm(q)),
            step=seen.step,
        )
    covariance = covariance * np.outer(scale, scale)
    errors = np.sqrt(np.diag(covariance))
    test = np.where(kept, r, np.nan).reshape(len(seen.t), -1)
    profiles = {}
    if profile:
        profiles = {
            names[i]: _profile(shot, given, q, i, noise, errors[i] / scale[i], level)
            for i in range(len(shot.free))
        }
    spread = float("nan")
    if seen.known_noise:
        below = float(stats.chi2.cdf(r @ r, samples - n))
        spread = 2.0 * min(below, 1.0 - below)
    values = q * scale
    return Fitted(
        names=names,
        estimates=values,
        standard_errors=errors,
        covariance=covariance,
        level=level,
        samples=samples,
        residuals=r[kept] / noise,
        noise=noise if sigma is None else sigma,
        rank=rank,
        condition=condition,
        whiteness=whiteness(test),
        spread=spread,
        profiles=profiles,
        loop=_loop_with(loop, dict(zip(names, values, strict=True))),
        spent={**spent, "build_s": built, "total_s": clock.perf_counter() - began},
    )


def _pieces(shot: Shooting, q: np.ndarray, data: np.ndarray) -> int:
    """One where the run from q is close to what was seen, else one per `_PIECE` samples."""
    K, T = shot.K, shot.grid.count + 1
    left = np.asarray(shot.residuals(q, data)).reshape(T, -1)[:, :K].T
    weights = data[2 * K + len(shot.places) : 3 * K + len(shot.places)]
    off = np.divide(left, weights, out=np.zeros_like(left), where=weights > 0)
    if np.abs(off).max(initial=0.0) < _CLOSE:
        return 1
    count = shot.grid.count
    return max((k for k in range(1, count // _PIECE + 1) if count % k == 0), default=1)


def _start_names(K: int) -> list[str]:
    return ["heading_0"] if K == 1 else [f"cell{k + 1}_heading_0" for k in range(K)]


def _shooting(
    loop: SymbolicSource,
    seen: Recording,
    parameters: Sequence[str],
    per_cell: bool,
    place: np.ndarray | None,
) -> Shooting:
    """The problem, kept with the loop: another recording on the same grid solves it anew."""
    count = len(seen.t) - 1
    key = (
        tuple(parameters), per_cell, None if place is None else place.tobytes(),
        count, float(seen.t[0]), seen.step, seen.positions is None,
    )  # fmt: skip
    kept: dict[object, Shooting] = loop.__dict__.setdefault("_shootings", {})
    if key in kept:
        return kept[key]
    groups = list(dict.fromkeys(_group(name) for name in parameters))
    form = _form(loop, groups, per_cell, place)
    free = _free(form, parameters)
    K = sum(name.endswith("p_x") for name in form.states)
    if seen.n_cells != K:
        raise DimensionError(f"data has {seen.n_cells} cells, the loop has {K}")
    seen_places = seen.positions is not None
    if seen_places and form.place is None:
        raise ParameterError("positions need place=, the map of [1; z] to the place of a cell")
    few = substeps_of(form, seen.step, count, float(seen.t[0]), _ANGLE)
    grid = ShotGrid(start=float(seen.t[0]), step=seen.step, count=count, substeps=few)
    if len(kept) >= 4:
        kept.pop(next(iter(kept)))
    kept[key] = Shooting(form, free, grid, places=seen_places)
    return kept[key]


def _form(
    loop: SymbolicSource, groups: list[str], per_cell: bool, place: np.ndarray | None
) -> SymbolicLoop:
    """The loop's form; in coordinates in which its plant is diagonal, where no parameter minds."""
    made = None
    if isinstance(loop, ClosedLoop) and set(groups) <= {"kappa", "sensor.gain", "force"}:
        made = decoupled(loop, place)
    if made is not None:
        loop, place = made
    return symbolic(loop, parameters=groups, per_cell=per_cell, place=place)


def _group(name: str) -> str:
    """Parameter of `symbolic` that an entry belongs to: ``cell2_K_d[0,3]`` -> ``K_d``."""
    bare = name.partition("[")[0]
    found = [known for known in PARAMETERS if bare == known or bare.endswith(f"_{known}")]
    if not found:
        raise ParameterError(
            f"parameters must be names such as {', '.join(PARAMETERS)}, or entries of them such as "
            f"K_d[0,3]; got {name!r}"
        )
    return max(found, key=len)


def _free(form: SymbolicLoop, parameters: Sequence[str]) -> np.ndarray:
    chosen: list[int] = []
    for name in parameters:
        own = [i for i, label in enumerate(form.parameters) if name in (label, _group(label))]
        if not own:
            raise ParameterError(f"parameters: no {name!r} among {', '.join(form.parameters)}")
        chosen += own
    if not chosen or len(set(chosen)) < len(chosen):
        raise ParameterError(f"parameters must be different ones, at least one; got {parameters}")
    return np.array(chosen)


def _data(seen: Recording, shot: Shooting) -> tuple[np.ndarray, np.ndarray, float | None]:
    """Data of `Shooting`, its weights alone, and the noise where it is given for one kind."""
    T, K, n = len(seen.t), shot.K, len(shot.places)
    angles = np.full((T, K), np.nan) if seen.headings is None else seen.headings
    places = np.zeros((T, 0)) if seen.positions is None else seen.positions.reshape(T, n)
    weights = []
    for values, noise in ((angles, seen.heading_noise), (places, seen.position_noise)):
        weights.append(np.isfinite(values).T / (1.0 if noise is None else noise))
    clean = np.nan_to_num(angles)
    parts = [np.cos(clean).T, np.sin(clean).T, np.nan_to_num(places).T, *weights]
    given = [v for v in (seen.heading_noise, seen.position_noise) if v is not None]
    return np.vstack(parts), np.vstack(weights), given[0] if len(given) == 1 else None


def _first_headings(seen: Recording, shot: Shooting) -> np.ndarray:
    """Of each cell the first that was seen; the loop's own without one."""
    x0 = shot.form.x0
    own = np.array([np.arctan2(x0[i + 1], x0[i]) for i in shot.heading_at.tolist()])
    if seen.headings is None:
        return own
    for k, column in enumerate(seen.headings.T):
        known = column[np.isfinite(column)]
        own[k] = known[0] if len(known) else own[k]
    return own


def _excited(J: np.ndarray, names: Sequence[str]) -> None:
    """Refuse parameters that move nothing, alone or against each other."""
    _, s, Vt = sla.svd(J, full_matrices=False)
    rank = int((s > _LOST * s[0]).sum()) if s[0] > 0 else 0
    if rank < len(names):
        raise RankError(_unseen(names, Vt[rank:], rank, float(s[0] / max(s[-1], 1e-300))))


def _unseen(names: Sequence[str], lost: np.ndarray, rank: int, condition: float) -> str:
    share = np.abs(lost).max(axis=0)
    blamed = [name for name, size in zip(names, share, strict=True) if size > 0.1]
    return (
        f"the data do not determine {', '.join(blamed)}: rank {rank} of {len(names)}, condition "
        f"{condition:.2g}; record a cell that turns, or fit fewer parameters"
    )


def _covariance(
    J: np.ndarray, noise: float, names: Sequence[str], q: np.ndarray
) -> tuple[np.ndarray, int, float]:
    """noise^2 (J^T J)^-1; refused where a standard error exceeds the size of what it is of."""
    _, s, Vt = sla.svd(J, full_matrices=False)
    size = np.maximum(np.abs(q), 1e-300)
    starts = np.array([name.endswith("heading_0") for name in names])
    size[starts] = 1.0  # rad
    _, own, Wt = sla.svd(J * size / noise, full_matrices=False)
    rank, condition = int((own > 1.0).sum()), float(own[0] / max(own[-1], 1e-300))
    if rank < len(q):
        raise RankError(_unseen(names, Wt[rank:], rank, condition))
    inner = Vt.T * (noise / s)
    return inner @ inner.T, rank, condition


def _profile(
    shot: Shooting,
    data: np.ndarray,
    q: np.ndarray,
    i: int,
    noise: float,
    error: float,
    level: float,
) -> ParameterProfile:
    least = float(np.sum(np.square(np.asarray(shot.residuals(q, data)))))
    steps = np.array([-3.5, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 3.5])
    values, rise, others = q[i] + error * steps, [], np.delete(np.arange(len(q)), i)
    J = np.asarray(shot.slopes(q, data)[1])
    along = -sla.lstsq(J[:, others], J[:, i])[0]
    for value in values:
        x = q.copy()
        x[i] = value
        x[others] += along * (value - q[i])
        # Gauss-Newton from where the linearised problem has its least.
        r, J = (np.asarray(v) for v in shot.slopes(x, data))
        x[others] -= sla.lstsq(J[:, others], r.ravel())[0]
        found = float(np.sum(np.square(np.asarray(shot.residuals(x, data)))))
        rise.append((found - least) / noise**2)
    reach = float(stats.norm.ppf(0.5 + 0.5 * level))
    root = np.sign(steps) * np.sqrt(np.clip(rise, 0.0, None))
    low, high = (
        float(np.interp(s, root, values, left=-np.inf, right=np.inf)) for s in (-reach, reach)
    )
    scale = float(shot.scale[i])
    return ParameterProfile(
        values=values * scale, rise=np.array(rise), low=low * scale, high=high * scale
    )


def _loop_with(loop: SymbolicSource, found: dict[str, float]) -> ClosedLoop | ScheduledLoop | None:
    """The loop with kappa and the sensor found; None where it cannot hold them."""
    if not isinstance(loop, (ClosedLoop, ScheduledLoop)):
        return None
    changed = loop
    K_d, gain = loop.sensor.K_d.copy(), found.get("sensor.gain")
    for name, value in found.items():
        if name == "kappa":
            changed = replace(changed, controller=replace(loop.controller, kappa=max(value, 0.0)))
        elif name.startswith("K_d["):
            row, column = (int(v) for v in name[4:-1].split(","))
            K_d[row, column] = value
        elif name not in ("sensor.gain", "heading_0"):
            return None
    if gain is not None:
        if type(loop.sensor) is not StiffnessSensor:
            return None
        K_d[:, 1:] *= gain
    if gain is not None or not np.array_equal(K_d, loop.sensor.K_d):
        changed = replace(changed, sensor=replace(loop.sensor, K_d=K_d))
    angle, size = found["heading_0"], float(np.hypot(*loop.p0[:2]))
    return replace(changed, p0=np.array([size * np.cos(angle), size * np.sin(angle), loop.p0[2]]))
