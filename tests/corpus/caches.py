"""Damaged files of objects in the cache, and scenarios to simulate."""

import functools
import os
import random
import tempfile
from pathlib import Path
from typing import Any
from unittest import mock

import msgspec
import numpy as np

import handsight as hs
from handsight import cache_folder
from handsight.errors import InvalidFile
from handsight.objects import Geometry, Symmetries, Triangles, cache
from handsight.objects import model as object_models
from handsight.simulation import Nuisances, Scenario
from handsight.simulation.scenario import SCENARIO
from tests.corpus.door import Case, Door, check_pose, spoilt_bytes, spoilt_value

NAME = "0" * 64


@functools.cache
def small() -> tuple[Geometry, bytes]:
    """Returns a block of 30 x 45 x 25 mm and the content of its file in the cache."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [
        0.015,
        0.0225,
        0.0125,
    ]
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)]
    faces += [(0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    geometry = object_models._of_mesh(Triangles(corners, np.array(faces)))
    return geometry, cache.geometry_bytes(geometry)


def remembered(data: bytes) -> Geometry:
    """Returns the geometry in a cache file with this content; raises InvalidFile where it would be built again."""

    def built_again() -> Geometry:
        raise InvalidFile("the object's file is not valid: it would be built again")

    with tempfile.TemporaryDirectory() as folder, mock.patch.dict(os.environ, HANDSIGHT_CACHE=folder):
        Path(folder, f"field-{NAME}.msgpack").write_bytes(data)
        return cache.remembered(NAME, built_again)


def sealed(content: bytes, name: str = NAME) -> bytes:
    """Returns a cache file with this content and its checksum."""
    return cache_folder.checksum(name, content) + content


def damaged(rng: random.Random) -> None:
    """Reads a damaged file, and asserts that whatever is read is what was written, to the last bit."""
    geometry, content = small()
    data = sealed(content, rng.choice([NAME] * 9 + ["1" * 64]))
    found = remembered(spoilt_bytes(data, rng) if rng.random() < 0.8 else data)
    assert cache.geometry_bytes(found) == content
    assert isinstance(found, type(geometry))


def use(geometry: Geometry) -> None:
    """Corrects the pose of an object with this geometry, and draws samples of it."""
    model = hs.ObjectModel._from(geometry, "", Symmetries())
    contacts = hs.Contacts([[0.015, 0, 0], [-0.015, 0.004, 0.002], [0, 0.0225, 0]], None, sigma_point=1e-3)
    estimate = hs.correct_pose(model, contacts, vision=hs.PosePrior.from_sigmas(np.eye(4), 0.02, 0.2))
    check_pose(estimate.T_palm_object)


SIMULATED: dict[str, object] = {"object": "can", "seed": 3, "motion": "grasp", "rate": 100.0, "images": False}


def scenario(rng: random.Random) -> None:
    """Builds a scenario with one or two corrupted values, and simulates it if it is accepted."""
    off: Any = {name: getattr(Nuisances(), name) for name in Nuisances.__slots__}
    given: Any = {**SIMULATED, "nuisances": off}
    for _ in range(rng.choice([1, 1, 2])):
        key = rng.choice([*SIMULATED, *["nuisances"] * 5])
        if key == "nuisances":
            name = rng.choice(sorted(off))
            off[name] = spoilt_value(off[name], rng)
        else:
            given[key] = spoilt_value(given[key], rng)
    taken = Scenario(**{**given, "nuisances": Nuisances(**off)})
    assert 1 <= SCENARIO.steps_per_second / taken.rate < 1e6
    assert all(0 <= getattr(taken.nuisances, name) <= 100 for name in off)


DOORS = [
    Door("a scenario", scenario, 100),
    Door("an object's file, damaged", damaged, 200),
]
CASES = [
    Case("an object's file as it was", lambda: use(remembered(sealed(small()[1]))), None),
    Case("an object's file cut", lambda: use(remembered(sealed(small()[1])[:-1])), "built again"),
    Case("another object's file", lambda: use(remembered(sealed(small()[1], "1" * 64))), "built again"),
    Case("an empty file of an object", lambda: use(remembered(b"")), "built again"),
    Case(
        "a file without an object", lambda: use(remembered(sealed(msgspec.msgpack.encode(3)))), "built again"
    ),
]
