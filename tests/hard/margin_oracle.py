"""Margins from first principles, for the stress command. No code of the toolbox is used here.

Gain margins: closed-loop eigenvalues, swept and bisected in the gain k. Phase and delay margins:
a dense sweep of the eigenvalues of L on the boundary, refined at the unit circle, each checked by
det(I + exp(-j phi) L) = 0. Disk margin: the same sweep. What is compared, and how closely, is
stated at `compare`.
"""

from __future__ import annotations

import numpy as np

SIGN = 1e-8  # log |lambda|, or distance of a pole over |A|: less has no sign here
PLACE = 1e-6  # relative, of a frequency or a gain that both sides found
VALUE = 1e-6  # of det(I + k L), relative to its terms


class Plant:
    """C (s I - A)^-1 B + D by eigenvectors where these are good, else by solving.

    `delay`: the plant is z^-delay times `base`, and only its closed loops need the whole A.
    """

    def __init__(self, A, B, C, D, dt=0.0, base=None, delay=0):
        self.base, self.delay = base, delay
        self.A, self.B, self.C, self.D = (np.atleast_2d(np.asarray(M, float)) for M in (A, B, C, D))
        self.n, self.q, self.dt = len(self.A), self.D.shape[0], dt
        self.poles, V = np.linalg.eig(self.A) if self.n else (np.zeros(0), np.zeros((0, 0)))
        self.modal = self.n > 0 and np.linalg.cond(V) < 1e5
        if self.modal:
            self.CV, self.VB = self.C @ V, np.linalg.solve(V, self.B.astype(complex))
        self.size = np.linalg.norm(self.A) if self.n else 1.0

    def __call__(self, omega):
        """L at j omega, or at exp(j omega dt): (k, q, q)."""
        if self.base is not None:
            return self.base(omega) * np.exp(-1j * omega * self.dt * self.delay)[:, None, None]
        s = np.exp(1j * omega * self.dt) if self.dt else 1j * omega
        if self.modal:
            gains = 1.0 / (s[:, None] - self.poles)
            return np.einsum("im,km,mj->kij", self.CV, gains, self.VB) + self.D
        M = s[:, None, None] * np.eye(self.n) * (1 + 1e-15) - self.A
        B = np.broadcast_to(self.B, (len(s), *self.B.shape))
        return self.C @ np.linalg.solve(M, B) + self.D

    def loci(self, omega):
        """Eigenvalues of L, (k, q)."""
        L = self(omega)
        return L[:, :, 0] if self.q == 1 else np.linalg.eigvals(L)

    def closed(self, k):
        """Closed-loop poles at the gains k, (k, n)."""
        if not self.n:
            return np.zeros((len(k), 0))
        if not self.D.any():
            return np.linalg.eigvals(self.A - k[:, None, None] * (self.B @ self.C))
        # A hair off I + k D = 0, where a pole passes through infinity.
        F = np.eye(self.q) * (1 + 1e-15) + k[:, None, None] * self.D
        F += 1e-300 * np.eye(self.q)
        K = np.linalg.solve(F, np.broadcast_to(self.C, (len(k), *self.C.shape)))
        return np.linalg.eigvals(self.A - k[:, None, None] * (self.B @ K))

    def sweep(self):
        """Dense frequencies: 40 per decade, and close to every pole next to the boundary."""
        z = self.poles[np.abs(self.poles) > 1e-3].astype(complex)
        s = np.log(z) / self.dt if self.dt else self.poles
        # A double pole at 0 is found 1e-8 away from it; below, L is not known.
        size = np.abs(s)[np.abs(s) > 1e-7 * self.size]
        lo, hi = (size.min(), size.max()) if size.size else (1.0, 1.0)
        top = np.pi / self.dt if self.dt else 1e4 * hi
        lo = 1e-6 * min(lo, top)
        if not self.modal and self.base is None and not self.dt:
            lo = max(lo, 1e-5 * self.size)  # double poles at 0: |L| beyond 1e10 is not known here
        near = np.unique(np.abs(s.imag[np.abs(s.real) < 0.3 * np.abs(s)]))
        off = np.concatenate([-np.geomspace(0.3, 1e-8, 40), np.geomspace(1e-8, 0.3, 40)])
        w = np.concatenate(
            [
                np.geomspace(lo, top * (1 - 1e-9), int(40 * np.log10(top / lo))),
                (near[:, None] * (1 + off)).ravel(),
                np.linspace(0.0, top, 20 * (self.n + 2))[1:-1] if self.dt else near[:0],
            ]
        )
        return np.unique(w[(w >= lo) & (w < top)])


