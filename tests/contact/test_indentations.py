"""Taxels that measure indentations, as gels do: contacts of what is pressed into them, out of images. Synthetic."""

import numpy as np
import pytest

import handsight as hs
from handsight.contact import TactileSurface
from handsight.errors import InvalidInput
from testbed import pad_scenes, scenes
from testbed.pad_scenes import BODIES, COLUMNS, OBJECTS_HELD_OUT, ROWS, errors, gel, places, pressed
from testbed.refusals import refused

GEL = gel()


def sphere(radius=0.01, deep=6e-4, at=(0.0, 0.0)):
    """The image of a rigid sphere, without noise, and its centre."""
    r2 = ((places() - at) ** 2).sum(axis=2)
    return np.maximum(np.sqrt(np.maximum(radius**2 - r2, 0)) - radius + deep, 0), np.array(
        [*at, radius - deep]
    )


def facing(slope_x, deep=8e-4):
    """The image of a plane."""
    return np.maximum(deep + slope_x * places()[..., 0], 0)


def judged(count=24):
    """Errors of the points [mm] and normals [deg] on bodies on which no constant was chosen, and those of squares."""
    rows = []
    for name in OBJECTS_HELD_OUT:
        make, tilt = BODIES[name]
        model = make()
        for k in range(count):
            scene = pressed(model, np.random.default_rng([5, k, len(name)]), tilt=tilt)
            touch = GEL.touch(scene.image)
            rows += [list(errors(model, patch, scene.T_true).values()) for patch in touch.patches]
    return np.array(rows).T


def test_contacts_are_on_the_object_with_its_normals_as_well_as_they_say():
    """Where the gel hangs beside the object, blurred, with noise, a wrong scale and dead pixels."""
    point, normal, squared = judged()
    assert np.median(point) < 0.06
    assert np.quantile(point, 0.9) < 0.15
    assert np.median(normal) < 2.5
    assert 0.05 < np.median(squared) < 1.2
    assert (squared < 16.3 / 3).mean() > 0.96  # χ² of three numbers, level .001


@pytest.mark.parametrize("slope", [0.0, 0.1, -0.2])
def test_a_taxel_is_where_it_is_pressed_to_with_the_normal_that_the_slope_gives(slope):
    """So the contact of a face is on it, with its normal."""
    contacts = GEL.touch(facing(slope)).contacts(np.eye(4))
    (point,), (normal,) = contacts.points_palm, contacts.normals_palm
    assert point[2] == pytest.approx(-8e-4 - slope * point[0], abs=3e-5)
    expected = -np.array([slope, 0, 1]) / np.hypot(slope, 1)
    np.testing.assert_allclose(normal, expected, atol=0.02)


def test_a_sphere_is_found_by_the_normal_of_its_contact():
    """Its centre is a radius away along that."""
    image, centre = sphere(at=(0.001, -0.0005))
    contacts = GEL.touch(image).contacts(np.eye(4))
    (point,), (normal,) = contacts.points_palm, contacts.normals_palm
    assert np.linalg.norm(point - centre) == pytest.approx(0.01, abs=6e-5)
    np.testing.assert_allclose(point - 0.01 * normal, centre, atol=2.5e-4)


def test_a_bent_gel_on_a_plane_gives_the_planes_normal():
    """The indentation is along the gel's own normals, and the contact is on the object all the same."""
    radius, columns, rows, pitch = 0.015, 24, 30, 4e-4
    angle, y = np.meshgrid(pitch * (np.arange(columns) - 11.5) / radius, pitch * (np.arange(rows) - 14.5))
    normals = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=2).reshape(-1, 3)
    points = radius * normals + np.outer(y.ravel(), [0, 1.0, 0])
    given = {"frame": "palm", "threshold": 1e-4, "pitch": pitch, "indentation": True}
    bent = TactileSurface(points=points, normals=normals, **given)
    depth = np.maximum((points[:, 2] - (radius - 6e-4)) / normals[:, 2], 0)  # to the plane z = 14.4 mm
    contacts = bent.touch(depth).contacts(np.eye(4))
    np.testing.assert_allclose(contacts.points_palm[:, 2], radius - 6e-4, atol=2e-5)
    np.testing.assert_allclose(contacts.normals_palm, [[0, 0, -1.0]], atol=0.02)


def test_an_edge_says_less_of_its_normal_than_a_face():
    x = places()[..., 0]
    edge = np.maximum(8e-4 - 0.3 * np.abs(x), 0)
    patches = [GEL.touch(image).patches[0] for image in (edge, facing(0.0))]
    turns = [np.sqrt(np.trace(patch["covariance"][3:, 3:]) / 3) for patch in patches]
    assert turns[0] > 1.5 * turns[1]
    assert turns[0] > 0.3 / 3  # the faces are that far from the edge's mean normal


