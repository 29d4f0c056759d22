"""Naive versions that must be seen to fail: the tests assert that they do."""

import control
import numpy as np
import scipy.linalg as sla
from scipy.signal import ss2tf

from cellsys.response import margins
from tests.naive_files import (  # noqa: F401
    array_by_offset,
    bytes_promised_without_a_word,
    float_of_locale,
    load_everything,
    locked_by_a_file,
    mapped_rows,
    raw_rows,
    unpacked_size,
    write_in_place,
)
from tests.naive_mechanics import (  # noqa: F401
    accumulated,
    fibre_tangent,
    film_without_tension,
    fixed_step_crawler,
    fixed_step_crossing,
    fixed_step_end,
    integrated_with_one_tolerance,
    lagged_tangent_velocities,
    last_local_error,
    normalised_weights,
    one_sided_rupture,
    own_seed_each,
    restarted,
    sampled_crossings,
    sign_steps,
    spring_force,
    tolerance_taken,
    two_step_extrapolation,
)


def polynomial_margins(A, B, C, D) -> tuple[float, float]:
    """Gain and phase margin by way of a transfer function: roots of polynomials in the frequency.

    Numerator and denominator are characteristic polynomials, as textbooks have it; what is lost
    in their coefficients is lost. NaN where the roots cannot be had.
    """
    A, B, C = (np.asarray(M, dtype=float) for M in (A, B, C))
    with np.errstate(all="ignore"):
        den = np.poly(A)
        num = np.poly(A - B @ C) + (float(np.asarray(D).item()) - 1.0) * den
        turn = 1j ** np.arange(len(den))[::-1]  # of s = j w, power by power
        n, d = np.poly1d(num * turn), np.poly1d(den * turn)
        conjugate = np.poly1d(np.conj(den * turn))

        def positive(polynomial):
            roots = np.roots(np.real(polynomial.coefficients))
            return np.sort(roots[(roots.imag == 0.0) & (roots.real > 0.0)].real)

        try:
            flips = positive(np.poly1d(np.imag((n * conjugate).coefficients)))
            unit = positive(n * np.poly1d(np.conj(num * turn)) - d * conjugate)
        except np.linalg.LinAlgError:
            return np.nan, np.nan
        at = n(flips) / d(flips)
        gains = 1.0 / np.abs(at[at.real < 0.0])
        phases = np.degrees(np.angle(-(n(unit) / d(unit)))) % 360.0
    gain = float(gains[np.argmin(np.abs(np.log(gains)))]) if gains.size else np.inf
    return gain, float(phases.min()) if phases.size else np.inf


def grid_margins(A, B, C, D, dt=0.0) -> tuple[float, float, float]:
    """Gain, phase and delay margin from changes of sign between neighbours of a grid that ends a
    decade beyond the poles: nothing below it, nothing above it, and a pole is a crossing."""
    A, B, C = (np.atleast_2d(np.asarray(M, float)) for M in (A, B, C))
    poles = np.linalg.eigvals(A).astype(complex)
    size = np.abs(np.log(poles[np.abs(poles) > 1e-6]) / dt if dt else poles)
    size = size[size > 0] if size.any() else np.ones(1)
    hi = min(10 ** np.ceil(np.log10(size.max())), np.pi / dt if dt else np.inf)
    w = np.geomspace(10 ** np.floor(np.log10(size.min()) - 1), 1.01 * hi, 400)

    def loci(omega):
        s = np.exp(1j * omega * dt) if dt else 1j * omega + 1e-14
        return np.linalg.eigvals(C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D)

    def factor(a, b):  # halving the interval in which an imaginary part changes its sign
        up = np.sort(loci(a).imag) > 0
        for _ in range(45):
            middle = 0.5 * (a + b)
            same = np.array_equal(np.sort(loci(middle).imag) > 0, up)
            a, b = (middle, b) if same else (a, middle)
        return 1 / np.abs(loci(b)).max()

    path = np.array([loci(x) for x in w])
    signs = np.sort(path.imag, axis=1) > 0
    turns = [k for k in range(len(w) - 1) if not np.array_equal(signs[k], signs[k + 1])
             and path[k + 1].real.min() < 0]  # fmt: skip
    factors = np.array([factor(w[k], w[k + 1]) for k in turns])
    outside = np.sort(np.abs(path), axis=1) > 1
    k, i = np.nonzero(np.diff(outside, axis=0))
    order = np.argsort(np.abs(path), axis=1)
    phase = np.degrees(np.angle(-path[k + 1, order[k + 1, i]]))
    lag = np.radians(phase % 360) / w[k + 1]
    gain = factors[np.argmin(np.abs(np.log(factors)))] if len(factors) else np.inf
    least = phase[np.argmin(np.abs(phase))] if len(phase) else np.inf
    return float(gain), float(least), float(lag.min(initial=np.inf))


