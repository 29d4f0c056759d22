"""Small systems that the integrator tests share."""

import numpy as np
import scipy.sparse as sp

from cellsys.overdamped import MajorantBlock, OverdampedSystem
from cellsys.system import Block, OdeSystem


class Springs(OverdampedSystem):
    """A chain of n nodes on cubic springs, pulled at its end; one trailing internal state.

    C x_i' = -k (d_i + d_i^3) + k (d_i+1 + d_i+1^3) + F sin(w t), s' = (x_n - s)/tau
    """

    def __init__(self, n=4, stiffness=50.0, pull=20.0, factor=1.3, stops=(), drag=2.0):
        nodes = Block("x", (n,), "um")
        states = [nodes, Block("s", (), "um", role="controller", kind="internal")]
        W = sp.diags_array([*[1.0 / drag] * n, 1.0], format="csr")
        auxiliaries = [Block("force", (n,), "pN"), Block("s.rate", (), "um/s", kind="internal")]
        super().__init__(states=states, x0=np.zeros(n + 1), auxiliaries=auxiliaries, W_eta=W)
        settings = {
            "n": n,
            "k": stiffness,
            "pull": pull,
            "factor": factor,
            "stops": stops,
            "c": drag,
        }
        for name, value in settings.items():
            object.__setattr__(self, name, value)

    def stretch(self, x):
        return np.diff(x[: self.n], prepend=0.0)

    def efforts(self, t, x):
        d = self.stretch(x)
        f = self.k * (d + d**3)
        eta = np.zeros(self.n + 1)
        eta[: self.n] = -f
        eta[: self.n - 1] += f[1:]
        return eta

    def eta(self, t, x):
        eta = self.efforts(t, x)
        eta[self.n] = (x[self.n - 1] - x[self.n]) / 5.0
        return eta

    def u(self, t, x):
        out = np.zeros(self.n + 1)
        out[self.n - 1] = self.pull * np.sin(0.3 * t) / self.c
        return out

    def stop_points(self):
        return self.stops

    def drag(self):
        return np.append(np.full(self.n, self.c), 0.0)

    def internal_blocks(self):
        return ((slice(self.n, self.n + 1), slice(self.n, self.n + 1)),)

    def advance_internal(self, t, x, x_new, dt):
        target = x[self.n - 1]
        x_new[self.n] = target + (x[self.n] - target) * np.exp(-dt / 5.0)

    def majorant(self, t, x, dt):
        D = np.eye(self.n) - np.eye(self.n, k=-1)
        K = D.T @ np.diag(self.k * (1 + 3 * self.stretch(x) ** 2)) @ D
        matrix = sp.csc_array(self.factor * K)
        return (MajorantBlock("x", np.arange(self.n)[:, None], lambda: matrix, t),)


def scalar(law, **changes):
    """x' = law(t, x) as a system with one auxiliary."""
    given = {"states": ["x"], "auxiliaries": ["rate"], "x0": [1.0], "W_eta": [[1.0]], "law": law}
    return OdeSystem(**{**given, **changes})
