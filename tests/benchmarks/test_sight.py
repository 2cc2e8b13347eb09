"""The benchmark of sight judges everyone alike, and its peers find what they are shown."""

import numpy as np
import pytest

from benchmarks import peers, sight
from handsight import ObjectModel, se3
from handsight.vision.object.region import scene_of
from testbed import sight_scenes as scenes


def rows(right, seconds, hidden="table"):
    """Rows of both peers: whether right, and how long."""
    return [
        {"hidden": hidden, "peer": peer, "right": r, "seconds": s}
        for peer, rs, ss in zip(("ours", "open3d_fpfh"), right, seconds, strict=True)
        for r, s in zip(rs, ss, strict=True)
    ]


def test_the_bin_with_the_smallest_lead_counts():
    found = rows([[1, 1], [1, 0]], [[1, 1], [9, 9]]) + rows([[1, 0], [1, 0]], [[1, 1], [9, 9]], "hand")
    assert sight.ahead(found, "open3d_fpfh") == 0
    assert sight.ratio(found, "open3d_fpfh")["ratio"] == 9


def test_a_target_that_a_missing_peer_leaves_open_says_so(capsys):
    sight.judge({"first": [], "then": []})
    assert capsys.readouterr().err.count("not measured") == 4


@pytest.mark.parametrize("name", peers.FIRST_POSES)
def test_each_peer_finds_an_object_that_stands_alone(name):
    made, missing = peers.made([name], peers.FIRST_POSES)
    if name in missing:
        pytest.skip(missing[name])
    model = ObjectModel.from_mesh(*scenes.letter())
    rng = np.random.default_rng(4)
    T = se3.compose(se3.random(rng)[:3, :3], np.array([0.02, -0.03, 0.45]))
    depth = scenes.WIDE.draw(se3.apply(T, model.vertices), model.faces).depth
    scene = scene_of(scenes.WIDE, np.nan_to_num(depth, posinf=0), wanted=np.isfinite(depth))
    made[name].prepare(model)
    found = made[name].ready(scene)()
    assert scenes.adds(model, T, found[None])[0] < sight.RIGHT