def seven_time_constants(A):
    """501 times to seven time constants of the slowest mode, whatever the others do."""
    return np.linspace(0.0, 7.0 / np.abs(np.linalg.eigvals(A).real).min(), 501)


def phase_by_unwrapping(num, den, omega) -> float:
    """Phase in deg, moved into (-270, 90]: poles at the origin are not counted."""
    angle = np.degrees(np.angle(np.polyval(num, 1j * omega) / np.polyval(den, 1j * omega)))
    return float(angle - 360 * np.round((angle + 90) / 360))


def pencil_zeros(A, B, C, D):
    """Zeros as all generalised eigenvalues of the system pencil: infinite ones come out finite."""
    n, m = len(A), B.shape[1]
    M = np.block([[A, B], [C, D]])
    N = sla.block_diag(np.eye(n), np.zeros((m, m)))
    with np.errstate(all="ignore"):
        found = sla.eigvals(M, N)
    return found[np.isfinite(found)]


def poles_say_stable(A) -> bool:
    """A verdict from the computed poles alone."""
    return bool(np.all(sla.eigvals(A).real < 0))


def euler_polarity(p, directions, kappa, dt):
    """Explicit Euler on dp/dt = kappa p x (d x p), without renormalising: |p| drifts."""
    for d in directions:
        p = p + dt * kappa * np.cross(p, np.cross(d, p))
    return p


def uncentred_pcr(data, basis, intercept):
    """eq. 24 in an uncentred basis, A alone: right without an intercept, wrong with one."""
    n, S, V = data.states.size, basis.scale, basis.V
    weight = basis.inverse_scale()[:, None] * V
    now, rate = [], []
    for run in data.runs:
        z_eta = run.eta @ weight[n:]
        now.append((run.x[:-1] @ weight[:n] + z_eta)[:-1])
        rate.append(np.diff(z_eta, axis=0) / data.dt)
    now = np.concatenate(now)
    columns = np.column_stack([now, np.ones(len(now))]) if intercept else now
    K = np.linalg.lstsq(columns, np.concatenate(rate), rcond=None)[0][: now.shape[1]]
    image = data.W_x @ (S[:n, None] * V[:n]) + data.W_eta @ (S[n:, None] * V[n:])
    return weight[:n].T @ image + K.T


def backward_slope(eta, dt):
    """Slope of (eta_k - eta_k-1)/dt on eta_k: damping comes out with the wrong sign."""
    return float(np.polyfit(eta[1:], np.diff(eta) / dt, 1)[0])


def pole_error_of_one_long_run(runs, dt, exact):
    """Poles from runs glued into one: differences across the seams."""
    x = np.concatenate(runs)
    step = np.linalg.lstsq(x[:-1], x[1:], rcond=None)[0].T
    poles = np.log(np.linalg.eigvals(step).astype(complex)) / dt
    return float(np.abs(np.sort_complex(poles) - exact).max())


def columns_reached_by_arctan():
    """Columns of M_pol that arctan(y/x) + 90 degrees finds over the full turn: half of them."""
    theta = np.radians(np.arange(360) + 0.25)
    return len(set(np.floor(np.degrees(np.arctan(np.sin(theta) / np.cos(theta))) + 90.0)))


def half_turn_table(table):
    """M_pol as an unsigned angle sees it: headings of the lower half read the upper half."""
    return np.column_stack([table[:, :180], table[:, :180]])


def positive_sign_margin(point):
    """Gain margin of +(kappa/s)(G - |d|): the sign of the text, for negative feedback wrong."""
    m = len(point.A_plant)
    A = np.zeros((m + 1, m + 1))
    A[:m, :m], A[:m, m] = point.A_plant, point.B_heading
    B = np.zeros((m + 1, 1))
    B[m, 0] = point.kappa
    C = np.concatenate([point.S_heading, [-point.strength]])[None]
    return margins(control.ss(A, B, C, np.zeros((1, 1)), 0)).gain_margin


def kronecker_coupling(form, A, P, K, R=None, weights=None):
    """The printed K-cell matrix by Kronecker products and a dense pseudo-inverse (K <= 20)."""
    m = len(A)
    if K > 20:
        raise ValueError("the Kronecker assembly is for K <= 20")
    w = np.ones((K, K)) - np.eye(K) if weights is None else weights
    R = np.eye(m) if R is None else R
    left = np.kron(np.eye(K), A) + np.kron(w, R @ P @ A)
    if form == "Feedback":
        return left
    N = np.eye(K * m) + np.kron(w, P)
    return left @ np.linalg.pinv(N)


