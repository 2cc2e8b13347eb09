"""A sweep meets an object where independent geometry says so."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight.errors import InvalidInput
from handsight.search import Sweep, Touch, cast
from testbed.refusals import refused
from testbed.scenes import SWEEP_RADIUS, box, can, level_sweep, search_area


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_a_cast_ball_stops_at_its_radius_from_the_box(seed):
    """Against trimesh's closest points."""
    rng = np.random.default_rng(seed)
    model, T = box(), search_area().poses(box(), search_area().draw(1, rng))
    angle = rng.uniform(0, 2 * np.pi)
    way = np.array([np.cos(angle), np.sin(angle)])
    sweep = level_sweep(T[0, :2, 3] - 0.3 * way + 0.04 * rng.normal(size=2), way, 0.6)
    ((distance,),), ((normal,),), _ = cast(model, T, [sweep], SWEEP_RADIUS)
    mesh = trimesh.creation.box([0.06, 0.09, 0.14], transform=T[0])
    along = sweep.start_world + np.linspace(0, sweep.length, 601)[:, None] * sweep.direction_world
    gaps = trimesh.proximity.closest_point(mesh, along)[1]
    if np.isfinite(distance):
        (nearest,), (gap,), _ = trimesh.proximity.closest_point(mesh, sweep.at(distance)[None])
        assert gap == pytest.approx(SWEEP_RADIUS, abs=3e-4)
        assert normal / np.linalg.norm(normal) == pytest.approx(
            (sweep.at(distance) - nearest) / gap, abs=0.05
        )
        assert (
            gaps[along @ sweep.direction_world < sweep.at(distance) @ sweep.direction_world].min()
            > SWEEP_RADIUS - 1e-9
        )
    else:
        assert gaps.min() > SWEEP_RADIUS - 1e-4


def test_each_sweep_meets_each_pose_by_itself():
    rng = np.random.default_rng(0)
    Ts = search_area().poses(can(), search_area().draw(5, rng))
    sweeps = [level_sweep((-0.3, y), (1.0, 0.0), 0.6) for y in (-0.1, 0.0, 0.1)]
    distances, normals, _ = cast(can(), Ts, sweeps, SWEEP_RADIUS)
    for i, sweep in enumerate(sweeps):
        for j, T in enumerate(Ts):
            alone = cast(can(), T[None], [sweep], SWEEP_RADIUS)
            assert alone[0][0, 0] == distances[i, j]
            assert (alone[1][0, 0] == normals[i, j]).all()


@pytest.mark.parametrize(
    ("made", "field"),
    [
        (lambda: Sweep(np.zeros(2), np.ones(3), 1.0), "sweep.start_world"),
        (lambda: Sweep(np.zeros(3), np.zeros(3), 1.0), "sweep.direction_world"),
        (lambda: Sweep(np.zeros(3), np.ones(3), 0.0), "sweep.length"),
        (lambda: Touch(np.ones((2, 2)), 0.01, 0.001, None), "touch.free_world"),
        (lambda: Touch(np.ones((2, 3)), -1, 0.001, None), "touch.radius"),
        (lambda: Touch(np.ones((2, 3)), 0.01, 0.001, 7), "touch.contact_world"),
    ],
)
def test_an_invalid_field_of_a_sweep_or_touch_is_named(made, field):
    with refused(InvalidInput, field):
        made()
