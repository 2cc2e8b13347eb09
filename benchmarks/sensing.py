"""Contact sensing: the closed form in batch and finger by finger, against the iterative solver of eq. 7.

The iterative solver is what eq. 7 asks for as it stands: damped Newton on four equations in the point and the local
torque's factor, started where the wrench's axis meets the surface, or comes nearest; compiled with numba, one core.
"""

from typing import Any

import numba
import numpy as np

import handsight as hs
from benchmarks import timing

AXES = np.array([0.009, 0.008, 0.012])
TIP = hs.Ellipsoid(AXES)
MOST_STEPS = 50
Row = dict[str, Any]


def drawn(n: int, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Returns forces [N], torques [N m] and true points [m] of n pushes with friction and local torque."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(n, 3))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    points = AXES * q
    outward = q / AXES
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    slide = np.cross(outward, rng.normal(size=(n, 3)))
    slide *= rng.uniform(0, 0.5, (n, 1)) / np.linalg.norm(slide, axis=1, keepdims=True)
    forces = rng.uniform(0.5, 5, (n, 1)) * (slide - outward)
    torques = np.cross(points, forces) + rng.normal(size=(n, 1)) * 1e-3 * outward
    return forces, torques, points


@numba.njit(error_model="numpy", cache=True)
def iterative(forces, torques, axes, most, points):
    """Writes the point of each wrench, (n, 3), by damped Newton; returns the number of steps of all of them."""
    total = 0
    W, x, H, r = 1.0 / axes, np.empty(4), np.empty((4, 4)), np.empty(4)
    N, step = np.empty((4, 4)), np.empty(4)
    for i in range(len(forces)):
        F, M = forces[i], torques[i]
        size = np.sqrt((F**2).sum())
        first(F, M, W, x)
        damping, cost = 1e-6, system(x, F / size, M / size, W, r, H)
        for _ in range(most):
            total += 1
            damped_step(H, r, damping, N, step)
            trial = x + step
            trial_cost = system(trial, F / size, M / size, W, r, H)
            if trial_cost < cost:
                done = cost - trial_cost < 1e-24 or (step**2).sum() < 1e-22
                x[:], cost, damping = trial, trial_cost, damping * 0.1
                if done:
                    break
            else:
                damping = damping * 10 + 1e-12
                system(x, F / size, M / size, W, r, H)
        points[i] = x[:3] / W
    return total


@numba.njit(error_model="numpy", cache=True)
def damped_step(H, r, damping, N, step):
    """Writes -(HᵀH + damping)⁻¹ Hᵀr, by Cholesky in N."""
    for a in range(4):
        step[a] = -(H[0, a] * r[0] + H[1, a] * r[1] + H[2, a] * r[2] + H[3, a] * r[3])
        for b in range(a + 1):
            s = H[0, a] * H[0, b] + H[1, a] * H[1, b] + H[2, a] * H[2, b] + H[3, a] * H[3, b]
            if a == b:
                s += damping
            for k in range(b):
                s -= N[a, k] * N[b, k]
            N[a, b] = s / N[b, b] if b < a else np.sqrt(max(s, 1e-300))
        for k in range(a):
            step[a] -= N[a, k] * step[k]
        step[a] /= N[a, a]
    for a in range(3, -1, -1):
        for k in range(a + 1, 4):
            step[a] -= N[k, a] * step[k]
        step[a] /= N[a, a]


@numba.njit(error_model="numpy", cache=True)
def first(F, M, W, x):
    """Starts x where the wrench's axis enters the surface, or comes nearest to its middle; no local torque."""
    f, m = F * W, M * (W[0] * W[1] * W[2] / W)
    ff = (f**2).sum()
    foot = np.cross(f, m) / ff
    slack = max(1 - (foot**2).sum(), 0.0)
    x[:3] = foot - np.sqrt(slack / ff) * f
    x[3] = 0.0


@numba.njit(error_model="numpy", cache=True)
def system(x, F, M, W, r, H):
    """Residuals r (4,) of eq. 7 for the scaled point x[:3] and factor x[3], their derivative H; half their square.

    In the scaled point q = W p: p × F + k W² p = M, |q| = 1, lengths in semi-axes.
    """
    px, py, pz = x[0] / W[0], x[1] / W[1], x[2] / W[2]
    scale = W[0]
    r[0] = scale * (py * F[2] - pz * F[1] - M[0]) + x[3] * W[0] * x[0] / scale
    r[1] = scale * (pz * F[0] - px * F[2] - M[1]) + x[3] * W[1] * x[1] / scale
    r[2] = scale * (px * F[1] - py * F[0] - M[2]) + x[3] * W[2] * x[2] / scale
    r[3] = x[0] * x[0] + x[1] * x[1] + x[2] * x[2] - 1
    H[:] = 0.0
    H[0, 1], H[0, 2] = scale * F[2] / W[1], -scale * F[1] / W[2]
    H[1, 0], H[1, 2] = -scale * F[2] / W[0], scale * F[0] / W[2]
    H[2, 0], H[2, 1] = scale * F[1] / W[0], -scale * F[0] / W[1]
    for a in range(3):
        H[a, a] = x[3] * W[a] / scale
        H[a, 3] = W[a] * x[a] / scale
        H[3, a] = 2 * x[a]
    return 0.5 * (r**2).sum()


def run(count: int, seconds: float) -> tuple[list[Row], dict[str, Any]]:
    """Returns rows with contacts per second and error, and the ratio closed form / iterative of time per contact."""
    forces, torques, truth = drawn(count)
    few = max(count // 100, 1000)
    points = np.empty((few, 3))
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        calls = [
            ("closed form, batch", lambda: hs.contacts_from_wrenches(forces, torques, TIP)),
            ("iterative, compiled", lambda: iterative(forces[:few], torques[:few], AXES, MOST_STEPS, points)),
        ]
        times = timing.in_turn(calls, 0.6 * seconds, least=5, most=40)
    finally:
        numba.set_num_threads(threads)
    mine, theirs = times["closed form, batch"] / count, times["iterative, compiled"] / few
    answer = hs.contacts_from_wrenches(forces, torques, TIP)
    error = np.linalg.norm(answer.points - truth[answer.rows], axis=1)
    rows = [
        row("closed form, batch, covariances too", mine, len(error) / count, error),
        row("iterative, compiled", theirs, 1.0, np.linalg.norm(points - truth[:few], axis=1)),
        *fingers(forces, torques, 0.4 * seconds),
    ]
    return rows, {"sensing / iterative": timing.ratio(mine, theirs)}


def fingers(forces: np.ndarray, torques: np.ndarray, seconds: float) -> list[Row]:
    """Returns rows of five fingers by public functions: one call for all, and a call each."""
    calls = [
        ("five fingers, one call", lambda: hs.contacts_from_wrenches(forces[:5], torques[:5], TIP)),
        (
            "five fingers, a call each",
            lambda: [hs.contact_from_wrench(f, m, TIP) for f, m in zip(forces[:5], torques[:5], strict=True)],
        ),
    ]
    cold = timing.in_turn(calls, seconds / 2, most=2000)
    warm = {name: timing.hot(call, seconds / 4) for name, call in calls}
    return [
        {"name": name, **timing.summary(cold[name]), "hot_median_s": float(np.median(warm[name]))}
        for name, _ in calls
    ]


def row(name: str, per_contact: np.ndarray, answered: float, error: np.ndarray) -> Row:
    """Returns time per contact, rate, share found within 1 µm, and the 99 % error [m]."""
    found = answered * float(np.mean(error < 1e-6))
    rate = 1 / float(np.median(per_contact))
    summary = timing.summary(per_contact)
    return {
        "name": name,
        "per_second": rate,
        "success": found,
        "error_99_m": float(np.quantile(error, 0.99)),
    } | summary
