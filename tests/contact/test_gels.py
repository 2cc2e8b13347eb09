"""Contacts of gels: points and normals of what is pressed into them, out of indentation images. Synthetic."""

import warnings

import numpy as np
import pytest

import gel_scenes
import handsight as hs
import scenes
from gel_scenes import BODIES, COLUMNS, HELD_OUT, PITCH, ROWS, errors, gel, places, pressed
from handsight import se3
from handsight.contact import Gel
from handsight.errors import InvalidInput

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
    for name in HELD_OUT:
        make, tilt = BODIES[name]
        model = make()
        for k in range(count):
            scene = pressed(model, np.random.default_rng([5, k, len(name)]), tilt=tilt)
            touch = GEL.touch(scene.image)
            rows += [list(errors(model, patch, scene.T_true).values()) for patch in touch.patches]
    return np.array(rows).T


def test_contacts_are_on_the_object_with_its_normals_as_well_as_they_say():
    """Where the gel hangs beside the object, blurred, with noise, a wrong scale and dead pixels. Errors of the scale are
    common to all contacts of a press, so that most presses are better than they say."""
    point, normal, squared = judged()
    assert np.median(point) < 0.06
    assert np.quantile(point, 0.9) < 0.15
    assert np.median(normal) < 2.5
    assert 0.05 < np.median(squared) < 1.2
    assert (squared < 16.3 / 3).mean() > 0.96  # χ² of three numbers, level .001


def test_a_sphere_is_found_by_the_normals_of_its_contacts():
    """Lines along the normals meet in its centre."""
    image, centre = sphere(at=(0.001, -0.0005))
    contacts = GEL.touch(image).contacts(np.eye(4))
    assert len(contacts) >= 3
    np.testing.assert_allclose(np.linalg.norm(contacts.points_palm - centre, axis=1), 0.01, atol=6e-5)
    found = contacts.points_palm - 0.01 * contacts.normals_palm
    np.testing.assert_allclose(found, np.tile(centre, (len(found), 1)), atol=2.5e-4)
    gaps = np.linalg.norm(contacts.points_palm[:, None] - contacts.points_palm, axis=2)
    assert gaps[np.triu_indices(len(gaps), 1)].min() > 2 * GEL.pitch  # well spread


@pytest.mark.parametrize("slope", [0.0, 0.03, -0.03])
def test_a_plane_gives_its_own_normal_and_depth_everywhere(slope):
    contacts = GEL.touch(facing(slope)).contacts(np.eye(4))
    normal = -np.array([slope, 0, 1]) / np.hypot(slope, 1)
    assert len(contacts) == 5
    np.testing.assert_allclose(contacts.normals_palm, np.tile(normal, (5, 1)), atol=1e-3)
    x, _, z = contacts.points_palm.T
    np.testing.assert_allclose(z, -(8e-4 + slope * x), atol=1e-6)


def test_a_bent_gel_on_a_plane_gives_the_planes_normal():
    """The indentation is along the gel's own normals, and the contact is on the object all the same."""
    radius, columns, rows, pitch = 0.015, 24, 30, 4e-4
    angle, y = np.meshgrid(pitch * (np.arange(columns) - 11.5) / radius, pitch * (np.arange(rows) - 14.5))
    normals = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=2).reshape(-1, 3)
    points = radius * normals + np.outer(y.ravel(), [0, 1.0, 0])
    bent = Gel(frame="palm", points=points, normals=normals, threshold=1e-4, pitch=pitch)
    depth = np.maximum((points[:, 2] - (radius - 6e-4)) / normals[:, 2], 0)  # to the plane z = 14.4 mm
    contacts = bent.touch(depth).contacts(np.eye(4))
    assert len(contacts) >= 3
    assert np.ptp(contacts.points_palm[:, 1]) > 0.008
    np.testing.assert_allclose(contacts.points_palm[:, 2], radius - 6e-4, atol=2e-5)
    np.testing.assert_allclose(contacts.normals_palm, np.tile([0, 0, -1.0], (len(contacts), 1)), atol=0.02)


def test_an_edge_says_less_of_its_normal_than_a_face():
    x = places()[..., 0]
    edge = np.maximum(8e-4 - 0.3 * np.abs(x), 0)
    patches = [GEL.touch(image).patches[0] for image in (edge, facing(0.0))]
    turns = [np.sqrt(np.trace(patch["covariance"][3:, 3:]) / 3) for patch in patches]
    assert turns[0] > 1.5 * turns[1]
    assert turns[0] > 0.3 / 3  # the faces are that far from the edge's mean normal


