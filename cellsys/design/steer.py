"""`steer`: commands that bring cells to a place, a heading or a gap, at the least effort.

With headings commanded the plant is affine in its state, x_k+1 = A_k x_k + g_k(u_k), so that all
places are sums of what each step adds,

    y_k = C Phi(k, 0) x_0 + sum_j C Phi(k, j + 1) g_j(u_j)

(see `Way`) and the problem for IPOPT has no unknowns but the knots of the commands:

    min  mean (a - 1)^2 + mean (turn between knots)^2 + heavy |miss|^2
    s.t. bounds on amplitude and turning; centroids outside obstacles
"""

from __future__ import annotations

import time as clock
from collections.abc import Sequence

import numpy as np

from cellsys.arguments import checked
from cellsys.cell.model import EquivariantModel
from cellsys.design.steered import Steered, miss_of, unit_line
from cellsys.design.target import Obstacle, Target
from cellsys.design.way import Way
from cellsys.errors import DimensionError, ParameterError
from cellsys.kinds import Count
from cellsys.loop import ScheduledLoop
from cellsys.population.ported.equivariant_cells import EquivariantCells
from cellsys.scene.scene import Scene
from cellsys.symbols.build import SymbolicSource, symbolic
from cellsys.units import real_number

AMPLITUDE = (0.4, 1.6)  # of training runs with turning commands
TURNING = 0.02  # rad/s, the same
_HEAVY = 1e3  # of a miss of the size that counts as reached, against a unit of effort
_SEEN = 15  # times along the way at which obstacles are looked at


@checked
def steer(
    loop: SymbolicSource,
    target: Target,
    inputs: Sequence[str] = ("amplitude", "heading"),
    *,
    horizon: float,
    pieces: Count = 15,
    start: np.ndarray | None = None,
    avoid: Sequence[Obstacle] = (),
    amplitude: tuple[float, float] | None = None,
    turning: float | None = None,
    place: np.ndarray | None = None,
    scene: Scene | None = None,
    folder: str | None = None,
) -> Steered:
    """Commands that bring cells to a target with bounded effort, and whether they will.

    The effort is a local least, the best of three starts.

    Found on the reduced loop by `casadi.Opti` and IPOPT; with a `scene` they are run on its
    full-order model afterwards and the miss is reported.

    Parameters
    ----------
    loop : a loop that `cs.symbolic` takes
        Of cells whose place is known: equivariant ones, or with `place`.
    target : Target
    inputs : sequence of {"amplitude", "heading"}
        What is commanded; the heading always. Without "amplitude" it stays 1.
    horizon : float
        s, a whole number of the loop's steps for each of the pieces.
    pieces : int
        Of the commands, which are linear in each.
    start : (2,) or (K, 2), optional
        Centroids at contact, um; default those of the scene, else the loop's own.
    avoid : sequence of Obstacle
    amplitude : (low, high), optional
        Default the range the model was trained in, else 0.4 to 1.6.
    turning : float, optional
        Greatest rate of the heading, rad/s; default that of the training, else 0.02.
    place : (2, 1 + m), optional
        As in `cs.symbolic`.
    scene : Scene, optional
        Whose full-order model the commands are run on.
    folder : str, optional
        Where that run is cached.

    Raises
    ------
    ParameterError, DimensionError
        Inputs that are not commanded headings, a horizon off the steps, a loop without places,
        targets of other cells.
    """
    began = clock.perf_counter()
    told = _inputs(inputs)
    steps_to = real_number(horizon, "horizon")
    if not (np.isfinite(steps_to) and steps_to > 0):
        raise ParameterError(f"horizon must be > 0 s, got {horizon!r}")
    form = symbolic(loop, parameters=(), inputs=("amplitude", "heading"), place=place)
    if scene is not None and start is None:
        start = np.array([c.position for c in scene.membranes])
    way = Way(form, steps_to, pieces, start, _SEEN if avoid else 1)
    _fits(target, way.K)
    low_high, rate = _bounds(loop, amplitude, turning)
    found: tuple[float, np.ndarray, np.ndarray] | None = None
    iterations = 0.0
    for bend in (0.0, 0.8, -0.8):  # a start each, for there are ways to both sides
        cost, a, h, count = _solve(way, target, avoid, told, low_high, rate, bend)
        iterations += count
        if found is None or cost < found[0]:
            found = cost, a, h
    if found is None:
        raise ParameterError("avoid: no start was tried")
    _, a, h = found
    places = way.places(a, h)
    clear = min((_clear(places, o) for o in avoid), default=float("inf"))
    turns = np.diff(h, axis=0)
    steered = Steered(
        target=target,
        t=way.knots,
        amplitude=a,
        heading=h,
        times=way.times,
        places=places,
        miss=miss_of(target, places[-1], h[-1], unit_line(places[0])),
        band=_band(loop, steps_to),
        clear=clear,
        effort=float(np.mean((a - 1.0) ** 2) + np.mean(turns**2)),
        full=None,
        spent={"iterations": iterations, "total_s": clock.perf_counter() - began},
    )
    return steered if scene is None else steered.check(scene, folder)


def _inputs(inputs: Sequence[str]) -> bool:
    """Whether the amplitude is commanded."""
    if "external_strain" in inputs:
        raise ParameterError(
            "inputs: 'external_strain' moves the edge of the matrix, which no reduced loop has as "
            "an input; command 'heading', or load the matrix: cs.symbolic(cells, points=...)"
        )
    if "heading" not in inputs or set(inputs) - {"amplitude", "heading"}:
        raise ParameterError(
            f"inputs must be 'heading', with 'amplitude' or without, got {list(inputs)}"
        )
    return "amplitude" in inputs


