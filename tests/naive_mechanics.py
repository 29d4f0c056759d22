"""Naive versions of forces, steps and switches; see `tests.naive`."""

import warnings

import numpy as np
from scipy.integrate import RK45, Radau, solve_ivp


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


def lagged_tangent_velocities(system, factor, step, n_steps=25):
    """Velocity of the last node under C dx/dt = F with a kept tangent `factor` K: it alternates."""
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


def two_step_extrapolation(system, t_end, step):
    """x' by the explicit two-step rule of the same order, x+ = x + h (3 f - f_before)/2."""
    x, before = system.x0.copy(), None
    with np.errstate(all="ignore"):
        for k in range(round(t_end / step)):
            now = system.rhs(k * step, x)
            x = x + step * (now if before is None else 1.5 * now - 0.5 * before)
            before = now
    return x


def spring_force(a, b, rest, stiffness):
    """k (L - rest) along (b - a)/L: 0/0 where the ends meet."""
    d = b - a
    with np.errstate(all="ignore"):
        length = np.linalg.norm(d)
        return stiffness * (length - rest) * d / length


def fixed_step_end(system, t_end, step):
    """Explicit Euler to the end, whatever comes out."""
    x = system.x0.copy()
    with np.errstate(all="ignore"):
        for k in range(round(t_end / step)):
            x = x + step * system.rhs(k * step, x)
            if not np.isfinite(x).all():
                return x
    return x


def fixed_step_crossing(at, step):
    """Time at which a clock read every `step` notices that `at` has passed."""
    t = 0.0
    while t < at:
        t += step
    return t


def sign_steps(x, step, t_end):
    """x' = -sign(x) by explicit steps."""
    out = []
    for _ in range(round(t_end / step)):
        x = x - step * np.sign(x)
        out.append(x)
    return np.array(out)


def last_local_error(problem, rtol, atol):
    """(x, what the last step of Radau adds to the error): earlier steps are left out."""
    rhs = problem.rhs
    solver = Radau(rhs, 0.0, problem.x0, problem.end, rtol=rtol, atol=atol)
    while solver.status == "running":
        before = solver.y.copy()
        solver.step()
    again = solve_ivp(
        rhs, (solver.t_old, solver.t), before, "Radau", rtol=1e-12, atol=1e-3 * atol * rtol
    )
    return solver.y, np.abs(solver.y - again.y[:, -1])


def fibre_tangent(places, disc):
    """Whole tangent -dF/dx of linear fibres, compressed ones included: indefinite (n 3, n 3)."""
    K = np.zeros((len(places), 3, len(places), 3))
    for (i, j), k, rest in zip(disc.fibres, disc.stiffness, disc.length, strict=True):
        d = places[j] - places[i]
        length = np.linalg.norm(d)
        along = np.outer(d, d) / length**2
        one = k * along + k * (1.0 - rest / length) * (np.eye(3) - along)
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            K[a, :, b, :] += sign * one
    return K.reshape(3 * len(places), -1)


def film_without_tension(system, disc, x, dt, steps):
    """Heights of the free nodes of a film whose tangent leaves out tension across the fibres."""
    x, free = x.copy(), ~disc.clamped
    n = len(free)
    flat = disc.position * [1.0, 1.0, 0.0]
    K = np.zeros((n, 3, n, 3))
    for (i, j), k in zip(disc.fibres, disc.stiffness, strict=True):
        d = (flat[j] - flat[i]) / np.linalg.norm(flat[j] - flat[i])
        one = 1.1 * k * np.outer(d, d)
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            K[a, :, b, :] += sign * one
    moving = np.repeat(free, 3)
    M = K.reshape(3 * n, -1)[np.ix_(moving, moving)] + np.diag(system.drag()[moving] / dt)
    out = [x.reshape(n, 3)[free, 2].copy()]
    for _ in range(steps):
        force = system.auxiliaries.view(system.efforts(0.0, x), "matrix.matrix_elasticity")
        x[moving] += np.linalg.solve(M, force.ravel()[moving])
        out.append(x.reshape(n, 3)[free, 2].copy())
    return np.array(out)


def one_sided_rupture(force, nodes):
    """Loads after a rupture that clears the cell's `nodes` rows and not those of the matrix."""
    left = force.copy()
    left[:nodes] = 0.0
    return left


def normalised_weights(x, rest, reach):
    """(1 - d^2/reach^2)^3 over its sum: 0/0 for a node that has nothing in reach."""
    d2 = ((x[:, None, :2] - rest[None, :, :2]) ** 2).sum(axis=2)
    q = np.maximum(1.0 - d2 / reach**2, 0.0) ** 3
    with np.errstate(all="ignore"):
        return q / q.sum(axis=1, keepdims=True)


def sampled_crossings(guard, times):
    """Sign changes of a guard seen at some times only: a dip between two of them is not."""
    values = np.array([guard(t) for t in times])
    return int(np.sum((values[:-1] > 0) & (values[1:] <= 0)))


def accumulated(start, step, count):
    """A time as start + step + step + ...: far from zero it stands still."""
    for _ in range(count):
        start = start + step
    return start


def tolerance_taken(rtol):
    """The relative tolerance that scipy works with when it is asked for one; it only warns."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return float(np.max(RK45(lambda t, x: -x, 0.0, [1.0], 1.0, rtol=rtol).rtol))


def integrated_with_one_tolerance(A, u, t, atol=1e-6):
    """x(t) of x' = A x + u from 0 at scipy's usual tolerances: blind to small numbers."""
    return solve_ivp(lambda _, x: A @ x + u, (0.0, t), np.zeros(len(A)), atol=atol).y[:, -1]


def own_seed_each(count):
    """Seeds of runs that are to be compared, drawn anew for each of them."""
    return range(3, 3 + count)


def restarted(simulate, system, method, t, x, seed):
    """Second half of a run as a new run from its last state: the stepper's memory is lost."""
    return simulate(system, method, t, x, seed=seed, auxiliaries=False)


def gap_along_centres(a, b):
    """Distance of the centres less how far each cell reaches along their line (T,), um.

    a, b (T, n, 3). Right for spheres; slanted cells that pass each other by um "overlap".
    """
    between = (b.mean(axis=1) - a.mean(axis=1))[:, :2]
    distance = np.linalg.norm(between, axis=1)
    e = between / distance[:, None]
    reach = [
        np.einsum("tni,ti->tn", x[:, :, :2] - x[:, :, :2].mean(axis=1)[:, None], s * e).max(axis=1)
        for x, s in ((a, 1.0), (b, -1.0))
    ]
    return distance - reach[0] - reach[1]
