"""An object's first pose from a picture: what votes, what settles, what is judged, and all of it together."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

import handsight as hs
from handsight import se3
from handsight._kernels.image import depth_covariance, depth_term, outline, pose_score, votes
from handsight._kernels.image.vision_records import CANDIDATE, DEPTH_ERROR, DEPTH_POINT, STAGE
from handsight.gaussian_pose import GaussianPose
from handsight.objects.symmetry import nearest
from handsight.vision import STRUCTURED_LIGHT
from handsight.vision.candidates import (
    NOTHING_KNOWN,
    UNKNOWN,
    candidates_at,
    distinct,
    pose_covariances,
    poses_of,
)
from handsight.vision.object import appearance
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.first_pose import first_pose, log_odds, places_of
from handsight.vision.object.region import scene_of, table_plane
from sight_scenes import CAMERA, drawn, letter, looking, mssd, noisy, on_table


@functools.cache
def model():
    return hs.ObjectModel.from_mesh(*letter())


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_pairs_are_the_same_wherever_they_are(seed):
    rng = np.random.default_rng(seed)
    points, normals = model().sample(40, seed % 1000)
    T = se3.random(rng)
    first, second = (np.empty((40, 40), dtype=np.int64) for _ in range(2))
    spins = np.empty((2, 40, 40))
    votes.pairs_of(points, normals, 0.11, first, spins[0])
    votes.pairs_of(se3.apply(T, points), normals @ T[:3, :3].T, 0.11, second, spins[1])
    # But for numbers at the border of two cells.
    assert (first == second).mean() > 0.97
    # All spins about one point's normal change by the same.
    change = np.angle(np.exp(1j * (spins[1] - spins[0])))
    for i in range(40):
        there = (np.arange(40) != i) & (
            np.abs((points - points[i]) @ normals[i]) < 0.9 * np.linalg.norm(points - points[i], axis=1)
        )
        around = np.exp(1j * change[i, there])
        assert np.abs(around - around.mean()).max() < 1e-4


def outer(count, seed):
    """Surface points and normals of the letter, without those of faces that are within it."""
    points, normals = model().sample(count, seed)
    agree = (model().evaluate(points).gradient * normals).sum(axis=1) > 0.5
    return points[agree], normals[agree]


def seen(points, normals, T):
    rows = np.zeros(len(points), dtype=DEPTH_POINT)
    rows["point"], rows["normal"] = se3.apply(T, points), normals @ T[:3, :3].T
    return rows


def test_votes_for_a_whole_object_find_it():
    rng = np.random.default_rng(0)
    pairs, T = appearance_of(model()), se3.random(rng)
    points, normals = model().sample(400, 3)
    looks = np.zeros((20, votes.PEAKS), dtype=CANDIDATE)
    table, rows = pairs.pairs, seen(points, normals, T)
    votes.vote(table, pairs.voters, model().diameter, rows, np.arange(20), 140, looks)
    Ts = poses_of(looks)
    places = se3.apply(Ts.reshape(-1, 4, 4), model().points_object)
    off = np.abs(places - se3.apply(T, model().points_object)).max(axis=(1, 2)).reshape(20, votes.PEAKS)
    # As coarse as cells are; some faces are like others.
    assert (off.min(axis=1) < 0.15 * model().diameter).mean() > 0.6
    assert (np.diff(looks["votes"], axis=1) <= 0).all()
    np.testing.assert_allclose(np.linalg.det(Ts[..., :3, :3]), 1, atol=1e-9)


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


@pytest.mark.parametrize("kind", ["letter", "box", "can", "ball"])
def test_poses_that_go_on_are_apart_modulo_symmetry(kind):
    """One after another, by the nearest of all equivalents."""
    rng = np.random.default_rng(0)
    thing = {
        "letter": model,
        "box": lambda: hs.ObjectModel.box((0.04, 0.06, 0.1)),
        "can": lambda: hs.ObjectModel.cylinder(0.03, 0.1),
        "ball": lambda: hs.ObjectModel.sphere(0.04),
    }[kind]()
    group, far = thing.symmetries.rotations, 0.4
    Ts = se3.random(rng, 60, spread=0.02)
    Ts = np.concatenate([Ts, Ts @ group[rng.integers(len(group), size=60)]])
    looks, worth = candidates_at(Ts), rng.normal(size=len(Ts))
    centers = se3.compose(np.eye(3), thing.center_object)
    expected = []
    for k in np.argsort(-worth):
        near = nearest(thing.symmetries, np.tile(Ts[k], (len(expected), 1, 1)), Ts[expected], thing.radius)
        delta = se3.difference(near @ centers, Ts[expected] @ centers)
        shift, turn = (np.linalg.norm(delta[:, half], axis=1) for half in (slice(3), slice(3, 6)))
        if (np.hypot(shift, thing.radius * turn) > far * thing.diameter).all():
            expected.append(k)
    np.testing.assert_array_equal(distinct(thing, looks, worth, 200, far), looks[expected])
    np.testing.assert_array_equal(distinct(thing, looks, worth, 5, far), looks[expected[:5]])


@pytest.mark.parametrize("count", [60, 2000])
def test_what_points_say_counts_the_errors_that_they_share(count):
    """Against the whole covariance matrix of the points' depths; of many points some stand for all."""
    rng = np.random.default_rng(4)
    T = se3.compose(se3.random(rng)[:3, :3], np.array([0.05, -0.02, 0.6]))
    points, normals = outer(2 * count, 7)
    facing = np.flatnonzero((se3.apply(T, points) * (normals @ T[:3, :3].T)).sum(axis=1) < 0)
    facing = rng.permutation(facing)[:count]  # as seen points are
    points, normals = points[facing], normals[facing]
    rows, bound = seen(points + 3e-4 * rng.normal(size=points.shape), normals, T), 0.006
    look, found, covariances = candidates_at(T[None]), np.empty((1, 2, 6, 6)), np.empty((1, 6, 6))
    look["bound"] = bound
    errors = np.array([(4e-6, 2e-6, 3e-6, 1e-6, 1 / 0.01**2, 1 / 0.08**2, 4e-6, 0, 1e2, 1e2)], DEPTH_ERROR)
    depth_term.pose_covariances(*model().record[:2], rows, errors, look, found, covariances)
    P = rows["point"]
    values = model().evaluate(se3.apply(se3.inverse(T), P))
    g = values.gradient @ T[:3, :3].T
    weight = np.clip(1 - (values.distance / bound) ** 2, 0, None) ** 2
    weight *= (g * rows["normal"]).sum(axis=1) > depth_term.MIN_COSINE * np.linalg.norm(g, axis=1)
    lever = np.c_[g, np.cross(P - se3.apply(T, model().center_object[None]), g)]
    scale = np.repeat([1, model().radius], 3)
    A = (lever * weight[:, None]).T @ lever / np.outer(scale, scale)
    slopes = P[:, :2] / P[:, 2:]
    apart2 = ((slopes[:, None] - slopes) ** 2).sum(axis=-1)
    C = 4e-6 * np.eye(len(P)) + 2e-6 * np.exp(-apart2 / 0.01**2) + 3e-6 * np.exp(-apart2 / 0.08**2) + 1e-6
    pulls = lever * (weight * (g * P).sum(axis=1) / P[:, 2])[:, None] / scale
    S = pulls.T @ C @ pulls
    np.testing.assert_allclose(found[0, 0], A, atol=1e-3 * np.abs(A).max())
    within = 1e-3 if count < depth_term.COMPARED else 0.15
    np.testing.assert_allclose(found[0, 1], S, atol=within * np.abs(S).max())
    assert look["weight"][0] == pytest.approx(weight.sum(), rel=1e-6)
    # The pose's covariance is that of what the points say, by (δp, δθ) of the object's origin.
    center = GaussianPose(T, covariances[0]).at_point(model().center_object).covariance
    np.testing.assert_allclose(
        center * np.outer(scale, scale), plain_covariance(found[0], errors), rtol=1e-6, atol=1e-12
    )


