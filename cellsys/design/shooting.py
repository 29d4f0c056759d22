"""A loop shot over a recording: residuals, their slopes, and the problem that IPOPT solves.

    min  1/2 |r|^2   over parameters, headings at the start and states between the pieces
    s.t. every piece begins where the one before ends

The Hessian is J^T J of the residuals (Gauss-Newton), which needs no second derivatives and is
positive semidefinite.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cellsys.errors import ParameterError
from cellsys.symbols.form import SymbolicLoop

if TYPE_CHECKING:
    import casadi as ca

_WRITTEN_OUT = 80  # states up to which a step is written out in scalars


@dataclass(frozen=True, eq=False, kw_only=True)
class ShotGrid:
    """Where a loop is shot: `count` intervals of `step` s from `start`, each in substeps."""

    start: float
    step: float
    count: int
    substeps: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Solved:
    """Where IPOPT came to: the unknowns, why it stopped ("" where it converged), what it took."""

    q: np.ndarray
    status: str
    spent: dict[str, float]


class Shooting:
    """A form over a grid of samples, for K cells whose headings (and places) are seen.

    Parameters
    ----------
    form : SymbolicLoop
    free : int array
        Which of the form's parameters are looked for.
    grid : ShotGrid
    places : bool
        Places are seen as well as headings.
    """

    def __init__(
        self, form: SymbolicLoop, free: np.ndarray, grid: ShotGrid, *, places: bool
    ) -> None:
        import casadi as ca

        self.form, self.free, self.grid = form, free, grid
        self.problems: dict[int, tuple[ca.Opti, ca.MX, ca.MX, ca.MX, ca.MX]] = {}
        self.K = sum(name.endswith("p_x") for name in form.states)
        self.n = len(form.x0)
        first = form.states.index(next(name for name in form.states if name.endswith("p_x")))
        self.heading_at = first + 3 * np.arange(self.K)
        self.places = list(range(2 * self.K)) if places else []
        self.scale = np.abs(form.p0[free])
        self.scale[self.scale == 0] = 1.0
        # One vector holds all that goes on from sample to sample: state, unknowns and time.
        F = len(free)
        s = ca.MX.sym("s", self.n + F + 1)
        x, q, t = s[: self.n], s[self.n : self.n + F], s[-1]
        p, u = self._parameters(q), ca.DM(form.u0)
        h, after = grid.step / grid.substeps, x
        once = form.step(h)
        for i in range(grid.substeps):
            after = once(after, u, p, t + i * h)
        stride = ca.Function("stride", [s], [ca.vertcat(after, q, t + grid.step)])
        written_out = self.n <= _WRITTEN_OUT and not form.wide
        self.stride = stride.expand() if written_out else stride
        seen = [x[self.heading_at + i] for i in (0, 1)]
        if self.places and form.place is not None:
            at = ca.Function("place", [form.x, form.u, form.p, form.t], [form.place])
            seen.append(at(x, u, p, t))
        read = ca.Function("read", [s], [ca.vertcat(*seen)])
        self.read = read.expand() if written_out else read
        self.width = self.read.size1_out(0)
        self._whole()

    def _whole(self) -> None:
        """The run from the start, and its slopes by the unknowns [p / scale, headings]."""
        import casadi as ca

        q = ca.MX.sym("q", len(self.free) + self.K)
        s0 = self._start(q)
        s = ca.horzcat(s0, self.stride.mapaccum("run", self.grid.count)(s0))
        r, data = self._residuals(self.read.map(self.grid.count + 1)(s))
        self.residuals = ca.Function("r", [q, data], [r])
        self.slopes = ca.Function("J", [q, data], [r, ca.jacobian(r, q)])

    def _parameters(self, q: ca.MX) -> ca.MX:
        """All parameters of the form from the free ones over their scales."""
        import casadi as ca

        p = ca.MX(ca.DM(self.form.p0))
        for i, k in enumerate(self.free.tolist()):
            p[k] = q[i] * float(self.scale[i])
        return p

    def _start(self, q: ca.MX) -> ca.MX:
        """State, unknowns and time at the start."""
        import casadi as ca

        F, x0 = len(self.free), ca.MX(ca.DM(self.form.x0))
        for k, row in enumerate(self.heading_at.tolist()):
            size = float(np.hypot(*self.form.x0[row : row + 2]))
            x0[row], x0[row + 1] = size * ca.cos(q[F + k]), size * ca.sin(q[F + k])
        return ca.vertcat(x0, q[:F], self.grid.start)

    def _residuals(self, y: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Weighted residuals of read-outs (width, T), and the data they are to.

        Data: cosines, sines, places and weights, (3 K + 2 n_places, T).
        """
        import casadi as ca

        K, n = self.K, len(self.places)
        data = ca.MX.sym("data", 3 * K + 2 * n, self.grid.count + 1)
        c, s = data[:K, :], data[K : 2 * K, :]
        angle = ca.atan2(y[K : 2 * K, :] * c - y[:K, :] * s, y[:K, :] * c + y[K : 2 * K, :] * s)
        parts = [angle * data[2 * K + n : 3 * K + n, :]]
        if n:
            parts.append((y[2 * K :, :] - data[2 * K : 2 * K + n, :]) * data[3 * K + n :, :])
        return ca.vec(ca.vertcat(*parts)), data

    def solve(self, q: np.ndarray, data: np.ndarray, pieces: int) -> Solved:
        """The unknowns that fit, by IPOPT from q (n,); each of the pieces starts at its heading."""
        if pieces not in self.problems:
            self.problems[pieces] = self._pose(pieces)
        opti, q_, X, left, given = self.problems[pieces]
        size = self.grid.count // pieces
        opti.set_initial(q_, q)
        if pieces > 1:
            opti.set_initial(X, self._guess(q, data, size)[:, size : pieces * size : size])
        opti.set_initial(left, self.residuals(q, data))
        opti.set_value(given, data)
        try:
            opti.solve()
        except RuntimeError:
            pass  # its status says so, and where it came to shows why
        stats = opti.stats()
        spent = {"iterations": float(stats["iter_count"]), "pieces": float(pieces)}
        ended = np.atleast_1d(np.asarray(opti.debug.value(q_), dtype=float))
        return Solved(q=ended, status="" if stats["success"] else stats["return_status"],
                      spent=spent)  # fmt: skip

    def _guess(self, q: np.ndarray, data: np.ndarray, size: int) -> np.ndarray:
        """States (n, T): the loop with its headings put back to what was measured."""
        K = self.K
        s = np.concatenate([self.form.x0, q[: len(self.free)], [self.grid.start]])
        for k, at in enumerate(self.heading_at.tolist()):
            angle, length = q[len(self.free) + k], float(np.hypot(*s[at : at + 2]))
            s[at : at + 2] = length * np.array([np.cos(angle), np.sin(angle)])
        rows = [s]
        for k in range(1, self.grid.count + 1):
            s = np.array(self.stride(s)).ravel()
            if k % size == 0:
                for cell, at in enumerate(self.heading_at.tolist()):
                    if data[2 * K + len(self.places) + cell, k] > 0:
                        length = float(np.hypot(*s[at : at + 2]))
                        s[at : at + 2] = length * data[[cell, K + cell], k]
            rows.append(s)
        return np.array(rows).T[: self.n]

    def _pose(self, pieces: int) -> tuple[ca.Opti, ca.MX, ca.MX, ca.MX, ca.MX]:
        import casadi as ca

        count, n, F = self.grid.count, self.n, len(self.free)
        size = count // pieces
        opti = ca.Opti()
        q, X = opti.variable(F + self.K), opti.variable(n, pieces - 1)
        s = ca.MX.sym("s", n + F + 1)
        at = ca.horzcat(s, self.stride.mapaccum("piece", size)(s))
        y = self.read.map(size + 1)(at)
        piece = ca.Function("piece", [s], [at[:n, -1], ca.vec(y[:, :-1]), y[:, -1]])
        begin = self.grid.start + self.grid.step * size * np.arange(1, pieces)
        later = ca.vertcat(X, ca.repmat(q[:F], 1, pieces - 1), ca.DM(begin).T)
        ends, seen, last = piece.map(pieces)(ca.horzcat(self._start(q), later))
        y = ca.horzcat(ca.reshape(seen, self.width, count), last[:, -1])
        r, data = self._residuals(y)
        given = opti.parameter(*data.shape)
        # Residuals are unknowns of their own: the Hessian is then the identity on them, and no
        # slope is worked out twice.
        left = opti.variable(r.numel())
        opti.subject_to(ca.substitute(r, data, given) == left)
        opti.minimize(0.5 * ca.sumsqr(left))
        if pieces > 1:
            opti.subject_to(ca.vec(ends[:, :-1]) == ca.vec(X))
        lam, start = ca.MX.sym("lam"), opti.x.numel() - r.numel()
        ones = ca.DM.zeros(opti.x.numel(), 1)
        ones[start:] = 1.0
        H = lam * ca.diag(ca.sparsify(ones))
        names = (["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])
        hess = ca.Function("gn", [opti.x, opti.p, lam, opti.lam_g], [H], *names)
        opti.solver(
            "ipopt",
            {
                "hess_lag": hess,
                "print_time": False,
                "ipopt.print_level": 0,
                "ipopt.sb": "yes",
                "ipopt.tol": 1e-7,
                "ipopt.max_iter": 60,
            },
        )
        return opti, q, X, left, given


def substeps_of(form: SymbolicLoop, step: float, count: int, start: float, most: float) -> int:
    """Steps to take between samples, so that a heading moves by less than `most` rad if halved.

    A loop with a step of its own has no choice.

    Raises
    ------
    ParameterError
        Samples that are no whole number of the loop's steps apart, or 64 steps do not do.
    """
    if form.dt is not None:
        form.step(step)
        return 1
    at = form.states.index(next(name for name in form.states if name.endswith("p_x")))
    before: np.ndarray | None = None
    for k in (1, 2, 4, 8, 16, 32, 64):  # of order 4: what is left is a fifteenth of the change
        once = form.step(step / k)
        once = once.expand() if len(form.x0) <= _WRITTEN_OUT and not form.wide else once
        run = once.mapaccum("run", k * count)
        t = start + step / k * np.arange(k * count)
        x = np.asarray(run(form.x0, form.u0, form.p0, t[None]))[at:, k - 1 :: k]
        if before is not None and np.abs(x - before).max() < 4 * most:
            return k
        before = x
    raise ParameterError(
        f"headings between samples {step:g} s apart need more than 64 steps; record more often"
    )