def section(sign, a, b, rounds=6):
    """Narrow brackets (a, b) of changes of `sign` tenfold a round; sign(x (c, 9)) -> (c, 9).

    Brackets are a quarter of their place wide at most: six rounds leave 3e-7 of it.
    """
    share = np.arange(1, 10) / 10
    at = np.arange(len(a))
    start = sign(np.repeat(a[:, None], 9, axis=1))[:, 0]
    for _ in range(rounds):
        x = a[:, None] + (b - a)[:, None] * share
        same = np.concatenate([sign(x) == start[:, None], np.zeros((len(a), 1), bool)], axis=1)
        first = np.argmin(same, axis=1)
        x = np.concatenate([a[:, None], x, b[:, None]], axis=1)
        a, b = x[at, first], x[at, first + 1]
    return 0.5 * (a + b)


def unit_crossings(plant, omega, loci):
    """Frequencies where a locus crosses the unit circle, and which pairs of neighbours are told
    apart: (i, j, by how many loci the number outside rises)."""
    f = np.log(np.maximum(np.abs(loci), 1e-300))
    sure = np.flatnonzero(np.all(np.abs(f) > SIGN, axis=1))
    outside = np.count_nonzero(f > 0, axis=1)
    i, j = sure[:-1], sure[1:]
    rise = outside[j] - outside[i]
    one = np.abs(rise) == 1
    a, b = omega[i[one]], omega[j[one]]

    def sign(x):
        values = np.abs(plant.loci(x.ravel())).reshape(*x.shape, -1)
        return np.count_nonzero(values > 1, axis=2) != outside[i[one]][:, None]

    return section(sign, a, b) if len(a) else a, (omega[i], omega[j], rise)


def gain_changes(plant, low=-3.0, high=3.0, count=60):
    """Gains at which the number of unstable closed-loop poles changes; intervals as above."""
    k = np.geomspace(10.0**low, 10.0**high, count)

    def depth(x):
        values = plant.closed(x)
        return np.abs(values) - 1 if plant.dt else values.real

    poles = depth(k)
    size = np.maximum(plant.size, k * np.linalg.norm(plant.B) * np.linalg.norm(plant.C))
    room = SIGN * (np.maximum(size, 1.0) if plant.dt else size)
    sure = np.flatnonzero(np.all(np.abs(poles) > room[:, None], axis=1))
    unstable = np.count_nonzero(poles > 0, axis=1)
    i, j = sure[:-1], sure[1:]
    changed = (unstable[i] != unstable[j]) & (j - i <= 3)
    i, j = i[changed], j[changed]

    def sign(x):
        return (
            np.count_nonzero(depth(x.ravel()) > 0, axis=1).reshape(x.shape) != unstable[i][:, None]
        )

    return section(sign, k[i], k[j]) if len(i) else k[:0], (k[i], k[j])


def singular(plant, omega, factor):
    """|det(I + factor L)| over the product of the sizes of its eigenvalues' terms."""
    if np.isinf(omega):
        values = np.linalg.eigvals(plant.D)
    elif plant.dt and omega >= np.pi / plant.dt * (1 - 1e-12):
        values = np.linalg.eigvals(plant.C @ np.linalg.solve(-np.eye(plant.n) - plant.A, plant.B)
                                   + plant.D)  # fmt: skip
    else:
        values = plant.loci(np.array([omega]))[0]
    return np.min(np.abs(1 + factor * values)) / (1 + np.min(np.abs(1 + factor * values)))


