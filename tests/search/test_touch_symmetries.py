"""What touch cannot tell from each other, and a search with it."""

import numpy as np
import pytest
import trimesh

import handsight as hs
from handsight.correction import pose_distances
from handsight.search import Belief, Touch, best_sweep, with_symmetries_of_touch
from testbed.scenes import SWEEP_RADIUS, can, level_sweep, search_area, swept_touch

SIGMA = 0.0025


def scanned(mesh, rough=0.0007):
    """A model of a mesh whose vertices are some tenths of a millimetre off, as a scan's are."""
    vertices = mesh.vertices + rough * np.random.default_rng(0).normal(size=mesh.vertices.shape)
    return hs.ObjectModel.from_mesh(vertices, mesh.faces)


def tin():
    return scanned(trimesh.creation.cylinder(0.035, 0.12, sections=48))


def carton():
    return scanned(trimesh.creation.box((0.06, 0.09, 0.14)).subdivide())


def mug():
    round_part = trimesh.creation.cylinder(0.035, 0.09, sections=48).vertices
    handle = [[0.06, y, z] for y in (-0.006, 0.006) for z in (-0.03, 0.03)]
    return scanned(trimesh.convex.convex_hull(np.vstack([round_part, handle])))


@pytest.mark.parametrize(("model", "axes", "rotations"), [(tin, 1, 2), (carton, 0, 4)])
def test_a_scanned_can_is_round_to_touch_and_a_box_has_its_flips(model, axes, rotations):
    scan = model()
    assert scan.symmetries.trivial
    to_touch = with_symmetries_of_touch(scan, SIGMA)
    assert (len(to_touch.symmetries.axes), len(to_touch.symmetries.rotations)) == (axes, rotations)


def test_a_mug_is_not_round_to_touch_and_declared_symmetries_stay():
    assert not with_symmetries_of_touch(mug(), SIGMA).symmetries.axes
    assert with_symmetries_of_touch(can(), SIGMA) is can()


def test_a_search_for_a_round_mesh_ends():
    """Without its symmetry it is never sure of the spin."""
    model, rng = with_symmetries_of_touch(tin(), SIGMA), np.random.default_rng(5)
    here = search_area()
    T = here.poses(model, here.draw(1, np.random.default_rng(3)))[0]
    belief = Belief(model, here)
    while not belief.modes[0].is_certain and len(belief.touches) < 8:
        belief = belief.after(swept_touch(model, T, best_sweep(belief, (0.08, 0.1), SWEEP_RADIUS), rng))
    assert belief.modes[0].is_certain
    shift, _ = pose_distances(model, T[None], belief.pose.T_a_b)
    assert shift[0] < 0.008


def test_a_contact_with_something_else_is_outvoted():
    """A cable beside the can, 8 cm from its surface, is met by the second of six sweeps."""
    T = np.eye(4)
    T[2, 3] = 0.0575
    belief, rng = Belief(can(), search_area()), np.random.default_rng(0)
    for k, angle in enumerate(np.linspace(0, 2 * np.pi, 6, endpoint=False)):
        along = np.array([np.cos(angle), np.sin(angle)])
        touch = swept_touch(can(), T, level_sweep(-0.3 * along, along, 0.6), rng)
        if k == 1:
            near = touch.contact_world.points_palm - 0.08 * np.array([*along, 0.0])
            contact = hs.Contacts(near, touch.contact_world.normals_palm, 1e-3, 0.05)
            free = touch.free_world[(touch.free_world - near) @ [*along, 0.0] < -SWEEP_RADIUS]
            touch = Touch(free, SWEEP_RADIUS, touch.sigma, contact)
        belief = belief.after(touch)
    shift, _ = pose_distances(can(), T[None], belief.pose.T_a_b)
    assert shift[0] < 0.004
