"""How wrong a roll-out is: one definition of each measure.

    relative error = |x - x_true| / |x_true - x_true(0)|     over all samples and coordinates
    MSE            = (1/T) sum_k |x_k - x_true,k|^2          summed over coordinates [thesis eq. 86]

The MSE has the unit of x squared (um^2 for positions in um); it grows with the number of nodes.
"""

from __future__ import annotations

import numpy as np

MOST = 1e150  # its square is still a double


_ROUNDING = 1e-13  # of the size of the places: below it nothing has moved


# An error whose square is no double is reported as inf: divergence.
@np.errstate(over="ignore", invalid="ignore")
def relative(error: np.ndarray, truth: np.ndarray) -> float:
    """rms(error) / rms(truth - start), axis 0 is time; "nothing moves" scores 1.

    Where nothing moves: 0 without an error, else inf.
    """
    moved, missed = float(np.linalg.norm(truth - truth[0])), float(np.linalg.norm(error))
    nothing = _ROUNDING * float(np.linalg.norm(truth))
    if moved > nothing:
        return missed / moved
    return 0.0 if missed <= nothing else float("inf")


@np.errstate(over="ignore", invalid="ignore")
def mse(error: np.ndarray) -> float:
    """Mean over samples (axis 0) of the sum of squares over everything else."""
    return float(np.mean(np.sum(np.reshape(error, (len(error), -1)) ** 2, axis=1)))


def root_mean_square(values: list[float]) -> float:
    """Over runs; entries beyond 1e150 count as 1e150."""
    return float(np.sqrt(np.mean(np.square([min(v, MOST) for v in values]))))
