"""An object's first pose from a picture: what votes, what settles, what is judged, and all of it together."""

import functools

import numpy as np
import pytest
from scipy.optimize import least_squares

import handsight as hs
from handsight import se3
from handsight.vision import STRUCTURED_LIGHT
from handsight.vision.candidates import NOTHING_KNOWN, UNKNOWN, candidates_at, pose_covariances, poses_of
from handsight.vision.kernels import depth_term, pose_score
from handsight.vision.kernels.vision_records import DEPTH_POINT, STAGE
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.first_pose import first_pose
from handsight.vision.object.region import scene_of, table_plane
from testbed.sight_scenes import CAMERA, drawn, letter, looking, mssd, noisy, on_table


@functools.cache
def model():
    return hs.ObjectModel.from_mesh(*letter())


def outer(count, seed):
    """Surface points and normals of the letter, without those of faces that are within it."""
    points, normals = model().sample(count, seed)
    agree = (model().evaluate(points).gradient * normals).sum(axis=1) > 0.5
    return points[agree], normals[agree]


def seen(points, normals, T):
    rows = np.zeros(len(points), dtype=DEPTH_POINT)
    rows["point"], rows["normal"] = se3.apply(T, points), normals @ T[:3, :3].T
    return rows


@pytest.mark.parametrize("fine", [False, True])
def test_points_settle_where_least_squares_puts_them(fine):
    """SciPy's minimum of the same residuals, each weighted by Tukey's biweight there."""
    rng = np.random.default_rng(1)
    truth, bound = se3.random(rng), 0.02
    points, normals = outer(300, 5)
    rows = seen(points + 5e-4 * rng.normal(size=points.shape), normals, truth)
    start = truth @ se3.compose(
        se3.rotation_exp(np.array([0.03, -0.02, 0.04])), np.array([2e-3, -1e-3, 2e-3])
    )
    look, stages = candidates_at(start[None]), np.array([(fine, bound, bound, 40, 1)], dtype=STAGE)
    depth_term.refine_poses(*model().record[:2], rows, stages, 1.0, NOTHING_KNOWN, look)
    found = poses_of(look)[0]

    def distances(T):
        return model().evaluate(se3.apply(se3.inverse(T), rows["point"]), fine=fine).distance

    values = model().evaluate(se3.apply(se3.inverse(found), rows["point"]), fine=fine)
    cosine = (values.gradient @ found[:3, :3].T * rows["normal"]).sum(axis=1)
    agrees = cosine > depth_term.MIN_COSINE * np.linalg.norm(values.gradient, axis=1)
    weight = agrees * np.clip(1 - (values.distance / bound) ** 2, 0, None)

    def residuals(x):
        return weight * distances(
            se3.compose(se3.rotation_exp(x[3:] / 0.05) @ found[:3, :3], found[:3, 3] + x[:3])
        )

    best = least_squares(residuals, np.zeros(6), x_scale=1e-3, xtol=1e-12, ftol=1e-12)
    assert np.abs(best.x).max() < 2e-5


def test_what_no_point_observes_is_unknown_and_the_rest_is_known_to_millimetres():
    """Of a can the spin, as far as from one side of it to the other."""
    can = hs.ObjectModel.cylinder(0.03, 0.1)
    T = se3.compose(se3.random(np.random.default_rng(6))[:3, :3], np.array([0.02, 0.01, 0.5]))
    points, normals = can.sample(1500, 1)
    look, rows = candidates_at(T[None]), seen(points, normals, T)
    look["bound"] = 0.006
    covariance = pose_covariances(can, CAMERA, rows, look, STRUCTURED_LIGHT)[0]
    axis = np.append(np.zeros(3), T[:3, 2])
    assert axis @ covariance @ axis == pytest.approx((UNKNOWN[1] * can.diameter / can.radius) ** 2, rel=0.02)
    across = np.linalg.svd(axis[None])[2][1:]
    assert np.linalg.eigvalsh(across @ covariance @ across.T).max() < 0.1**2
    assert np.sqrt(np.diag(covariance)[:3].max()) < 5e-3


def test_points_behind_another_part_of_the_object_are_hidden():
    """From the side of the small block the foot of the tower is behind it; from above it is not."""
    samples, directions, bits, _ = appearance_of(model()).sides
    visible = np.unpackbits(bits, axis=1, bitorder="little")
    faces_x = (samples[1][:, 0] > 0.9) & (np.abs(samples[0][:, 0] + 0.01) < 2e-3)  # the tower's side
    behind = faces_x & (np.abs(samples[0][:, 1] + 0.01) < 0.01) & (samples[0][:, 2] < 0.05)
    clear = faces_x & (samples[0][:, 2] > 0.06)
    side = int(directions[:, 0].argmax())
    assert behind.any()
    assert clear.any()
    assert not visible[side, behind].any()
    assert visible[side, clear].all()


def picture(seed, neighbours=1, distance=(0.4, 0.6)):
    rng = np.random.default_rng([seed, 7])
    box = hs.ObjectModel.box((0.05, 0.06, 0.04))
    shapes = [letter(), *[(box.vertices + np.array([0, 0, 0.02]), box.faces)] * neighbours]
    Ts, T_camera_table = on_table(rng, shapes), looking(rng, rng.uniform(*distance))
    depth, labels = drawn(T_camera_table, shapes, Ts)
    return T_camera_table @ Ts[0], noisy(depth, rng), labels, T_camera_table


