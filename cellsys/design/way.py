"""`Way`: places of cells under commanded headings as sums over the steps of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg as sla

from cellsys.errors import DimensionError, ParameterError
from cellsys.symbols.form import SymbolicLoop

if TYPE_CHECKING:
    import casadi as ca

_TOP = 5  # highest harmonic
_WAVES = 2 * _TOP + 1


class Way:
    """Places of K cells along a horizon as sums of what each step adds to them.

    What a step adds is found in the functions a^i, a^i cos q theta, a^i sin q theta of each cell
    (i up to 2, q up to 5), in which the commands of every plant of the package act.

    Parameters
    ----------
    form : SymbolicLoop
        With amplitude and heading of each cell as inputs.
    horizon : float
        s.
    pieces : int
        Of the commands, which are linear in each.
    start : (K, 2) or None
        Centroids, um.
    often : int
        At how many times the places are wanted; the last is the end.
    """

    def __init__(
        self, form: SymbolicLoop, horizon: float, pieces: int, start: np.ndarray | None, often: int
    ) -> None:
        import casadi as ca

        self.K = sum(name.endswith("p_x") for name in form.states)
        if form.place is None:
            raise ParameterError("the loop does not know where its cells are: give place=")
        dt = form.dt or horizon / (10 * pieces)
        count = round(horizon / dt)
        if abs(count * dt - horizon) > 1e-6 * dt or count % pieces:
            raise ParameterError(
                f"horizon must be a whole number of steps of {dt:g} s for each of the {pieces} "
                f"pieces, got {horizon:g} s"
            )
        self.times, self.knots = dt * np.arange(count + 1), np.linspace(0, horizon, pieces + 1)
        n = len(form.x0) - 3 * self.K
        u, x, t = ca.MX.sym("u", 2 * self.K), ca.MX.sym("x", n), ca.MX.sym("t")
        full = ca.vertcat(x, ca.DM(form.x0[n:]))
        if form.moved is None:
            after = form.step(dt)(full, u, ca.DM(form.p0), t)[:n]
        else:  # without what is sensed, which no commanded heading needs
            bare = ca.Function("f", [form.x, form.u, form.p, form.t], [form.moved])
            after = bare(full, u, ca.DM(form.p0), t)
        self.step = ca.Function("f", [x, u, t], [after])
        slope = ca.Function("A", [x, u, t], [ca.jacobian(after, x)])
        places = ca.Function("y", [form.x, form.u, form.p, form.t], [form.place])
        y = places(full, u, ca.DM(form.p0), t)
        read = ca.Function("y", [x, u, t], [y, ca.jacobian(y, x)])
        x0 = form.x0[:n].copy()
        y0, C = (np.asarray(v) for v in read(x0, form.u0, 0.0))
        if start is not None:
            at = np.asarray(start, dtype=float).reshape(-1)
            if at.shape != (2 * self.K,) or not np.all(np.isfinite(at)):
                raise DimensionError(f"start must be ({self.K}, 2) and finite, um")
            x0 += _moved(C, at - y0.ravel())
        base = y0.ravel() - C @ form.x0[:n]
        A = [np.asarray(slope(x0, form.u0, t)) for t in self.times[:-1]]
        seen = np.unique(np.linspace(0, count, min(often, count) + 1).astype(int)[1:])
        self.seen, rows, frees = seen, [], []
        for k in seen.tolist():
            row, blocks = C, np.zeros((count, 2 * self.K, n))
            for j in range(k - 1, -1, -1):
                blocks[j] = row
                row = row @ A[j]
            rows.append(blocks)
            frees.append(base + row @ x0)
        H = np.stack(rows)  # (seen, count, 2 K, n)
        self.P, self.free = self._added(H, n), np.concatenate(frees)
        # Commands are linear between knots; a step takes their value in its middle.
        middle = 0.5 * (self.times[1:] + self.times[:-1])
        self.W = np.array([np.interp(middle, self.knots, e) for e in np.eye(pieces + 1)]).T
        self.read, self.x0 = read, x0

    def _added(self, H: np.ndarray, n: int) -> np.ndarray:
        """(2 K seen, count, K, functions): places from the functions of each step's commands.

        Raises
        ------
        ParameterError
            Commands that act by other functions.
        """
        K, base = self.K, np.tile([1.0, 0.0], self.K)
        tried = [(a, q) for a in (0.5, 1.0, 1.5) for q in 2 * np.pi * np.arange(_WAVES) / _WAVES]
        basis = np.array([_functions(a, q) for a, q in tried])
        points = []
        for k in range(K):
            each = np.tile(base, (len(tried), 1))
            each[:, 2 * k : 2 * k + 2] = tried
            points.append(each)
        other = base + 0.1 + 0.05 * np.arange(2 * K)
        u = np.vstack([*points, base[None], other[None]])
        zero, times = np.zeros((n, 1)), self.times[:-1]
        g = np.asarray(self.step.map(len(u) * len(times))(
            np.tile(zero, (1, len(u) * len(times))), np.tile(u.T, (1, len(times))),
            np.repeat(times, len(u))[None],
        )).T.reshape(len(times), len(u), n)  # fmt: skip
        share = g[:, -2] * (K - 1) / K  # counted with every cell
        each = np.stack(
            [sla.solve(basis, (g[:, k * len(tried) : (k + 1) * len(tried)] - share[:, None])
                       .transpose(1, 0, 2).reshape(len(tried), -1)).reshape(-1, len(times), n)
             for k in range(K)], axis=1,
        )  # (functions, K, count, n)  # fmt: skip
        said = np.array([_functions(*other[2 * k : 2 * k + 2]) for k in range(K)])
        again = np.einsum("kf,fkjn->jn", said, each)
        if np.abs(again - g[:, -1]).max() > 1e-8 * max(1.0, float(np.abs(g).max())):
            raise ParameterError(
                "loop: its commands act by other functions than harmonics of the heading up to 5 "
                "and squares of the amplitude; steer takes no such plant"
            )
        P = np.einsum("sjyn,fkjn->syjkf", H, each)
        return P.reshape(-1, len(times), K, basis.shape[1])

    def sums(self, a: ca.MX, h: ca.MX) -> ca.MX:
        """Places (2 K, seen) of knots (N, K)."""
        import casadi as ca

        flat, W = ca.MX(ca.DM(self.free)), ca.DM(self.W)
        for k in range(self.K):
            drive, angle = ca.mtimes(W, a[:, k]), ca.mtimes(W, h[:, k])
            powers = [ca.MX.ones(drive.shape), drive, drive * drive]
            waves = [powers[0]]
            for q in range(1, _TOP + 1):
                waves += [ca.cos(q * angle), ca.sin(q * angle)]
            for i, (power, wave) in enumerate((p, w) for p in powers for w in waves):
                part = self.P[:, :, k, i]
                if np.any(part):
                    flat = flat + ca.mtimes(ca.DM(part), power * wave)
        return ca.reshape(flat, 2 * self.K, len(self.seen))

    def places(self, a: np.ndarray, h: np.ndarray) -> np.ndarray:
        """Centroids (T, K, 2) of a run under the knots."""
        u = np.stack([self.W @ a, self.W @ h], axis=-1).reshape(len(self.W), -1)
        x, rows = self.x0, []
        for k, t in enumerate(self.times.tolist()):
            held = u[min(k, len(u) - 1)]
            rows.append(np.asarray(self.read(x, held, t)[0]).reshape(self.K, 2))
            if k < len(u):
                x = np.asarray(self.step(x, held, t)).ravel()
        return np.array(rows)


def _functions(a: float, q: float) -> list[float]:
    """a^i and a^i cos, a^i sin of multiples of q."""
    waves = [1.0]
    for k in range(1, _TOP + 1):
        waves += [np.cos(k * q), np.sin(k * q)]
    return [power * wave for power in (1.0, a, a * a) for wave in waves]


def _moved(C: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Least change of the state that moves the places; of equivariant cells the centroids alone."""
    return sla.lstsq(C, by)[0]
