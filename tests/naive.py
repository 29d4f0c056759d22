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


def fixed_step_crawler(system, t_end, step):
    """Classical RK4 steps, guards looked at after each step only: (times, names) of switches."""
    t, x, switches = 0.0, system.x0.copy(), []
    for k in range(round(t_end / step)):
        a = system.rhs(t, x)
        b = system.rhs(t + 0.5 * step, x + 0.5 * step * a)
        c = system.rhs(t + 0.5 * step, x + 0.5 * step * b)
        x = x + step / 6 * (a + 2 * b + 2 * c + system.rhs(t + step, x + step * c))
        t = (k + 1) * step
        for event in system.events():
            if event.guard(t, x) <= 0:
                x = event.reset(t, x)
                switches.append((t, event.name))
    return switches


def euler_polarity(p, directions, kappa, dt):
    """Explicit Euler on dp/dt = kappa p x (d x p), without renormalising: |p| drifts."""
    import numpy as np

    for d in directions:
        p = p + dt * kappa * np.cross(p, np.cross(d, p))
    return p


def lagged_tangent_velocities(system, factor, step, n_steps=25):
    """Velocity of the last node under C dx/dt = F with a kept tangent `factor` K: it alternates."""
    import numpy as np

    x, n = system.x0.copy(), system.n
    x[:n] = 1e-9
    K = factor / system.factor * system.majorant(0.0, x, step)[0].matrix().toarray()
    M = system.drag()[0] / step * np.eye(n) + K
    out = []
    for _ in range(n_steps):
        move = np.linalg.solve(M, system.efforts(0.0, x)[:n])
        x[:n] += move
        out.append(move[-1] / step)
    return np.array(out)
