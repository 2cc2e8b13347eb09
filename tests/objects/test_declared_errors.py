"""Errors that a cloud's file declares for its points are read, written, and used by a correction."""

import numpy as np
import pytest

import handsight as hs
from handsight.objects import Shape, ply_bytes, read_shape


def cloud():
    points, normals = hs.ObjectModel.box((0.05, 0.06, 0.08)).sample(3000)
    return points, normals, np.where(points[:, 2] > 0, 2e-3, 1e-4)


@pytest.mark.parametrize("normals", [True, False])
def test_sigmas_are_read_back_in_the_unit_of_the_points(tmp_path, normals):
    points, outward, sigmas = cloud()
    shape = Shape(points, normals=outward if normals else None, sigmas=sigmas)
    (tmp_path / "box.ply").write_bytes(ply_bytes(shape, 1000.0))
    back = read_shape(tmp_path / "box.ply")
    np.testing.assert_allclose(back.sigmas, 1000 * sigmas)
    np.testing.assert_allclose(back.vertices, 1000 * points)
    (tmp_path / "plain.ply").write_bytes(ply_bytes(Shape(points), 1.0))
    assert read_shape(tmp_path / "plain.ply").sigmas is None


def test_a_contact_weighs_less_where_the_declared_error_of_the_model_is_large(tmp_path):
    points, outward, sigmas = cloud()
    (tmp_path / "box.ply").write_bytes(ply_bytes(Shape(points, normals=outward, sigmas=sigmas), 1.0))
    declared, plain = (
        hs.ObjectModel.from_file(tmp_path / "box.ply"),
        hs.ObjectModel.from_points(points, outward),
    )

    def height_sigma(model, side):
        contact = hs.Contacts([[0, 0, side * 0.04]], [[0, 0, side]], sigma_point=5e-4, sigma_normal=0.03)
        prior = hs.PosePrior(np.eye(4), np.diag([0.02**2] * 3 + [0.02**2] * 3))
        return np.sqrt(hs.correct_pose(model, contact, vision=prior).covariance[2, 2])

    assert height_sigma(declared, 1) > 1.8e-3
    assert height_sigma(declared, -1) < 1.2 * height_sigma(plain, -1)


def test_points_with_an_invalid_error_are_dropped(tmp_path):
    points, _, sigmas = cloud()
    sigmas[:7], sigmas[7] = np.nan, -1
    (tmp_path / "box.ply").write_bytes(ply_bytes(Shape(points, sigmas=sigmas), 1.0))
    assert len(read_shape(tmp_path / "box.ply").vertices) == len(points) - 8