def plain_covariance(informed, errors):
    """(A S⁻¹ A + U)⁻¹ + v by NumPy, of A and S without their negative eigenvalues."""
    values, vectors = np.linalg.eigh(informed)
    values = np.maximum(values, 0)
    values[1] = 1 / (values[1] + 1e-3 * np.trace(informed[1]) / 6 + 1e-12)
    A, S_inverse = (vectors * values[:, None]) @ np.swapaxes(vectors, 1, 2)
    unknown = np.diag(np.repeat([errors["known_shift"][0], errors["known_turn"][0]], 3))
    return np.linalg.inv(A @ S_inverse @ A + unknown) + errors["pose"][0] * np.eye(6)


@pytest.mark.parametrize("seed", range(5))
def test_a_covariance_is_positive_definite_where_the_points_say_little(seed):
    """Of few points, and of pulls whose covariance, summed over some pairs, is not positive."""
    rng = np.random.default_rng(seed)
    rows, root = rng.normal(size=(seed, 6)), rng.normal(size=(6, 6))
    informed = np.stack([rows.T @ rows, 1e-6 * (root @ root.T - 0.5 * np.eye(6))])
    errors, found = np.zeros(1, dtype=DEPTH_ERROR), np.empty((6, 6))
    errors["pose"], errors["known_shift"], errors["known_turn"] = 1e-6, 4e2, 1e2
    depth_covariance.covariance_of(informed, errors, found)
    np.testing.assert_allclose(found, plain_covariance(informed, errors), rtol=1e-6, atol=1e-9)
    assert np.linalg.eigvalsh(found).min() > 0.9e-6