def test_the_table_is_found_and_nothing_where_there_is_none():
    for seed in range(5):
        _, depth, labels, T = picture(seed)
        plane = table_plane(CAMERA, depth, np.ones(depth.shape, bool), extent=0.2)
        expected = np.append(T[:3, 2], -T[:3, 2] @ T[:3, 3])
        np.testing.assert_allclose(plane, expected, atol=0.02)
        alone = np.where(labels == 0, depth, 0)
        assert table_plane(CAMERA, alone, alone > 0, extent=0.2) is None


def test_explained_pixels_are_those_of_the_silhouette():
    for seed in range(4):
        T, _, _, T_camera_table = picture(seed, neighbours=0)
        depth, labels = drawn(T_camera_table, [letter()], [se3.inverse(T_camera_table) @ T])
        scene = scene_of(CAMERA, np.where(np.isfinite(depth), depth, 0), wanted=labels == 0)
        look, sides = candidates_at(T[None]), appearance_of(model()).sides
        look["bound"], image = 0.006, (scene.depth, scene.labels)
        pose_score.score_all(CAMERA.record, image, sides, model().center_object, look, pose_score.NOT_ASKED)
        assert look["explained"][0] == pytest.approx((labels == 0).sum(), rel=0.15)
        assert look["passed"][0] + look["hidden"][0] < 0.1 * look["expected"][0]


def test_nothing_is_under_the_table():
    """Beside itself the object would be seen past, if it is above the table, and cannot be where it is below."""
    T, depth, _, T_camera_table = picture(0, neighbours=0)
    plane = np.append(T_camera_table[:3, 2], -T_camera_table[:3, 2] @ T_camera_table[:3, 3])
    scene, sides = scene_of(CAMERA, depth, wanted=depth > 0, table=plane), appearance_of(model()).sides
    lifts = [T_camera_table[:3, :3] @ [0.08, 0.08, height] for height in (0.05, -0.12)]
    looks = candidates_at(np.stack([T] + [se3.compose(np.eye(3), lift) @ T for lift in lifts]))
    looks["bound"], image = 0.006, (scene.depth, scene.labels)
    pose_score.score_all(CAMERA.record, image, sides, model().center_object, looks, pose_score.NOT_ASKED)
    share = looks["passed"] / looks["expected"]
    assert share[0] < 0.15
    assert share[1:].min() > 0.8


@pytest.mark.slow
def test_an_object_beside_another_is_found_without_a_guess():
    """Twenty noisy pictures, the object on a table with a box about its size beside it."""
    right = []
    for seed in range(20):
        T, depth, _, _ = picture(seed)
        everywhere = np.ones(depth.shape, bool)
        table = table_plane(CAMERA, depth, everywhere, extent=0.2)
        found = first_pose(model(), scene_of(CAMERA, depth, wanted=everywhere, table=table))
        off = np.linalg.norm(
            se3.apply(found.Ts_camera_object[0], model().points_object) - se3.apply(T, model().points_object),
            axis=1,
        )
        right.append(off.max() < 0.1 * model().diameter)
        assert (np.diff(found.weights) <= 0).all()
    assert sum(right) >= 19


BRICK = (0.09, 0.055, 0.035)


def touching(seed, size=(0.05, 0.1, 0.07)):
    """A brick on a table whose side touches that of a higher box; its pose, the depth, and whose pixels there are."""
    rng = np.random.default_rng([seed, 8])
    shapes = [hs.ObjectModel.box(each) for each in (BRICK, size)]
    places = [np.array([0, 0, BRICK[2] / 2]), np.array([(BRICK[0] + size[0]) / 2, 0, size[2] / 2])]
    T_camera_table = looking(rng, 0.45)
    Ts = np.stack([se3.compose(np.eye(3), place) for place in places])
    depth, labels = drawn(T_camera_table, [(shape.vertices, shape.faces) for shape in shapes], Ts)
    return T_camera_table @ Ts[0], noisy(depth, rng), labels


def test_a_box_that_touches_another_is_answered():
    """Its pixels and those of its neighbour are one segment, and only some of them are its own: nine times of twelve."""
    model, answered = hs.ObjectModel.box(BRICK), []
    for seed in range(12):
        T, depth, _ = touching(seed)
        found = first_pose(model, scene_of(CAMERA, depth, extent=1.5 * model.diameter))
        near = mssd(model, T, found.Ts_camera_object[:1])[0] < 0.1
        answered.append(near and found.probability > 0.5)
    assert sum(answered) >= 9


def test_what_is_out_of_the_image_is_no_evidence():
    """An object of which the image has half is expected to have the other half's pixels, too, at half their weight."""
    T, depth, _ = touching(0)
    model, scene = hs.ObjectModel.box(BRICK), scene_of(CAMERA, depth, extent=0.2)
    shifted = T.copy()
    shifted[0, 3] += 160 / 300 * T[2, 3]  # its centre is on the image's edge, or beyond
    candidates = candidates_at(np.stack([T, shifted]))
    candidates["bound"], sides = 0.006, appearance_of(model).sides
    pose_score.score_all(
        CAMERA.record,
        (scene.depth, scene.labels),
        sides,
        model.center_object,
        candidates,
        pose_score.NOT_ASKED,
    )
    assert 0.4 < candidates["expected"][1] / candidates["expected"][0] < 1
