"""Attributes of a cloud are evidence: what is beside its points counts as normals only where it can be that."""

import numpy as np
import pytest

from handsight.objects import ObjectModel
from handsight.objects.files.read import read_shape

MODELS = {"box": ObjectModel.box((0.06, 0.04, 0.03)), "can": ObjectModel.cylinder(0.03, 0.1)}


def cloud(name, count=3000):
    points, normals = MODELS[name].sample(count)
    return points + np.array([0.3, -0.2, 0.1]), normals


def written(path, points, beside):
    np.savetxt(path, np.hstack([points, beside]))
    return path


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("kind", ["outward", "inward", "random", "scaled inward"])
def test_normals_point_outwards_whatever_their_signs_in_the_file(tmp_path, name, kind, rng):
    points, normals = cloud(name)
    signs = {
        "outward": 1,
        "inward": -1,
        "random": rng.choice([-1, 1], (len(points), 1)),
        "scaled inward": -7.5,
    }[kind]
    shape = read_shape(written(tmp_path / "a.xyz", points, signs * normals))
    unit = shape.normals / np.linalg.norm(shape.normals, axis=1, keepdims=True)
    assert ((unit * normals).sum(axis=1) > 0.99).mean() > 0.995
    assert bool(shape.remarks) == (kind != "outward")


@pytest.mark.parametrize("kind", ["bytes", "shares", "zeros"])
def test_colours_and_zeros_are_no_normals(tmp_path, kind, rng):
    points, normals = cloud("box")
    beside = {
        "bytes": rng.integers(0, 256, points.shape),
        "shares": rng.random(points.shape),
        "zeros": 0 * normals,
    }[kind]
    shape = read_shape(written(tmp_path / "a.xyz", points, beside))
    assert shape.normals is None
    assert len(shape.vertices) == len(points)
    assert len(shape.remarks) == 1


def test_points_without_a_normal_are_left_out(tmp_path):
    points, normals = cloud("can")
    normals[:100] = 0
    shape = read_shape(written(tmp_path / "a.xyz", points, normals))
    assert len(shape.vertices) == len(points) - 100
    assert "100 points" in shape.remarks[0]