def _fits(target: Target, K: int) -> None:
    for name, value in (("place", target.place), ("heading", target.heading)):
        if value is not None and len(np.atleast_1d(value)) != K:
            raise DimensionError(
                f"target: {name} is of {len(np.atleast_1d(value))} cells, the loop has {K}"
            )
    if target.gap is not None and K != 2:
        raise DimensionError(f"target: a gap is between two cells, the loop has {K}")


def _bounds(
    loop: SymbolicSource, amplitude: tuple[float, float] | None, turning: float | None
) -> tuple[tuple[float, float], float]:
    known = None
    if isinstance(loop, (ScheduledLoop, EquivariantCells)) and isinstance(
        loop.model, EquivariantModel
    ):
        known = loop.model.monitor
    if amplitude is None:
        amplitude = AMPLITUDE if known is None else known.amplitude
    if not (len(amplitude) == 2 and 0 <= amplitude[0] <= amplitude[1] < np.inf):
        raise ParameterError(f"amplitude must be (low, high) with 0 <= low, got {amplitude!r}")
    if turning is None:
        turning = TURNING if known is None else known.turning / float(loop.model.dt or 1.0)
    if not (np.isfinite(turning) and turning >= 0):
        raise ParameterError(f"turning must be finite and >= 0 rad/s, got {turning!r}")
    return amplitude, turning


def _band(loop: SymbolicSource, t: float) -> float:
    model = loop.model
    if isinstance(model, EquivariantModel) and model.bands is not None:
        return float(model.bands.at("centroid", np.array(t), 0.95))
    return float("nan")


def _clear(places: np.ndarray, obstacle: Obstacle) -> float:
    far = np.linalg.norm(places - np.array(obstacle.center), axis=-1)
    return float(far.min()) - obstacle.radius


def _solve(
    way: Way,
    target: Target,
    avoid: Sequence[Obstacle],
    told: bool,
    amplitude: tuple[float, float],
    turning: float,
    bend: float,
) -> tuple[float, np.ndarray, np.ndarray, float]:
    """(cost, amplitudes, headings (N, K), iterations) from headings at the target, bent aside."""
    import casadi as ca

    opti, N, K = ca.Opti(), len(way.knots), way.K
    a, h = opti.variable(N, K), opti.variable(N, K)
    y = way.sums(a, h)
    first = np.asarray(way.read(way.x0, np.zeros(2 * K), 0.0)[0]).reshape(K, 2)
    opti.subject_to(opti.bounded(*((amplitude[0], ca.vec(a), amplitude[1]) if told
                                   else (1.0, ca.vec(a), 1.0))))  # fmt: skip
    most = turning * (way.knots[1] - way.knots[0])
    turns = h[1:, :] - h[:-1, :]
    opti.subject_to(opti.bounded(-most, ca.vec(turns), most))
    last, misses = y[:, -1], []
    aim = np.zeros(K)
    if target.place is not None:
        wanted = target.place.ravel()
        for i in np.flatnonzero(np.isfinite(wanted)).tolist():
            misses.append((last[i] - float(wanted[i])) / target.within)
        off = np.nan_to_num(target.place - first)
        aim = np.arctan2(off[:, 1], off[:, 0])
    if target.gap is not None:
        line = unit_line(first)
        apart = float(line[0]) * (last[2] - last[0]) + float(line[1]) * (last[3] - last[1])
        misses.append((apart - target.gap) / target.within)
        if target.place is None:
            wide = target.gap > np.linalg.norm(first[1] - first[0])
            towards = float(np.arctan2(line[1], line[0]))
            aim = np.array([towards + np.pi * wide, towards + np.pi * (not wide)])
    if target.heading is not None:
        goal = np.atleast_1d(target.heading)
        goal = aim + np.angle(np.exp(1j * (goal - aim)))
        opti.subject_to(h[-1, :].T == ca.DM(goal))
    for spot in avoid:
        for k in range(K):
            far = (y[2 * k, :] - spot.center[0]) ** 2 + (y[2 * k + 1, :] - spot.center[1]) ** 2
            opti.subject_to(ca.vec(far) >= spot.radius**2)
    effort = ca.sumsqr(a - 1.0) / (N * K) + ca.sumsqr(turns) / ((N - 1) * K)
    opti.minimize(effort + _HEAVY * ca.sumsqr(ca.vertcat(0.0, *misses)))
    opti.set_initial(a, 1.0)
    share = np.linspace(1.0, -1.0, N)[:, None]
    opti.set_initial(h, aim + bend * share)
    opti.solver(
        "ipopt",
        {
            "print_time": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.max_iter": 100,
            "ipopt.tol": 1e-5,
            "ipopt.mu_strategy": "adaptive",
        },
    )
    try:
        opti.solve()
    except RuntimeError:
        pass  # an obstacle that cannot be passed, say: what it came to is judged as it is
    stats = opti.stats()
    cost = float(opti.debug.value(opti.f)) + (0.0 if stats["success"] else 1e6)
    values = [np.asarray(opti.debug.value(v), dtype=float).reshape(N, K) for v in (a, h)]
    return cost, values[0], values[1], float(stats["iter_count"])
