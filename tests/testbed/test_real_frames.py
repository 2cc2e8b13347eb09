"""Real frames in both layouts are read as they are, and poses in them judged by their truth and covariance."""

import json

import numpy as np
import pytest
from scipy.stats import chi2

import handsight as hs
from handsight import se3
from testbed import real_frames
from testbed.picture_files import INTRINSICS, bop_with_truths, picture, write_depth, write_mesh

Image = pytest.importorskip("PIL.Image", reason="PNG files come with handsight[robot]")


def test_a_bop_scene_is_read_with_its_truth_and_the_pixels_that_are_visible(tmp_path):
    scene, truths = bop_with_truths(tmp_path / "lab")
    for given in (scene, scene.parent):
        frames = real_frames.open_folder(given)
        assert list(frames.models) == ["obj_000003", "obj_000007"]
        assert list(frames.scenes) == ["000048"]
    for read, T, name in zip(frames.scenes["000048"], truths, frames.models, strict=True):
        frame = read()
        (one,) = frame.instances
        assert (one.name, frame.scene) == (name, "000048")
        np.testing.assert_allclose(one.T_camera_object, T, atol=1e-6)
        assert 0.9 < one.share <= 1
        assert (frame.depth[one.visible] > 0).mean() > 0.8


def test_a_mask_of_the_data_set_is_preferred_to_a_drawn_one(tmp_path):
    scene, _ = bop_with_truths(tmp_path / "lab")
    drawn = real_frames.open_folder(scene).scenes["000048"][0]().instances[0].visible
    half = drawn & (np.arange(drawn.shape[1]) < np.nonzero(drawn)[1].mean())
    (scene / "mask_visib").mkdir()
    Image.fromarray((255 * half).astype(np.uint8)).save(scene / "mask_visib/000000_000000.png")
    (one,) = real_frames.open_folder(scene).scenes["000048"][0]().instances
    assert (one.visible == half).all()
    assert one.share == pytest.approx(half.sum() / drawn.sum(), rel=0.1)


def test_frames_with_labels_are_read_and_boxes_and_masks_are_a_little_wider(tmp_path):
    depth, T = picture(1)
    frame = tmp_path / "frames/0007/000003"
    write_depth(frame / "depth.png", depth, 1e-4)
    write_mesh(tmp_path / "frames/meshes/letter.ply")
    model = hs.ObjectModel.from_file(tmp_path / "frames/meshes/letter.ply")
    camera = real_frames.Camera(np.array([[INTRINSICS["fx"], 0, INTRINSICS["cx"]], [0, INTRINSICS["fy"], INTRINSICS["cy"]], [0, 0, 1]]), depth.shape[::-1])  # fmt: skip
    label = real_frames.bop.drawn(model, camera, T) > 0
    Image.fromarray((5 * label).astype(np.uint8)).save(frame / "label.png")
    entry = {"depth_scale": 1e-4, "labels": {"letter": 5}, "T_camera_object": {"letter": T.tolist()}}
    (frame / "frame.json").write_text(json.dumps(INTRINSICS | entry))
    frames = real_frames.open_folder(tmp_path / "frames")
    (read,) = frames.some(1)
    one = read().instances[0]
    assert (one.visible == label).all()
    box, mask = (read().wanted(one, told) for told in ("box", "mask"))
    assert read().wanted(one, "whole image") is None
    rows, columns = np.nonzero(label)
    height, width = (np.ptp(at) + 1 + 2 * real_frames.BOX_WIDER for at in (rows, columns))
    assert box.sum() == height * width
    assert (box & mask & label).sum() == label.sum() < mask.sum() < box.sum()


def test_a_folder_without_scenes_is_refused(tmp_path):
    with pytest.raises(ValueError):
        real_frames.open_folder(tmp_path)


def test_a_truth_drawn_from_the_covariance_is_inside_as_often_as_its_region_says():
    """Modulo symmetry: a can's spin, drawn at will, counts neither as an error nor as a degree of freedom."""
    rng = np.random.default_rng(0)
    for model, free in ((hs.ObjectModel.box((0.08, 0.05, 0.03)), 6), (hs.ObjectModel.cylinder(0.03, 0.1), 5)):
        squared = []
        for _ in range(400):
            T, A = se3.random(rng), rng.normal(size=(6, 6)) * 1e-3
            covariance = A @ A.T + 1e-6 * np.eye(6)
            truth = se3.moved(T, rng.multivariate_normal(np.zeros(6), covariance))
            if free == 5:
                spin = se3.rotation_exp(np.array([0, 0, rng.uniform(0, 6)]))
                truth = truth @ se3.compose(spin, np.zeros(3))
            value, freedom = real_frames.squared_error(model, truth, T, covariance)
            assert freedom == free
            squared.append(value)
        assert (np.array(squared) < chi2.ppf(0.95, free)).mean() == pytest.approx(0.95, abs=0.03)


def test_the_truths_own_error_is_one_about_the_objects_centre():
    """An origin far from the object does not turn an error of the rotation into one of millimetres."""
    model = hs.ObjectModel.box((0.08, 0.05, 0.03))
    T, sure = se3.random(np.random.default_rng(1)), 1e-12 * np.eye(6)
    sigma = 0.003
    turn = np.array([0, 0, 0, sigma / model.radius, 0, 0])
    lever = T[:3, :3] @ model.center_object
    off = turn + np.concatenate([np.cross(lever, turn[3:]), np.zeros(3)])
    squared, _ = real_frames.squared_error(model, se3.moved(T, off), T, sure, sigma)
    assert squared == pytest.approx(1, rel=1e-3)
