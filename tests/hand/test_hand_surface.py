"""Points on the hand's links lie on their shapes, spread by area, and move with them."""

import numpy as np
import pytest
import trimesh

from hand.hands import ROBOT, SHADOW_TIPS, shadow_file, within_limits
from handsight import se3
from handsight.errors import InvalidInput
from handsight.hand import Hand
from testbed.refusals import refused

GOOD = {"knuckle": 0.5, "jaw": 0.01}


def depths_in_convex(mesh, points):
    """How far points are beneath the nearest of a convex mesh's planes."""
    corners = mesh.triangles
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return -np.einsum("mfi,fi->mf", points[:, None] - corners[None, :, 0], normals).max(axis=1)


def test_points_lie_as_deep_in_the_shapes_as_asked(robot):
    found = robot.surface(400, shrink=0.002)
    assert found.bodies == ("mount", "turning", "sliding")
    assert found.points_body.shape == found.normals.shape == (400, 3)
    shapes = [
        trimesh.creation.box((0.06, 0.04, 0.02), transform=se3.compose(np.eye(3), np.array([0, 0, 0.01]))),
        trimesh.creation.cylinder(0.008, 0.04, transform=se3.compose(np.eye(3), np.array([0, 0, 0.02]))),
        trimesh.creation.capsule(0.0, 0.01),
    ]
    for i, shape in enumerate(shapes):
        mine = found.body_of == i
        surface = found.points_body[mine] + 0.002 * found.normals[mine]
        np.testing.assert_allclose(
            depths_in_convex(shape, surface), 0, atol=1e-8
        )  # MuJoCo's meshes are float32
        depths = depths_in_convex(shape, found.points_body[mine])
        # Nearer than asked for only by an edge.
        assert depths.min() > 0
        assert depths.max() < 0.002 + 1e-8
        assert np.median(depths) > 0.0019


def test_points_are_spread_evenly_by_area(robot):
    found = robot.surface(2000, shrink=0.0)
    areas = np.array(
        [2 * (0.06 * 0.04 + 0.06 * 0.02 + 0.04 * 0.02), 2 * np.pi * 0.008 * 0.048, 4 * np.pi * 0.01**2]
    )
    np.testing.assert_allclose(np.bincount(found.body_of), 2000 * areas / areas.sum(), atol=12)
    box = found.points_body[found.body_of == 0]
    top = box[box[:, 2] > 0.02 - 1e-9]
    np.testing.assert_allclose(
        np.histogram(top[:, 0], bins=4, range=(-0.03, 0.03))[0] / len(top), 0.25, atol=0.06
    )


def test_points_move_with_their_links(robot):
    found, positions = robot.surface(60), {**GOOD, "knuckle": 1.1}
    bodies = dict(zip(found.bodies, found.bodies, strict=True))
    by_body = Hand.from_file(robot.file, palm="palm", tips=bodies).Ts_palm_tip(positions)
    Ts = by_body[found.body_of]
    expected = np.einsum("mij,mj->mi", Ts[:, :3, :3], found.points_body) + Ts[:, :3, 3]
    np.testing.assert_allclose(found.points_palm(positions), expected, atol=1e-14)
    with refused(InvalidInput, "joint_positions"):
        found.points_palm({"knuckle": 1.1})


def test_the_hand_is_the_palm_and_what_is_fixed_to_it_and_hangs_on_it(shadow_hand, robot_file):
    bodies = shadow_hand.surface(500).bodies
    assert "robot0:palm" in bodies
    assert not {"robot0:wrist", "robot0:forearm", "floor0", "world"} & set(bodies)
    # The way up ends at the first joint: what the slide carries is the hand, the arm is not.
    robot_file.write_text(
        ROBOT.replace(
            '<link name="arm"/>',
            '<link name="arm"><visual><geometry><sphere radius="1"/></geometry></visual></link>',
        )
    )
    assert Hand.from_file(robot_file, palm="palm").surface(300).bodies == ("mount", "turning", "sliding")


def test_bodies_can_be_left_out(shadow_hand, rng):
    tips = set(SHADOW_TIPS.values())
    assert tips <= set(shadow_hand.surface(400).bodies)
    found = shadow_hand.surface(400, without=tips)
    assert not tips & set(found.bodies)
    assert len(found.points_palm(within_limits(shadow_hand, rng))) == 400
    with refused(InvalidInput, "without"):
        shadow_hand.surface(400, without=["ffdistal"])


def test_the_shadow_hands_points_are_inside_its_collision_shapes(shadow_hand, rng):
    """By MuJoCo's own distance to the shapes of each point's link."""
    mujoco = pytest.importorskip("mujoco")
    found = shadow_hand.surface(300, shrink=0.001)
    spec = mujoco.MjSpec.from_file(str(shadow_file()))
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    probe.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-6, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    positions = within_limits(shadow_hand, rng)
    for name, value in positions.items():
        data.joint(name).qpos[:] = value
    points = se3.apply(shadow_hand.T_world_palm(positions), found.points_palm(positions))
    depths = []
    for i in range(0, 300, 5):
        data.mocap_pos[0] = points[i]
        mujoco.mj_kinematics(model, data)
        body = model.body(found.bodies[found.body_of[i]])
        geoms = range(body.geomadr[0], body.geomadr[0] + body.geomnum[0])
        touching = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]] or geoms
        probe = model.geom("probe").id
        depths.append(-min(mujoco.mj_geomDistance(model, data, probe, g, 1.0, None) for g in touching))
    # By an edge the side is nearer; shapes overlap, and facets are a little inside what is round.
    assert min(depths) > 0
    assert np.mean(np.array(depths) > 0.0009) > 0.9
    assert np.median(depths) == pytest.approx(0.001, abs=1e-4)


ALL_SHAPES = """<mujoco><worldbody><geom type="plane" size="1 1 .1"/><body name="palm">
  <geom type="sphere" size=".01"/><geom type="capsule" size=".01 .02" pos=".1 0 0"/>
  <geom type="ellipsoid" size=".01 .02 .03" pos=".2 0 0" euler="0 90 0"/>
  <geom type="cylinder" size=".01 .02" pos=".3 0 0"/><geom type="box" size=".01 .02 .03" pos=".4 0 0"/>
</body></worldbody></mujoco>"""


def test_every_kind_of_shape_is_sampled_where_it_stands(tmp_path):
    (tmp_path / "r.xml").write_text(ALL_SHAPES)
    found = Hand.from_file(tmp_path / "r.xml", palm="palm").surface(20000, shrink=0.0)
    half = {
        0: (0.01,) * 3,
        1: (0.01, 0.01, 0.03),
        2: (0.03, 0.02, 0.01),
        3: (0.01, 0.01, 0.02),
        4: (0.01, 0.02, 0.03),
    }
    for k, size in half.items():
        mine = np.abs(found.points_body[:, 0] - 0.1 * k) < 0.05
        points, normals = found.points_body[mine] - [0.1 * k, 0, 0], found.normals[mine]
        np.testing.assert_allclose(np.abs(points).max(axis=0), size, atol=5e-4)
        assert (np.einsum("mi,mi->m", points, normals) > 0).all()


@pytest.mark.parametrize(
    ("call", "field"),
    [
        ({"count": -1}, "count"),
        ({"count": 2.5}, "count"),
        ({"count": True}, "count"),
        ({"count": 5, "shrink": np.nan}, "shrink"),
        ({"count": 5, "without": ["turnin"]}, "without"),
    ],
)
def test_what_cannot_be_sampled_is_refused(robot, call, field):
    with refused(InvalidInput, field):
        robot.surface(**call)