def test_a_weighted_fit_is_off_as_the_errors_of_its_points_make_it():
    """Of many fits to points whose errors are correlated, the covariance is A⁻¹ S A⁻¹."""
    rng = np.random.default_rng(5)
    rows, weights = rng.normal(size=(40, 6)), rng.uniform(0.2, 1, 40)
    root = 1e-3 * rng.normal(size=(40, 40))
    A, pulls = rows.T @ (weights[:, None] * rows), rows.T * weights
    informed, found = np.stack([A, pulls @ root @ root.T @ pulls.T]), np.empty((6, 6))
    errors = np.zeros(1, dtype=DEPTH_ERROR)
    errors["pose"], errors["known_shift"], errors["known_turn"] = 4e-6, 1e-12, 1e-12
    depth_covariance.covariance_of(informed, errors, found)
    fits = np.linalg.solve(A, pulls @ (root @ rng.normal(size=(40, 20_000))))
    np.testing.assert_allclose(found - 4e-6 * np.eye(6), np.cov(fits), atol=0.05 * np.abs(found).max())


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


def test_of_a_convex_object_all_points_that_face_a_direction_are_visible():
    box = hs.ObjectModel.box((0.05, 0.08, 0.03))
    samples, directions, bits, _ = appearance_of(box).sides
    visible = np.unpackbits(bits, axis=1, bitorder="little")
    ways = box.center_object + appearance.AWAY * box.diameter * directions[:, None] - samples[0]
    cosine = (ways * samples[1]).sum(axis=2) / np.linalg.norm(ways, axis=2)
    assert (visible == (cosine > pose_score.MIN_FACING)).mean() > 0.9999


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


def test_where_nothing_is_there_is_no_pose():
    depth = np.zeros((240, 320), np.float32)
    scene = scene_of(CAMERA, depth, wanted=np.ones(depth.shape, bool))
    assert first_pose(model(), scene).Ts_camera_object.shape == (0, 4, 4)


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


def share_beside(model, T, depth):
    """The share of the outline of an object at a pose beyond which the surface goes on."""
    candidate, sides = candidates_at(T[None]), appearance_of(model).sides
    scene = scene_of(CAMERA, depth, extent=1.5 * model.diameter)
    candidate["bound"] = 0.006
    pose_score.score_all(
        CAMERA.record,
        (scene.depth, scene.labels),
        sides,
        model.center_object,
        candidate,
        pose_score.NOT_ASKED,
    )
    assert candidate["unexplained"][0] == 0
    image, before = (CAMERA.rays, scene.depth, scene.labels), candidate["score"][0]
    outline.follow_outlines(CAMERA.record, model.record[:2], image, 1500, candidate)
    share = candidate["unexplained"][0] / candidate["expected"][0]
    expected = before - candidate["unexplained"][0] / candidate["expected"][0] ** 0.7
    assert candidate["score"][0] == pytest.approx(expected)
    return share


@pytest.mark.parametrize("seed", range(4))
def test_a_neighbour_that_touches_does_not_continue_a_surface_but_a_bigger_face_does(seed):
    """The brick where it is, and a smaller one in the middle of its upper face."""
    T, depth, _ = touching(seed)
    small = hs.ObjectModel.box((0.045, 0.03, BRICK[2]))
    assert share_beside(hs.ObjectModel.box(BRICK), T, depth) < 0.1
    assert share_beside(small, T, depth) > 0.2


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


def test_modes_are_in_order_of_their_places_and_these_of_their_odds():
    """The first place is the most probable one, and weights decrease."""
    T, depth, _ = touching(1)
    model = hs.ObjectModel.box(BRICK)
    found = first_pose(model, scene_of(CAMERA, depth, extent=1.5 * model.diameter))
    places, odds = places_of(model, found.candidates), log_odds(found.candidates)
    best = np.array([odds[places == place].max() for place in range(places.max() + 1)])
    assert (np.diff(found.weights) <= 0).all()
    assert found.weights.sum() == pytest.approx(1)
    assert best.argmax() == 0
    assert found.probability == pytest.approx(1 / (1 + np.exp(-best[0])))