def compare(plant, found):
    """Assert that `found` (margins) agrees with the oracle.

    * Between neighbours of the sweep whose |lambda| are told from 1 by 1e-8, as many crossings
      were found as loci pass the circle (or an even number more); each single one within 1e-6, or
      where |log |lambda|| < 1e-9.
    * Each crossing that was found solves det(I + exp(-j phi) L) = 0, or det(I + k L) = 0, to 1e-6.
    * Each gain at which the number of unstable closed-loop poles changes is among the factors, to
      1e-6, or by as much as moves that pole by 1e-8 |A|.
    * The closed loop is called stable where all its poles lie 1e-8 |A| inside, not where one lies
      so far outside.
    * Gain, phase and delay margin are the best of these; no point of the sweep has a smaller disk
      margin than 1 - 1e-6 times the one said, and the one said is reached where it says.
    """
    omega = plant.sweep()
    loci = plant.loci(omega)
    good = np.all(np.isfinite(loci), axis=1)
    omega, loci = omega[good], loci[good]
    gain, phase = found.gain_crossings, found.phase_crossings

    places, (left, right, rise) = unit_crossings(plant, omega, loci)
    at = np.sort(gain[:, 0])
    number = np.searchsorted(at, right) - np.searchsorted(at, left)
    wrong = (number < np.abs(rise)) | ((number - rise) % 2 != 0)
    assert not wrong.any(), (
        f"|L| = 1 crossed {rise[wrong]} times between {left[wrong]} and {right[wrong]} rad/s, "
        f"{number[wrong]} found"
    )
    for w in places:
        near = at[np.argmin(np.abs(at - w))]
        size = np.maximum(np.abs(plant.loci(np.array([near]))), 1e-300)
        flat = np.abs(np.log(size)).min() < SIGN / 10
        assert abs(near - w) <= PLACE * w + 1e-14 * plant.size or flat, (w, at)
    for w, turn in gain:
        assert singular(plant, w, np.exp(-1j * np.deg2rad(turn))) < VALUE, (w, turn)
    for w, k in phase:
        assert singular(plant, w, k) < VALUE, (w, k)

    changes, (low, high) = gain_changes(plant)
    factors = np.sort(phase[:, 1])
    for k, a, b in zip(changes, low, high, strict=True):
        near = factors[np.argmin(np.abs(factors - k))] if len(factors) else np.inf
        if abs(near / k - 1) > PLACE:
            inside = (factors > a) & (factors < b)
            depth = plant.closed(factors[inside]) if inside.any() else np.array([[np.inf]])
            depth = np.abs(depth) - 1 if plant.dt else depth.real
            assert np.all(np.abs(depth).min(axis=1) < SIGN * plant.size), (k, factors)
    if np.linalg.svd(np.eye(plant.q) + plant.D, compute_uv=False)[-1] > 1e-6:
        depth = plant.closed(np.ones(1))[0]
        depth = np.abs(depth) - 1 if plant.dt else depth.real
        if np.all(np.abs(depth) > SIGN * np.maximum(plant.size, 1.0)):
            assert found.closed_loop_stable == np.all(depth < 0), depth
    best = np.min(np.abs(np.log(factors)), initial=np.inf)
    assert np.isclose(np.abs(np.log(found.gain_margin)), best, rtol=1e-12) or best == np.inf
    assert (found.gain_margin == np.inf) == (len(factors) == 0)
    if len(gain):
        assert np.isclose(abs(found.phase_margin), np.abs(gain[:, 1]).min(), rtol=1e-12)
    else:
        assert found.phase_margin == np.inf
    lag = np.deg2rad(gain[gain[:, 0] > 0, 1] % 360)
    delay = np.min(lag / gain[gain[:, 0] > 0, 0], initial=np.inf)
    if np.any(gain[gain[:, 0] == 0, 1] == 0):
        delay = 0.0  # a pole at 0 already, which no delay moves
    if not plant.dt and np.abs(np.linalg.eigvals(plant.D)).max() >= 1 - 1e-14:
        delay = 0.0
    assert np.isclose(found.delay_margin, delay, rtol=1e-9), (found.delay_margin, delay)

    L = plant(omega)
    I = np.eye(plant.q)  # noqa: E741
    M = np.linalg.solve(I + L, I - L)
    spread = np.abs(M[:, 0, 0]) if plant.q == 1 else np.linalg.svd(M, compute_uv=False)[:, 0]
    assert found.disk_margin <= 2 / spread.max() * (1 + 1e-6) + 1e-12
    w = found.disk_margin_frequency
    if 0 < w < omega[-1] and np.abs(1j * w - plant.poles).min(initial=1.0) > 1e-9 * w:
        L = plant(np.array([w]))[0]
        there = np.linalg.svd(np.linalg.solve(I + L, I - L), compute_uv=False)[0]
        assert np.isclose(found.disk_margin, 2 / there, rtol=1e-6, atol=1e-12)
