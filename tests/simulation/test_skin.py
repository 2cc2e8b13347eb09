"""The simulated skin: springs that hold what presses on them, where the body is."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from handsight import se3
from handsight.errors import InvalidInput
from handsight.simulation import Scenario
from handsight.simulation.taxels import PALM_SKIN, Solid, spring_forces
from skin_scenes import box_solid, taxel_forces

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.floats(0.01, 10), st.floats(10, 1e4))
def test_compressed_springs_balance_the_force_and_the_others_are_free(seed, force, stiffness):
    gaps = np.random.default_rng(seed).exponential(1e-3, 40)
    gaps[:3] = np.inf
    forces = spring_forces(gaps, force, stiffness)
    assert forces.sum() == pytest.approx(force)
    depth = (forces / stiffness + gaps)[forces > 0]
    np.testing.assert_allclose(depth, depth[0])
    assert (gaps[forces == 0] >= depth[0] - 1e-12).all()


def test_without_a_force_no_spring_is_compressed():
    assert not spring_forces(np.zeros(4), 0.0, 100.0).any()


@pytest.mark.parametrize("kind", ["box", "cylinder", "hull"])
def test_a_solid_begins_where_a_ray_meets_it(kind):
    rng = np.random.default_rng(0)
    meshes = {
        "box": trimesh.creation.box([0.06, 0.09, 0.14]),
        "cylinder": trimesh.creation.cylinder(0.033, 0.12, sections=128),
        "hull": trimesh.convex.convex_hull(rng.normal(size=(40, 3))),
    }
    mesh = meshes[kind]
    solids = {"box": box_solid([0.06, 0.09, 0.14]), "cylinder": Solid.cylinder(0.033, 0.12)}
    solid = solids.get(kind) or Solid.hull(np.asarray(mesh.vertices))
    size = float(mesh.extents.max())
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    starts = -2 * size * direction + 0.5 * size * rng.normal(size=(50, 3))
    ahead = solid.distances(starts, direction)
    hits, rays, _ = mesh.ray.intersects_location(starts, np.tile(direction, (50, 1)), multiple_hits=False)
    expected = np.full(50, np.inf)
    expected[rays] = (hits - starts[rays]) @ direction
    assert 5 < np.isfinite(expected).sum() < 50
    # The mesh's polygon is inside the circle that the planes' is around.
    near = np.isfinite(expected) & np.isfinite(ahead)
    assert (np.isfinite(expected) == np.isfinite(ahead)).mean() > 0.95
    np.testing.assert_allclose(ahead[near], expected[near], atol=2e-3 * size)


def test_taxels_under_a_face_measure_its_force():
    T = PALM_SKIN.layout.T_frame_grid @ se3.compose(np.eye(3), np.array([0.018, 0.0, 0.01]))
    readings = taxel_forces(PALM_SKIN, box_solid([0.04, 0.03, 0.02]), T, 2.0)
    assert readings.sum() == pytest.approx(2.0)
    places = PALM_SKIN.places_grid[readings > 0]
    np.testing.assert_allclose(places.min(axis=0)[:2], [0.0, -0.014], atol=1e-9)
    np.testing.assert_allclose(places.max(axis=0)[:2], [0.028, 0.014], atol=1e-9)


def test_the_power_grasp_presses_the_can_on_the_skin(simulated):
    samples = simulated(Scenario(object="can", seed=1, motion="grasp", rate=50, skin=True))
    last = samples[-1]
    assert not last.dropped
    assert len(last.touches) >= 3
    reading = last.observation.skin["palm"] - samples[0].observation.skin["palm"]
    assert reading.max() > 0.1
    # Along its axis the can ends on the array, near its end in the palm.
    end = se3.apply(
        se3.inverse(PALM_SKIN.layout.T_frame_grid) @ last.T_palm_object, np.array([[0, 0, 0.061]])
    )[0]
    pressed = PALM_SKIN.places_grid[reading > 0.05]
    assert abs(pressed[:, 0].max() - end[0]) < 0.006


def test_the_box_cannot_be_pressed_on_the_palm():
    with pytest.raises(InvalidInput, match="skin: expected can or a mesh, got box"):
        Scenario(object="box", skin=True)
