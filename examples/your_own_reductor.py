"""A reductor of your own: total least squares, whose poles noise does not damp (Hemati 2017)."""

import numpy as np
import scipy.linalg as sla

import cellsys as cs


class TotalLeastSquares:
    """z+ = A z + b from pairs (z, z+) that are first cleaned together by one SVD."""

    name = "TotalLeastSquares"

    def fit(self, snapshots, order, *, test=None, basis=None):
        basis = cs.fit_basis(snapshots, order) if basis is None else basis
        V, dt = basis.V[:, :order], snapshots.dt
        weight = basis.inverse_scale()[:, None] * V
        z = [(np.asarray(run.x) - basis.mean) @ weight for run in snapshots.runs]
        now, ahead = np.concatenate([r[:-1] for r in z]), np.concatenate([r[1:] for r in z])
        mean, then = now.mean(axis=0), ahead.mean(axis=0)
        left = sla.svd(np.hstack([now - mean, ahead - then]), full_matrices=False)[0][:, :order]
        A = sla.lstsq(left.T @ (now - mean), left.T @ (ahead - then))[0].T
        return cs.LatentModel(
            A=(A - np.eye(order)) / dt, offset=(then - A @ mean) / dt, dt=dt, V=V,
            mean=basis.mean, scale=basis.scale, n_states=len(V), notes={"method": self.name},
        )  # fmt: skip


rng, t = np.random.default_rng(0), 0.1 * np.arange(300)
modes = np.exp((-0.02 + 1j) * t)  # the pole is -0.02 + 1j 1/s
mix = rng.standard_normal((2, 12))
starts = np.exp(1j * np.arange(6))
runs = [np.column_stack([(s * modes).real, (s * modes).imag]) @ mix for s in starts]
noisy = [x + 0.3 * rng.standard_normal(x.shape) for x in runs]
train, test = (cs.snapshots(part, dt=0.1, scale="none") for part in (noisy[:4], noisy[4:]))
print(cs.compare_reductors(train, test, [2], [cs.LeastSquares(), TotalLeastSquares()]))
for method in (cs.LeastSquares(), TotalLeastSquares()):
    print(method.name, cs.poles(cs.reduce(train, order=2, method=method, test=test).plant())[0])
