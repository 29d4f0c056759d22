"""Naive versions that must be seen to fail: the tests assert that they do."""


def polynomial_margins(A, B, C, D) -> tuple[float, float]:
    """Gain and phase margin by way of a transfer function, as python-control's margin() does."""
    import warnings

    import control

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gain, phase, _, _ = control.margin(control.ss(A, B, C, D, 0))
    return float(gain), float(phase)


def pencil_zeros(A, B, C, D):
    """Zeros as all generalised eigenvalues of the system pencil: infinite ones come out finite."""
    import numpy as np
    import scipy.linalg as sla

    n, m = len(A), B.shape[1]
    M = np.block([[A, B], [C, D]])
    N = sla.block_diag(np.eye(n), np.zeros((m, m)))
    with np.errstate(all="ignore"):
        found = sla.eigvals(M, N)
    return found[np.isfinite(found)]


def poles_say_stable(A) -> bool:
    """A verdict from the computed poles alone."""
    import numpy as np
    import scipy.linalg as sla

    return bool(np.all(sla.eigvals(A).real < 0))
