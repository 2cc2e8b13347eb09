"""Fingertips that may touch each other: their distance, and what that does to a contact's mean and covariance."""

import math
from typing import Any, NamedTuple

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


class TipToTip(NamedTuple):
    """`TipToTip` are the parameters of contacts between two fingertips."""

    max_gap: float = 0.003
    """Below this distance a tip touches another with a probability above 5 % [m]. One degree of each joint is 1.3 mm
    per axis at each of two tips."""
    far: float = 0.02
    """Beyond this distance tips do not touch, with a probability below 1e-26, and it is not computed further [m]."""
    gap_scale: float = 1.645 / (math.sqrt(2.0) * max_gap)
    """Factor of a gap in the argument of `erfc` [1/m], by which `max_gap` is 1.645 of its standard deviations."""
    variance_point: float = 0.002**2
    """Added variance of a contact's point where two contacts are taken for one [m²]."""
    variance_normal: float = math.radians(12.0) ** 2  # the same of its normal [rad²]
    mean_load: float = 0.4
    """Mean load of one tip on another, as a share of the smaller of both tips' loads; it is from 0 to twice that.
    Simulated tips press each other less than the object."""
    max_trials: int = 4
    """A load of the other tip that leaves no contact to explain the rest is halved, until so many were tried."""
    iterations: int = 12
    """Steps to the direction that separates two tips best; the gap is then too small by 0.1-1 mm."""


TIP_TO_TIP = TipToTip()


@inner
def _support(R: Mat33, axes: Vec3, u: Vec3) -> Vec3:
    """Returns the point of an ellipsoid that is farthest along u, from the ellipsoid's centre."""
    local = times(axes, tmul(R, u))
    return mul(R, scale(times(axes, local), 1.0 / norm(local)))


@inner
def _gap(T: Any, axes: Vec3, T_other: Any, axes_other: Vec3) -> tuple[float, Vec3]:
    """Returns the distance of two ellipsoids, below zero where they overlap, and the direction from the first to the
    second; of those that are `far` a lower bound.

    The distance of convex bodies is the width of the widest slab between them. Each step turns the slab's normal
    halfway towards the line between the two points that touch the slab.
    """
    R, R_other = matrix(T), matrix(T_other)
    between = sub(vector(T_other[:3, 3]), vector(T[:3, 3]))
    u, widest = scale(between, 1.0 / max(norm(between), 1e-12)), -np.inf
    direction = u
    for _ in range(TIP_TO_TIP.iterations):
        v = sub(add(between, _support(R_other, axes_other, scale(u, -1.0))), _support(R, axes, u))
        if dot(u, v) > widest:
            widest, direction = dot(u, v), u
        length = norm(v)
        if not 0.0 < widest < TIP_TO_TIP.far or length < 1e-12:
            break
        u = add(u, scale(v, 1.0 / length))
        u = scale(u, 1.0 / max(norm(u), 1e-12))
    return widest, direction


@inner
def find_nearest_tips(fingers: Any, Ts_palm_surface: Any, nearest: Any, contacts: Any) -> None:
    """Writes to each contact its tip's gap to the nearest other tip, and to `nearest` (n, 4) that tip's number and the
    direction to it."""
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
def touch_probability(gap: float) -> float:
    """Returns the probability that two tips touch, given their gap by the measured joint positions [m]."""
    return 0.5 * math.erfc(TIP_TO_TIP.gap_scale * gap)


@inner
def add_load_of_other_tip(
    load: Vec6, tip: Fingertip, T_palm_surface: Any, toward: Vec3, smaller: float, contact: Any
) -> None:
    """Moves a contact, in its tip's frame, by the load that the nearest other tip may exert, and adds its covariance.

    The other tip, in the direction `toward` (palm), presses where the tips are nearest with a force from 0 to twice
    `mean_load` times `smaller` [N]. So the load of the object alone has up to that much more along `toward`, and its
    contact is between c and c + 2 δ, evenly distributed. With a probability P that the tips touch, its mean is c + P δ
    and its covariance (4/3 P - P²) δ δᵀ.
    """
    if not contact.gap < TIP_TO_TIP.max_gap:
        return
    probability = touch_probability(contact.gap)
    R = matrix(T_palm_surface)
    along = tmul(R, toward)
    reach = times(tip.semi_axes, along)
    at = tmul(tip.R, sub(scale(times(tip.semi_axes, reach), 1.0 / norm(reach)), tip.origin))
    press = scale(tmul(tip.R, along), TIP_TO_TIP.mean_load * smaller)
    share = 1.0
    for _ in range(TIP_TO_TIP.max_trials):
        more = scale(press, share)
        answer = wrench_to_contact(add(load[0], more), add(load[1], cross(at, more)), tip)
        if answer[0] == CONTACT:
            change = np.empty(6)
            store(scale(sub(answer[1], vector(contact.point)), 1.0 / share), change[:3])
            store(scale(sub(answer[2], vector(contact.normal)), 1.0 / share), change[3:])
            variance = probability * (4.0 / 3.0 - probability)
            for i in range(6):
                for j in range(6):
                    contact.covariance[i, j] += variance * change[i] * change[j]
            store(add(vector(contact.point), scale(vector(change[:3]), probability)), contact.point)
            normal = add(vector(contact.normal), scale(vector(change[3:]), probability))
            store(scale(normal, 1.0 / norm(normal)), contact.normal)
            return
        share *= 0.5
