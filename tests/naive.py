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


def uncentred_pcr(data, basis, intercept):
    """eq. 24 in an uncentred basis, A alone: right without an intercept, wrong with one."""
    import numpy as np

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
    import numpy as np

    return float(np.polyfit(eta[1:], np.diff(eta) / dt, 1)[0])


def pole_error_of_one_long_run(runs, dt, exact):
    """Poles from runs glued into one: differences across the seams."""
    import numpy as np

    x = np.concatenate(runs)
    step = np.linalg.lstsq(x[:-1], x[1:], rcond=None)[0].T
    poles = np.log(np.linalg.eigvals(step).astype(complex)) / dt
    return float(np.abs(np.sort_complex(poles) - exact).max())


def columns_reached_by_arctan():
    """Columns of M_pol that arctan(y/x) + 90 degrees finds over the full turn: half of them."""
    import numpy as np

    theta = np.radians(np.arange(360) + 0.25)
    return len(set(np.floor(np.degrees(np.arctan(np.sin(theta) / np.cos(theta))) + 90.0)))


def half_turn_table(table):
    """M_pol as an unsigned angle sees it: headings of the lower half read the upper half."""
    import numpy as np

    return np.column_stack([table[:, :180], table[:, :180]])


def positive_sign_margin(point):
    """Gain margin of +(kappa/s)(G - |d|): the sign of the text, for negative feedback wrong."""
    import control
    import numpy as np

    from cellsys.response import margins

    m = len(point.A_plant)
    A = np.zeros((m + 1, m + 1))
    A[:m, :m], A[:m, m] = point.A_plant, point.B_heading
    B = np.zeros((m + 1, 1))
    B[m, 0] = point.kappa
    C = np.concatenate([point.S_heading, [-point.strength]])[None]
    return margins(control.ss(A, B, C, np.zeros((1, 1)), 0)).gain_margin


def kronecker_coupling(form, A, P, K, R=None, weights=None):
    """The printed K-cell matrix by Kronecker products and a dense pseudo-inverse (K <= 20)."""
    import numpy as np

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
    import numpy as np

    V_phi = model.V[model.blocks["field"]]
    return np.linalg.eigvals(kronecker_coupling("Superposition", model.A, V_phi.T @ V_phi, K))


def last_local_error(problem, rtol, atol):
    """(x, what the last step of Radau adds to the error): earlier steps are left out."""
    import numpy as np
    from scipy.integrate import Radau, solve_ivp

    rhs = problem.rhs
    solver = Radau(rhs, 0.0, problem.x0, problem.end, rtol=rtol, atol=atol)
    while solver.status == "running":
        before = solver.y.copy()
        solver.step()
    again = solve_ivp(
        rhs, (solver.t_old, solver.t), before, "Radau", rtol=1e-12, atol=1e-3 * atol * rtol
    )
    return solver.y, np.abs(solver.y - again.y[:, -1])


def bytes_promised_without_a_word(nodes):
    """A request for three coordinates of so many nodes: numpy gives it, unbacked by memory."""
    import numpy as np

    return np.empty((nodes, 3)).nbytes