def test_a_contact_is_no_better_than_the_mount_and_the_joints():
    touch = GEL.touch(facing(0.0))
    mount, J = GEL.record["variance_mount"][0], np.zeros((6, 1))
    J[2] = 1e-3
    fixed, moving = touch.contacts(np.eye(4)), touch.contacts(np.eye(4), J)
    assert fixed.covariance[0, 2, 2] >= mount[2]
    np.testing.assert_allclose(moving.covariance[:, 2, 2] - fixed.covariance[:, 2, 2], 1e-6, rtol=1e-9)


def test_a_gel_alone_improves_the_pose_and_its_regions_hold_the_truth():
    inside, shrunk = [], []
    model = scenes.can()
    for k in range(40):
        scene = pressed(model, np.random.default_rng([9, k]))
        contacts = GEL.touch(scene.image).contacts(np.eye(4))
        estimate = hs.correct_pose(model, contacts, vision=scene.vision)
        inside.append(scenes.region(model, estimate, scene.T_gel_object)["in 95%"])
        before, after = (
            abs(pad_scenes.distance(model, T, GEL.points))
            for T in (scene.vision.T_palm_object, estimate.T_palm_object)
        )
        shrunk.append(after < before)
    assert np.mean(inside) >= 0.9
    assert np.mean(shrunk) > 0.9


def test_two_things_on_a_gel_are_two_patches():
    left, right = sphere(0.004, 5e-4, (-0.006, 0))[0], sphere(0.004, 8e-4, (0.006, 0.001))[0]
    touch = GEL.touch(left + right)
    x = touch.patches["point"][:, 0]
    assert {-1, 1} == set(np.sign(x))
    assert touch.patches["point"][touch.strongest][0] > 0
    assert touch.states[1].max() == 1
    assert np.isnan(touch.wrench).all()  # a gel measures no force


def test_the_baseline_is_subtracted_and_dead_pixels_are_left_out():
    image, centre = sphere()
    rest = 1e-3 * np.sin(300 * places()[..., 0])
    clean, shifted = GEL.touch(image), GEL.touch(image + rest, rest)
    np.testing.assert_allclose(shifted.patches["point"], clean.patches["point"], atol=1e-9)
    dead = image.copy()
    dead[28:34, 38:41] = np.nan  # amid the contact
    dead[0] = np.inf
    touch = GEL.touch(dead)
    assert len(touch.patches)
    away = np.linalg.norm(touch.patches["point"] - centre, axis=1) - 0.01
    assert np.abs(away).max() < 1e-4
    assert not len(GEL.touch(np.full_like(image, np.nan)).patches)


def test_noise_below_the_threshold_or_of_single_pixels_is_no_contact():
    rng = np.random.default_rng(0)
    noise = 2e-5 * rng.normal(size=(ROWS, COLUMNS))
    noise[10, 10] = noise[30, 50] = 5e-3
    touch = GEL.touch(noise)
    assert not len(touch.patches)
    assert touch.contacts(np.eye(4)) is None
    assert not len(touch.outside(np.eye(4)))


def test_an_image_is_averaged_over_the_pixels_of_each_taxel_if_half_of_them_are_known():
    image = sphere()[0]
    blocks = image.reshape(ROWS // 2, 2, COLUMNS // 2, 2)
    np.testing.assert_allclose(GEL.reading(image), blocks.mean(axis=(1, 3)), atol=1e-15)
    touch, of_means = GEL.touch(image), GEL.touch(GEL.reading(image))
    np.testing.assert_array_equal(touch.patches["covariance"], of_means.patches["covariance"])
    image[0, 0] = image[2, :3] = image[3, 0] = np.nan
    read = GEL.reading(image)
    assert np.isfinite(read[0, 0])
    np.testing.assert_array_equal(np.isnan(read[1, :3]), [True, False, False])


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"rows": 0}, "rows"),
        ({"columns": 2.5}, "columns"),
        ({"pitch": 6e-5}, "pitch"),
        ({"components": 3}, "components"),
        ({"stiffness": 1e7}, "stiffness"),
        ({"threshold": 0.0}, "threshold"),
    ],
)
def test_a_wrong_gel_is_refused(given, field):
    with refused(InvalidInput, field):
        gel(**given)


@pytest.mark.parametrize("shape", [(80, 60), (45, 60), (4800,), (60, 80, 3), (15, 20), (0, 0)])
def test_an_image_of_the_wrong_shape_is_refused(shape):
    with refused(InvalidInput, "reading"):
        GEL.touch(np.zeros(shape))


def test_no_image_is_averaged_for_taxels_of_pressure():
    array = gel(indentation=False)
    with refused(InvalidInput, "reading"):
        array.touch(np.zeros((ROWS, COLUMNS)))
