"""Objects that other people scanned or drew, in files of the shared test data."""

import numpy as np
import pytest

from handsight.objects import ObjectModel, ObjectWarning, Triangles, propose_symmetries
from handsight.objects.meshes.box_tree import Winding
from objects.object_shapes import data_file

SCANS = ["004_sugar_box", "006_mustard_bottle", "007_tuna_fish_can", "011_banana", "019_pitcher_base"]


def scan(name):
    return ObjectModel.from_file(data_file(f"ycb_meshes/{name}.ply"))


@pytest.mark.parametrize("name", SCANS)
def test_a_scan_is_closed_and_its_field_is_at_its_surface(name):
    model = scan(name)
    assert model.closed
    assert model.remarks == ()
    points, normals = model.sample(3000, seed=8)
    distance, gradient, _ = model.evaluate(points)
    sine = np.linalg.norm(np.cross(gradient, normals), axis=1)
    assert np.sqrt((distance**2).mean()) < 0.11 * model.fine.cell
    assert np.median(np.arctan2(sine, (gradient * normals).sum(axis=1))) < np.deg2rad(3)
    assert model.sigma_point < 1e-4
    assert model.sigma_normal < np.deg2rad(2.5)


@pytest.mark.parametrize("name", SCANS)
def test_signs_around_a_scan_are_those_of_its_winding_number(name, rng):
    model = scan(name)
    points, _ = model.sample(2000, seed=8)
    points = points + 2 * model.fine.cell * rng.normal(size=points.shape)
    inside = Winding.of_mesh(Triangles(model.vertices, model.faces)).at(points) > 0.5
    for field in (model.fine, model.coarse):
        distance = field.evaluate(points).distance
        clear = np.abs(distance) > 0.5 * field.cell
        assert clear.any()
        np.testing.assert_array_equal((distance < 0)[clear], inside[clear])


@pytest.mark.parametrize("name", SCANS)
def test_surface_points_from_another_source_are_on_the_field(name):
    file = data_file(f"surface_samples/{name}_2000.off")
    rows = np.loadtxt(file, skiprows=2)
    model = scan(name)
    distance, gradient, _ = model.evaluate(rows[:, :3])
    assert np.median(np.abs(distance)) < 1.5e-4
    cosine = (gradient * rows[:, 3:6]).sum(axis=1) / np.linalg.norm(gradient, axis=1)
    assert np.median(cosine) > np.cos(np.deg2rad(6))


@pytest.mark.parametrize("name", ["006_mustard_bottle", "036_wood_block"])
def test_the_field_of_a_cloud_of_2000_points_is_right_to_half_a_millimetre(name):
    cloud = ObjectModel.from_file(data_file(f"surface_samples/{name}_2000.off"))
    assert cloud.closed
    points, _ = scan(name).sample(3000)
    assert np.sqrt((cloud.evaluate(points).distance ** 2).mean()) < 5e-4


def test_the_bunny_with_its_holes_is_closed():
    file = data_file("registration_teaser/bun_zipper_res3.ply")
    with pytest.warns(ObjectWarning) as caught:
        model = ObjectModel.from_file(file)
    assert [str(w.message) for w in caught] == list(model.remarks)
    assert any("83 repeated triangles were dropped" in remark for remark in model.remarks)
    assert model.closed
    assert model.evaluate(model.center_object[None]).distance < -0.01


def test_a_mustard_bottle_turns_over_and_a_banana_does_not():
    assert len(propose_symmetries(scan("006_mustard_bottle")).rotations) == 2
    assert propose_symmetries(scan("011_banana")).trivial
    can = propose_symmetries(scan("002_master_chef_can"))
    assert len(can.axes) == 1
    assert abs(can.axes[0][1][2]) > 0.999