def array_by_offset(data, name):
    """An array of an archive read from where its bytes should be, checking nothing."""
    import numpy as np

    place = data.find(f"{name}.npy".encode())
    start = data.find(b"\n", place) + 1
    return np.frombuffer(data[start : start + 200][: len(data[start : start + 200]) // 8 * 8])


def unpacked_size(path):
    """Bytes that reading every entry of an archive takes, found by reading them."""
    import zipfile

    with zipfile.ZipFile(path) as archive:
        return sum(len(archive.read(name)) for name in archive.namelist())


def load_everything(path):
    """An npz read with pickles allowed."""
    import numpy as np

    with np.load(path, allow_pickle=True) as archive:
        return {name: archive[name] for name in archive.files}


def locked_by_a_file(path):
    """A lock that is the presence of a file: it outlives its owner."""
    return path.exists()


def write_in_place(path, data, stop):
    """A file overwritten where it stands, its writer stopped after `stop` bytes."""
    with open(path, "wb") as file:
        file.write(data[:stop])


def mapped_rows(folder, shapes):
    """Arrays of a run as sparse mapped files, filled without asking for room: SIGBUS."""
    import numpy as np

    for name, shape in shapes.items():
        array = np.lib.format.open_memmap(f"{folder}/{name}.npy", "w+", float, shape)
        array[:] = 1.0


def float_of_locale(text):
    """A number read with the decimal mark that a comma may be."""
    return float(text.replace(",", "."))


def polarity_by_angle(p, d, kappa, dt):
    """The exact step by way of the angle from an arccosine: lost within 1e-8 of 0 and pi."""
    import numpy as np

    a, b = p / np.linalg.norm(p), d / np.linalg.norm(d)
    theta = np.arccos(np.clip(a @ b, -1, 1))
    across = a - (a @ b) * b
    size = np.linalg.norm(across)
    across = across / size if size > 0 else across
    new = 2 * np.arctan(np.tan(theta / 2) * np.exp(-kappa * dt))
    return np.cos(new) * b + np.sin(new) * across


def normalised_direction(d):
    """d/|d| without a look at its length."""
    import numpy as np

    with np.errstate(all="ignore"):
        return d / np.linalg.norm(d)


def heading_by_quotient(p):
    """cos and sin of the heading as p_xy / |p_xy|: 0/0 along the normal."""
    import numpy as np

    with np.errstate(all="ignore"):
        return p[:2] / np.hypot(p[0], p[1])


def unwrapped_table(table, p):
    """Columns of M_pol by interpolation over 0..359 degrees: beyond 359 it holds the last one."""
    import numpy as np

    degree = np.degrees(np.arctan2(p[1], p[0]))
    return np.array([np.interp(degree, np.arange(360), row, left=-row[0]) for row in table])


def trigonometric_fit(values, order=2):
    """A jump by a few harmonics: it overshoots."""
    import numpy as np

    a = np.radians(np.arange(len(values)))
    columns = [np.ones_like(a)]
    for k in range(1, order + 1):
        columns += [np.cos(k * a), np.sin(k * a)]
    X = np.column_stack(columns)
    return X @ np.linalg.lstsq(X, values, rcond=None)[0]


def unbalanced_poles(A):
    """Eigenvalues by plain QR of a matrix whose states have units far apart."""
    import numpy as np
    import scipy.linalg as sla

    return sla.schur(np.asarray(A), output="complex")[0].diagonal()


def polynomial_response(A, B, C, D, omega):
    """G(j w) by way of numerator and denominator polynomials."""
    import numpy as np
    from scipy.signal import ss2tf

    num, den = ss2tf(A, B, C, D)
    return complex(np.polyval(num[0], 1j * omega) / np.polyval(den, 1j * omega))


def distinct_poles(A, digits=8):
    """How many poles differ after rounding: copies of a defective pole come out as many."""
    import numpy as np

    return len(np.unique(np.round(np.linalg.eigvals(A), digits)))


def covariance_basis(X, order):
    """Leading directions as eigenvectors of the covariance: the condition number is squared."""
    import numpy as np

    centred = X - X.mean(axis=0)
    return np.linalg.eigh(centred.T @ centred)[1][:, ::-1][:, :order]


def normal_equation_poles(runs, dt):
    """Poles of x+ = x K from the normal equations, K = inv(X^T X) X^T Y, units as they come."""
    import numpy as np

    X, Y = (np.concatenate([r[a : len(r) - 1 + a] for r in runs]) for a in (0, 1))
    K = np.linalg.pinv(X.T @ X) @ (X.T @ Y)
    with np.errstate(all="ignore"):
        return np.log(np.linalg.eigvals(K).astype(complex)) / dt


def fitted_without_a_look(x):
    """A step matrix from however few samples."""
    import numpy as np

    return np.linalg.lstsq(x[:-1], x[1:], rcond=None)[0].T


def rolled(A, z, dt, n):
    """n steps of z+ = z + dt A z without a look at z: inf, then NaN."""
    import numpy as np

    step = np.eye(len(A)) + dt * A
    with np.errstate(all="ignore"):
        for _ in range(n):
            z = step @ z
    return z


def inverse_distance_weights(positions):
    """Interaction as one over the distance: infinite for two cells at one place."""
    import numpy as np

    d = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    with np.errstate(all="ignore"):
        return np.where(np.eye(len(d), dtype=bool), 0.0, 1.0 / d)


def fixed_step_end(system, t_end, step):
    """Explicit Euler to the end, whatever comes out."""
    import numpy as np

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
    import numpy as np

    out = []
    for _ in range(round(t_end / step)):
        x = x - step * np.sign(x)
        out.append(x)
    return np.array(out)


def spring_force(a, b, rest, stiffness):
    """k (L - rest) along (b - a)/L: 0/0 where the ends meet."""
    import numpy as np

    d = b - a
    with np.errstate(all="ignore"):
        length = np.linalg.norm(d)
        return stiffness * (length - rest) * d / length