def dense_coupled_poles(model, K):
    """Poles of [36] in doubles: a dense pseudo-inverse with its relative cut-off, and eig."""
    V_phi = model.V[model.blocks["field"]]
    return np.linalg.eigvals(kronecker_coupling("Superposition", model.A, V_phi.T @ V_phi, K))


def polarity_by_angle(p, d, kappa, dt):
    """The exact step by way of the angle from an arccosine: lost within 1e-8 of 0 and pi."""
    a, b = p / np.linalg.norm(p), d / np.linalg.norm(d)
    theta = np.arccos(np.clip(a @ b, -1, 1))
    across = a - (a @ b) * b
    size = np.linalg.norm(across)
    across = across / size if size > 0 else across
    new = 2 * np.arctan(np.tan(theta / 2) * np.exp(-kappa * dt))
    return np.cos(new) * b + np.sin(new) * across


def normalised_direction(d):
    """d/|d| without a look at its length."""
    with np.errstate(all="ignore"):
        return d / np.linalg.norm(d)


def heading_by_quotient(p):
    """cos and sin of the heading as p_xy / |p_xy|: 0/0 along the normal."""
    with np.errstate(all="ignore"):
        return p[:2] / np.hypot(p[0], p[1])


def unwrapped_table(table, p):
    """Columns of M_pol by interpolation over 0..359 degrees: beyond 359 it holds the last one."""
    degree = np.degrees(np.arctan2(p[1], p[0]))
    return np.array([np.interp(degree, np.arange(360), row, left=-row[0]) for row in table])


def trigonometric_fit(values, order=2):
    """A jump by a few harmonics: it overshoots."""
    a = np.radians(np.arange(len(values)))
    columns = [np.ones_like(a)]
    for k in range(1, order + 1):
        columns += [np.cos(k * a), np.sin(k * a)]
    X = np.column_stack(columns)
    return X @ np.linalg.lstsq(X, values, rcond=None)[0]


def unbalanced_poles(A):
    """Eigenvalues by plain QR of a matrix whose states have units far apart."""
    return sla.schur(np.asarray(A), output="complex")[0].diagonal()


def polynomial_response(A, B, C, D, omega):
    """G(j w) by way of numerator and denominator polynomials."""
    num, den = ss2tf(A, B, C, D)
    return complex(np.polyval(num[0], 1j * omega) / np.polyval(den, 1j * omega))


def distinct_poles(A, digits=8):
    """How many poles differ after rounding: copies of a defective pole come out as many."""
    return len(np.unique(np.round(np.linalg.eigvals(A), digits)))


def covariance_basis(X, order):
    """Leading directions as eigenvectors of the covariance: the condition number is squared."""
    centred = X - X.mean(axis=0)
    return np.linalg.eigh(centred.T @ centred)[1][:, ::-1][:, :order]


def normal_equation_poles(runs, dt):
    """Poles of x+ = x K from the normal equations, K = inv(X^T X) X^T Y, units as they come."""
    X, Y = (np.concatenate([r[a : len(r) - 1 + a] for r in runs]) for a in (0, 1))
    K = np.linalg.pinv(X.T @ X) @ (X.T @ Y)
    with np.errstate(all="ignore"):
        return np.log(np.linalg.eigvals(K).astype(complex)) / dt


def fitted_without_a_look(x):
    """A step matrix from however few samples."""
    return np.linalg.lstsq(x[:-1], x[1:], rcond=None)[0].T


def rolled(A, z, dt, n):
    """n steps of z+ = z + dt A z without a look at z: inf, then NaN."""
    step = np.eye(len(A)) + dt * A
    with np.errstate(all="ignore"):
        for _ in range(n):
            z = step @ z
    return z


def inverse_distance_weights(positions):
    """Interaction as one over the distance: infinite for two cells at one place."""
    d = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    with np.errstate(all="ignore"):
        return np.where(np.eye(len(d), dtype=bool), 0.0, 1.0 / d)


def scale_by_squares(X):
    """Scale of every column as the root of its mean square."""
    return np.sqrt((X * X).mean(axis=0))


def state_space_of_anything(A):
    """python-control's system of a matrix: NaN is let in."""
    n = len(A)
    return control.ss(A, np.ones((n, 1)), np.ones((1, n)), 0, 0)


def pairs_compared(cells):
    """How many pairs an overlap check compares that looks at all of them."""
    return cells * (cells - 1) // 2
