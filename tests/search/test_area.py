"""The prior of a search: placements of an object on a table."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.errors import InvalidInput
from handsight.rig import Table
from handsight.search import Area, resting
from testbed.refusals import refused
from testbed.scenes import box, can, search_area


def test_an_object_at_a_placement_stands_on_the_table_at_that_position():
    for model in (box(), can()):
        here = search_area(Rs=resting(model))
        places = here.draw(50, np.random.default_rng(0))
        for place, T in zip(places, here.poses(model, places), strict=True):
            vertices = se3.apply(T, model.vertices)
            assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-9)
            assert se3.apply(T, model.center_object[None])[0, :2] == pytest.approx(place[:2])
        assert here.contains(places).all()
        assert not here.contains(places + np.array([1.0, 0, 0, 0])).any()


def test_on_a_tilted_table_an_object_stands_along_its_normal():
    level = search_area()
    R = se3.rotation_exp(np.array([0.03, -0.02, 0.0]))
    tilted = Area(level.low, level.high, level.table, level.Rs_world_object, R)
    places = tilted.draw(20, np.random.default_rng(0))
    for T in tilted.poses(box(), places):
        assert (se3.apply(T, box().vertices) @ R[:, 2]).min() == pytest.approx(0.0, abs=1e-9)
    sweep = tilted.sweep(np.array([0.01, 0.02]), np.array([0.6, 0.8]), 0.05, 0.3)
    assert [sweep.at(x) @ R[:, 2] for x in (0.0, 0.6)] == pytest.approx([0.05, 0.05])


def test_a_box_rests_on_three_of_its_sides_and_a_can_on_its_end_or_its_side():
    heights = {round(float(height), 3) for height in search_area(Rs=resting(box())).center_heights(box())}
    assert heights == {0.03, 0.045, 0.07}
    assert len(resting(box())) == 3
    heights_can = search_area(Rs=resting(can())).center_heights(can())
    assert sorted(heights_can) == pytest.approx([0.033, 0.0575], abs=2e-4)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"low": [0.2, 0.2]}, "area"),
        ({"high": [0.2]}, "area.high"),
        ({"table": 0.0}, "area.table"),
        ({"Rs_world_object": np.zeros((0, 3, 3))}, "area.Rs_world_object"),
        ({"Rs_world_object": 2 * np.eye(3)[None]}, "area.Rs_world_object[0]"),
    ],
)
def test_an_invalid_field_of_an_area_is_named(given, field):
    usual = {"low": [-0.1, -0.1], "high": [0.1, 0.1], "table": Table(height=0.0)}
    with refused(InvalidInput, field):
        Area(**{**usual, "Rs_world_object": np.eye(3)[None], **given})


def test_a_cloud_has_no_stable_poses():
    cloud = hs.ObjectModel.from_points(*can().sample(500, 0))
    with refused(InvalidInput, "model"):
        resting(cloud)
