"""A naive oracle of physics.md 2, 4 and 5: loops, rotation matrices. Shares nothing with mrs."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import sqrtm

# --- triads: the rows of a matrix are D1, D2, D3; mrs stores quaternions (x, y, z, w) -


def triad(quaternion):
    """Return the matrix whose rows are the turned axes."""
    x, y, z, w = quaternion / np.sqrt(quaternion @ quaternion)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return turn.T


def triads(quaternions):
    return np.array([triad(q) for q in quaternions])


def half_triad(left, right):
    """Return the triad halfway: the root of the rotation between neighbours, times the left one."""
    return left @ np.real(sqrtm(right.T @ left)).T


# --- rods (physics.md 4) --------------------------------------------------------------


def segments(nodes, closed):
    """Return the pairs of neighbours of one rod."""
    pairs = [(k, k + 1) for k in range(nodes - 1)]
    return [*pairs, (nodes - 1, 0)] if closed else pairs


def spacings(X, D, closed):
    """Return the lengths of segments along D3 halfway."""
    return np.array(
        [half_triad(D[k], D[m])[2] @ (X[m] - X[k]) for k, m in segments(len(X), closed)]
    )


def internal(X, D, k, m, ds, a, b, omega):
    """Return force F and moment N of the segment from node k to node m, in space."""
    H = half_triad(D[k], D[m])
    slope = (X[m] - X[k]) / ds
    F = sum(b[i] * (H[i] @ slope - (i == 2)) * H[i] for i in range(3))
    change = (D[m] - D[k]) / ds
    strain = np.array([change[1] @ H[2], change[2] @ H[0], change[0] @ H[1]])
    N = sum(a[i] * (strain[i] - omega[i]) * H[i] for i in range(3))
    return F, N


def rod_loads(X, D, ds, a, b, omega, closed=False):
    """Return forces and torques of the nodes of one rod on the fluid.

    `ds` and `omega` have a row a segment; `a` and `b` are the three moduli.
    """
    f, n = np.zeros((len(X), 3)), np.zeros((len(X), 3))
    for j, (k, m) in enumerate(segments(len(X), closed)):
        F, N = internal(X, D, k, m, ds[j], a, b, omega[j])
        couple = 0.5 * np.cross(X[m] - X[k], F)
        f[k] += F
        f[m] -= F
        n[k] += N + couple
        n[m] += -N + couple
    return f, n


def rod_energy(X, D, ds, a, b, omega, closed=False):
    """Return the elastic energy of one rod: 1/2 (F_i^2 / b_i + N_i^2 / a_i) ds."""
    total = 0.0
    for j, (k, m) in enumerate(segments(len(X), closed)):
        F, N = internal(X, D, k, m, ds[j], a, b, omega[j])
        H = half_triad(D[k], D[m])
        density = sum((H[i] @ F) ** 2 / b[i] + (H[i] @ N) ** 2 / a[i] for i in range(3))
        total += 0.5 * ds[j] * density
    return total


# --- fluid (physics.md 2) -------------------------------------------------------------


def flow(sources, epsilons, forces, torques, targets, mu=1.0):
    """Return velocities and angular velocities at the targets, source after source."""
    u, w = np.zeros((len(targets), 3)), np.zeros((len(targets), 3))
    for y, e, f, n in zip(sources, epsilons, forces, torques, strict=True):
        r = targets - y
        r2 = (r * r).sum(axis=1, keepdims=True)
        R = np.sqrt(r2 + e**2)
        H1, H2 = (2 * e**2 + r2) / (8 * np.pi * R**3), 1 / (8 * np.pi * R**3)
        Q = (5 * e**2 + 2 * r2) / (8 * np.pi * R**5)
        D1 = (10 * e**4 - 7 * e**2 * r2 - 2 * r2**2) / (8 * np.pi * R**7)
        D2 = (21 * e**2 + 6 * r2) / (8 * np.pi * R**7)
        u += (f * H1 + (r @ f)[:, None] * r * H2 + 0.5 * Q * np.cross(n, r)) / mu
        w += (0.5 * Q * np.cross(f, r) + 0.25 * D1 * n + 0.25 * D2 * (r @ n)[:, None] * r) / mu
    return u, w


# --- swimmers (physics.md 5) ----------------------------------------------------------


def swimmer_points(x, p, length, sigma):
    """Return bodies, then flagella."""
    return np.concatenate([x, x - sigma * length[:, None] * p])


def swimmer_rates(x, p, length, force, sigma, epsilons, mu=1.0, extra=None):
    """Return dx_B/dt and dp/dt; `epsilons` are those of bodies, then flagella.

    `extra` is a function of the points: a velocity that is added to theirs.
    """
    points = swimmer_points(x, p, length, sigma)
    thrust = force[:, None] * p
    forces = np.concatenate([thrust, -thrust])
    u, _ = flow(points, epsilons, forces, np.zeros_like(forces), points, mu)
    if extra is not None:
        u = u + extra(points)
    dp = np.zeros_like(p)
    for i in range(len(x)):
        d = sigma * p[i]
        dd = (np.eye(3) - np.outer(d, d)) @ (u[i] - u[len(x) + i]) / length[i]
        dp[i] = sigma * dd
    return u[: len(x)], dp


def swim(x, p, t_end, *parameters, **options):
    """Return positions and orientations at t_end (DOP853, relative error per step 1e-12)."""
    count = len(x)

    def rates(t, y):
        x, p = y.reshape(2, count, 3)
        return np.concatenate(swimmer_rates(x, p, *parameters, **options)).ravel()

    start = np.concatenate([x, p]).ravel()
    end = solve_ivp(rates, (0.0, t_end), start, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    return end.reshape(2, count, 3)


# --- triads in time -------------------------------------------------------------------


def integrate(rates, X, D, t_end):
    """Return X and D at t_end for rates(t, X, D) -> (u, w), dX/dt = u, dD_i/dt = w x D_i."""
    nodes, turning = len(X), len(D)

    def derivative(t, y):
        X, D = y[: 3 * nodes].reshape(-1, 3), y[3 * nodes :].reshape(-1, 3, 3)
        u, w = rates(t, X, D)
        return np.concatenate([u.ravel(), np.cross(w[:, None, :], D).ravel()])

    start = np.concatenate([X.ravel(), D.ravel()])
    y = solve_ivp(derivative, (0.0, t_end), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return y[: 3 * nodes].reshape(-1, 3), y[3 * nodes :].reshape(turning, 3, 3)


# --- figures --------------------------------------------------------------------------


def orders(errors):
    """Return the observed orders of errors at steps that are halved each time."""
    errors = np.asarray(errors)
    return np.log2(errors[:-1] / errors[1:])


def fitted_helix(X):
    """Return radius and pitch of a helix through equally spaced points, by the best rigid motion.

    A helix is carried into itself by a screw; the one that takes each point to the next best is
    found by least squares (Kabsch), which needs no guess of the axis.
    """
    before, after = X[:-1], X[1:]
    U, _, Vt = np.linalg.svd((before - before.mean(0)).T @ (after - after.mean(0)))
    turn = Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    odd = turn - turn.T
    twice_sine = np.array([odd[2, 1], odd[0, 2], odd[1, 0]])
    angle = np.arctan2(np.linalg.norm(twice_sine), np.trace(turn) - 1.0)
    axis = twice_sine / np.linalg.norm(twice_sine)
    shift = after.mean(0) - turn @ before.mean(0)
    advance = shift @ axis
    # A point c of the axis is moved along it only: (I - turn) c = shift - advance axis.
    c = np.linalg.lstsq(np.eye(3) - turn, shift - advance * axis, rcond=None)[0]
    off = (X - c) - np.outer((X - c) @ axis, axis)
    return np.linalg.norm(off, axis=1).mean(), abs(2.0 * np.pi * advance / angle)
