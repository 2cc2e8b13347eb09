"""Fingertips that touch each other: the gap between two, and what one that is pressed by another takes a load for."""

import math
from typing import Any

import numpy as np

from handsight._kernels.math.vec3 import (
    Mat33,
    Vec3,
    add,
    cross,
    dot,
    matrix,
    mul,
    norm,
    scale,
    store,
    sub,
    times,
    tmul,
    vector,
)
from handsight._kernels.runtime.compilation import inner
from handsight._kernels.touch.sensing_steps import CONTACT, Fingertip, Vec6, wrench_to_contact

NEAR_TIP = 0.003
"""A tip closer than this to another may touch it as well, by one chance in twenty or more [m].

One degree of each joint is 1.3 mm per axis at each of two tips.
"""
GAP_SCALE = 1.645 / (math.sqrt(2.0) * NEAR_TIP)
"""To what `erfc` takes [1/m]: a gap of NEAR_TIP is 1.645 standard deviations of it."""
TWO_AT_ONCE = 0.002**2, math.radians(12.0) ** 2
"""Variances per axis of point [m²] and normal [rad²] of what one contact is taken for that is two, beside the press."""
PRESS = 0.4
"""Mean load of one tip on another, in parts of the smaller of the loads on both; it may be anything from none to twice
that. Simulated tips that touch press each other with less than what presses them to the object."""
HALVINGS = 4
"""Of a press that nothing else on the tip would explain."""
STEPS = 12
"""Halved steps to the direction that separates two tips best; the gap is too small by 0.1-1 mm after them."""


@inner
def _support(R: Mat33, axes: Vec3, u: Vec3) -> Vec3:
    """The point of an ellipsoid, from its centre, that is farthest along u."""
    local = times(axes, tmul(R, u))
    return mul(R, scale(times(axes, local), 1.0 / norm(local)))


@inner
def _gap(T: Any, axes: Vec3, T_other: Any, axes_other: Vec3) -> tuple[float, Vec3]:
    """The distance of two ellipsoids, and the direction from the first to the other; where they overlap, a number below
    zero that says no more.

    The distance of convex bodies is the widest slab that separates them; each step turns the slab halfway towards the
    line between the points that touch it.
    """
    R, R_other = matrix(T), matrix(T_other)
    between = sub(vector(T_other[:3, 3]), vector(T[:3, 3]))
    u, widest = scale(between, 1.0 / max(norm(between), 1e-12)), -np.inf
    across = u
    for _ in range(STEPS):
        v = sub(add(between, _support(R_other, axes_other, scale(u, -1.0))), _support(R, axes, u))
        if dot(u, v) > widest:
            widest, across = dot(u, v), u
        length = norm(v)
        if widest <= 0.0 or length < 1e-12:
            break
        u = add(u, scale(v, 1.0 / length))
        u = scale(u, 1.0 / max(norm(u), 1e-12))
    return widest, across


@inner
def set_gaps(fingers: Any, Ts_palm_surface: Any, nearest: Any, contacts: Any) -> None:
    """Each tip's distance to the nearest other one; `nearest` (n, 4): which that is, and the direction to it."""
    for i in range(len(contacts)):
        contacts[i].gap = np.inf
        for j in range(i):
            axes, axes_other = vector(fingers[i].tip.semi_axes), vector(fingers[j].tip.semi_axes)
            gap, u = _gap(Ts_palm_surface[i], axes, Ts_palm_surface[j], axes_other)
            if gap < contacts[i].gap:
                contacts[i].gap, nearest[i, 0] = gap, j
                store(u, nearest[i, 1:])
            if gap < contacts[j].gap:
                contacts[j].gap, nearest[j, 0] = gap, i
                store(scale(u, -1.0), nearest[j, 1:])


@inner
def chance_of_touch(gap: float) -> float:
    """That two tips so far apart by their joints [m] touch."""
    return 0.5 * math.erfc(GAP_SCALE * gap)


@inner
def add_press(
    load: Vec6, tip: Fingertip, T_palm_surface: Any, toward: Vec3, lighter: float, contacts: Any
) -> None:
    """Moves a contact in its tip's frame by what the nearest other tip may press on its tip, and widens its covariance.

    The other tip lies `toward` (palm) and presses against that, where the tips are nearest, with a force from none to
    twice `PRESS` times `lighter` [N]: so the object's own load is that much more along `toward`, and its contact
    somewhere between c and c + 2 δ. With a chance P of a touch its mean is c + P δ, its variance (4/3 P - P²) δ δᵀ.
    """
    if not contacts.gap < NEAR_TIP:
        return
    chance = chance_of_touch(contacts.gap)
    R = matrix(T_palm_surface)
    along = tmul(R, toward)
    reach = times(tip.semi_axes, along)
    at = tmul(tip.R, sub(scale(times(tip.semi_axes, reach), 1.0 / norm(reach)), tip.origin))
    press = scale(tmul(tip.R, along), PRESS * lighter)
    share = 1.0
    for _ in range(HALVINGS):
        more = scale(press, share)
        answer = wrench_to_contact(add(load[0], more), add(load[1], cross(at, more)), tip)
        if answer[0] == CONTACT:
            change = np.empty(6)
            store(scale(sub(answer[1], vector(contacts.point)), 1.0 / share), change[:3])
            store(scale(sub(answer[2], vector(contacts.normal)), 1.0 / share), change[3:])
            _move(change, chance, contacts)
            return
        share *= 0.5


@inner
def _move(change: Any, chance: float, contacts: Any) -> None:
    variance = chance * (4.0 / 3.0 - chance)
    for i in range(6):
        for j in range(6):
            contacts.covariance[i, j] += variance * change[i] * change[j]
    store(add(vector(contacts.point), scale(vector(change[:3]), chance)), contacts.point)
    normal = add(vector(contacts.normal), scale(vector(change[3:]), chance))
    store(scale(normal, 1.0 / norm(normal)), contacts.normal)