def test_all_contacts_together_are_no_better_than_the_mount():
    """k contacts with k times the common variance: their mean has that variance, in the palm and for joints."""
    touch = GEL.touch(facing(0.0))
    mount, J = GEL.record["variance_mount"][0], np.zeros((6, 1))
    J[2] = 1e-3
    fixed, moving = touch.contacts(np.eye(4)), touch.contacts(np.eye(4), J)
    n = len(fixed)
    information = sum(1 / fixed.covariance[k, 2, 2] for k in range(n))
    assert 1 / information >= mount[2]
    np.testing.assert_allclose(moving.covariance[:, 2, 2] - fixed.covariance[:, 2, 2], n * 1e-6, rtol=1e-9)


def test_a_gel_alone_improves_the_pose_and_its_regions_hold_the_truth():
    inside, shrunk = [], []
    model = scenes.can()
    for k in range(40):
        scene = pressed(model, np.random.default_rng([9, k]))
        contacts = GEL.touch(scene.image).contacts(np.eye(4))
        estimate = hs.correct_pose(model, contacts, vision=scene.vision)
        inside.append(scenes.region(model, estimate, scene.T_gel_object)["in 95%"])
        before, after = (
            abs(gel_scenes.pad_scenes.distance(model, T, GEL.points))
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


def test_a_height_image_in_millimetres_that_falls_when_pressed_is_the_same():
    image, _ = sphere()
    height = gel(scale=-1e-3, offset=3.0)
    np.testing.assert_allclose(
        height.touch(3.0 - 1e3 * image).patches["point"], GEL.touch(image).patches["point"], atol=1e-12
    )


def test_a_large_image_is_averaged_over_blocks():
    big = Gel.grid(
        frame="palm", T_frame_grid=np.eye(4), rows=240, columns=320, pitch=PITCH / 4, threshold=1.5e-4
    )
    assert big.shape == (240, 320)
    assert len(big.points) <= 2048
    values = np.arange(240.0 * 320).reshape(240, 320)
    b, top, left = big.block, 240 % big.block // 2, 320 % big.block // 2
    mean = values[top : top + b, left : left + b].mean()
    assert big.cells(values)[0, 0] == pytest.approx(mean)
    values[top, left : left + b] = np.nan
    assert big.cells(values)[0, 0] == pytest.approx(values[top + 1 : top + b, left : left + b].mean())
    values[top : top + b - 1, left : left + b] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(big.cells(values)[0, 0])
    image, centre = sphere(at=(0.002, 0.001))
    contacts = big.touch(np.kron(image, np.ones((4, 4)))).contacts(np.eye(4))
    np.testing.assert_allclose(np.linalg.norm(contacts.points_palm - centre, axis=1), 0.01, atol=1e-4)


def test_contacts_move_with_their_link():
    image, _ = sphere()
    T = se3.random(np.random.default_rng(1), spread=0.1)
    here, there = (GEL.touch(image).contacts(pose) for pose in (np.eye(4), T))
    np.testing.assert_allclose(there.points_palm, here.moved(T).points_palm, atol=1e-12)
    np.testing.assert_allclose(there.covariance, here.moved(T).covariance, atol=1e-12)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rows": 0}, "rows: expected a whole number from 1 to 10000, got 0"),
        ({"columns": 2.5}, "columns: expected a whole number from 1 to 10000, got 2.5"),
        ({"pitch": 6e-5}, "pitch: expected metres from 0.0002 to 0.05, got 0.00012"),
        ({"components": 3}, "components: expected 1, the indentation, got 3"),
        ({"threshold": 0.0}, "threshold: expected a number above 0"),
    ],
)
def test_a_wrong_gel_is_refused(given, message):
    fields = {"rows": ROWS, "columns": COLUMNS, "pitch": PITCH, "threshold": 1e-4} | given
    with pytest.raises(InvalidInput, match=message):
        Gel.grid(frame="palm", T_frame_grid=np.eye(4), **fields)


def test_an_image_of_other_blocks_is_refused():
    with pytest.raises(
        InvalidInput, match="image: expected rows and columns of 1200 square blocks, got 50 x 80"
    ):
        Gel(frame="palm", points=GEL.points, normals=GEL.normals, threshold=1e-4, image=(50, 80))


@pytest.mark.parametrize("shape", [(80, 60), (30, 40), (4800,), (60, 80, 3)])
def test_an_image_of_the_wrong_shape_is_refused(shape):
    with pytest.raises(InvalidInput, match="reading: expected 60 rows of 80 numbers, got"):
        GEL.touch(np.zeros(shape))
