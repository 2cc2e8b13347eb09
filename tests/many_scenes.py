"""Many contacts with a known pose: patches of links that are out of place, and some contacts that are wrong."""

from typing import NamedTuple

import numpy as np

import handsight as hs
from handsight import se3

Array = np.ndarray


class ManyOptions(NamedTuple):
    """`ManyOptions` say what contacts are like."""

    contacts: int = 1000
    groups: int = 5
    """Patches, each about a place of its own; 0: contacts anywhere, each with errors of its own alone."""
    sigma_point: float = 1.5e-4
    sigma_normal: float = 0.03
    shared: tuple[float, float] = (5e-4, 0.02)
    """Of a group's shift [m] and turn [rad], per axis."""
    wrong: float = 0.0
    """Share of contacts that are 10 mm off, per axis, with any normal."""
    prior: tuple[float, float] = (0.01, 0.1)


class ManyScene(NamedTuple):
    """A `ManyScene` has contacts and vision's pose, and the truth."""

    contacts: hs.Contacts
    vision: hs.PosePrior
    T_palm_object: Array
    wrong: Array
    """(n,) whether each contact is wrong."""


MANY = ManyOptions()


def many_scene(model: hs.ObjectModel, rng: np.random.Generator, options: ManyOptions = MANY) -> ManyScene:
    """Draws contacts on an object."""
    T, n = se3.random(rng, 1)[0], options.contacts
    T[:3, 3] = rng.normal(size=3) * 0.05
    surface, normals = model.sample(20_000)
    group, each = np.full(n, -1), n // max(options.groups, 1)
    if options.groups:
        group = np.minimum(np.arange(n) // each, options.groups - 1)
        chosen = np.empty(n, dtype=int)
        for g in range(options.groups):
            own = group == g
            distance = np.linalg.norm(surface - surface[rng.integers(len(surface))], axis=1)
            chosen[own] = rng.choice(np.argsort(distance)[: max(own.sum(), 400)], own.sum(), replace=False)
    else:
        chosen = rng.choice(len(surface), n, replace=n > len(surface))
    points, directions = se3.apply(T, surface[chosen]), normals[chosen] @ T[:3, :3].T
    for g in range(options.groups):
        own, error = group == g, rng.normal(size=6) * np.repeat(options.shared, 3)
        R, center = se3.rotation_exp(error[3:]), points[own].mean(axis=0)
        points[own] = (points[own] - center) @ R.T + center + error[:3]
        directions[own] = directions[own] @ R.T
    points += rng.normal(size=(n, 3)) * options.sigma_point
    directions += rng.normal(size=(n, 3)) * options.sigma_normal
    wrong = rng.random(n) < options.wrong
    points[wrong] += rng.normal(size=(wrong.sum(), 3)) * 0.01
    directions[wrong] = rng.normal(size=(wrong.sum(), 3))
    shared = {"group": group, "shared_covariance": np.diag(np.repeat(np.square(options.shared), 3))}
    contacts = hs.Contacts(
        points,
        directions,
        options.sigma_point,
        options.sigma_normal,
        **(shared if options.groups else {}),
    )
    error = rng.normal(size=6) * np.repeat(options.prior, 3)
    vision = hs.PosePrior.from_sigmas(se3.moved(T, error), *options.prior)
    return ManyScene(contacts, vision, T, wrong)
