"""Mistakes of a hand whose tips have taxels alone: shear, its axes and tables that are not as the rig says."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from handsight import se3
from handsight.contact import Sphere, TactileSurface
from handsight.hand import Hand
from handsight.observation import Observation
from handsight.rig import Finger, Rig, Topics
from handsight.tracking.consistency import Excerpt
from handsight.tracking.mistakes import find_mistakes

pytest.importorskip("mujoco")
NAMES = "index", "middle", "thumb"
REACH, HEIGHT = 0.03, 0.05  # of the tips from the object's middle, and of the pads above their joints [m]
WEIGHT, SQUEEZE = 0.2 * 9.81, 3.0  # of the object, and of each tip [N]
FINGER = """<link name="{name}"/><joint name="{name}_joint" type="revolute"><parent link="palm"/><child link="{name}"/>
<origin xyz="{x} {y} 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Three fingers about an object, with a flat pad of 4 x 4 three-axis taxels each, which faces it."""
    angles = {name: 2 * np.pi * k / 3 for k, name in enumerate(NAMES)}
    places = {name: [np.cos(a) * (REACH + 0.01), np.sin(a) * (REACH + 0.01)] for name, a in angles.items()}
    links = "".join(FINGER.format(name=n, x=x, y=y) for n, (x, y) in places.items())
    path = tmp_path_factory.mktemp("hand") / "three.urdf"
    path.write_text(f'<robot name="three"><link name="palm"/>{links}</robot>')
    skin = {}
    for name, angle in angles.items():
        inward = -np.array([np.cos(angle), np.sin(angle), 0.0])
        along = np.array([0.0, 0.0, 1.0])
        R = np.column_stack([np.cross(along, inward), along, inward])
        T = se3.compose(R, 0.01 * inward + HEIGHT * along)
        fields = {"rows": 4, "columns": 4, "pitch": 0.003, "threshold": 0.05, "components": 3}
        skin[name] = TactileSurface.grid(frame=name, T_frame_grid=T, **fields)
    T = se3.compose(np.eye(3), np.array([0, 0, HEIGHT]))
    return Rig(
        hand=Hand.from_file(path, palm="palm", tips={name: name for name in NAMES}),
        fingers={name: Finger(frame=name, T_frame_surface=T, tip=Sphere(0.01)) for name in NAMES},
        skin=skin,
        topics=Topics(skin={name: f"/{name}" for name in NAMES}),
    )


@pytest.fixture(scope="module")
def observations(rig):
    """The open hand, then one that has lifted the object and turns it about."""
    rng = np.random.default_rng(0)
    found = []
    for k in range(60):
        held = k >= 12
        turn = rng.normal(size=3) if k >= 14 else np.zeros(3)
        T = se3.compose(se3.rotation_exp(turn), np.array([0, 0, 0.1 * (k >= 14)]))
        weight = T[:3, :3].T @ [0, 0, -WEIGHT] * (k >= 14)
        skin = {}
        for name, surface in rig.skin.items():
            axes = surface.layout.T_frame_grid[:3, :3]
            force = (
                weight / 3 - SQUEEZE * axes[:, 2]
            ) * held  # of the object on the tip; the pad faces the object
            parts = force @ axes * [1, 1, -1]
            pressure = np.linspace(0.5, 1.5, 16).reshape(4, 4, 1) / 16
            skin[name] = pressure * parts + 2e-3 * rng.normal(size=surface.shape)
        joints = dict.fromkeys(rig.hand.joint_names, 0.0)
        found.append(Observation(1000 + 0.02 * k, joints, T_world_palm=T, skin=skin))
    return found


def said(rig, observations):
    excerpt = Excerpt(rig)
    for observation in observations:
        excerpt.put(observation, touched=False)
    named, unexplained = find_mistakes(excerpt)
    return [*map(str, named), *filter(None, [unexplained])]


def shear(turn, reading):
    """The reading of a driver whose shear (x, y) is another by `turn` (2, 2)."""
    return np.concatenate([reading[..., :2] @ np.transpose(turn), reading[..., 2:]], axis=-1)


def each(change, names=NAMES):
    def changed(observation):
        skin = {n: change(reading) if n in names else reading for n, reading in observation.skin.items()}
        return replace(observation, skin=skin)

    return changed


WRONG = {
    "the other sign of the taxels' shear of all fingers": each(partial(shear, [[-1, 0], [0, -1]])),
    "the other sign of the taxels' shear along y of all fingers": each(partial(shear, [[1, 0], [0, -1]])),
    "the taxels' x turned by 90° of all fingers": each(partial(shear, [[0, 1], [-1, 0]])),
    "the taxels' x turned by -90° of all fingers": each(partial(shear, [[0, -1], [1, 0]])),
    "the taxels' x and y exchanged of all fingers": each(partial(shear, [[0, 1], [1, 0]])),
    "the other sign of the taxels' shear of thumb": each(partial(shear, [[-1, 0], [0, -1]]), ["thumb"]),
    "the taxels' x turned by 90° of thumb": each(partial(shear, [[0, 1], [-1, 0]]), ["thumb"]),
}


def test_nothing_is_named_of_taxels_that_are_as_the_rig_says(rig, observations):
    assert said(rig, observations) == []


FAST = "the taxels' x turned by 90° of thumb"


@pytest.mark.parametrize(
    "what", [pytest.param(what, marks=[] if what == FAST else pytest.mark.slow) for what in WRONG]
)
def test_a_wrong_sign_turn_or_order_of_taxels_is_named(rig, observations, what):
    sentences = said(rig, map(WRONG[what], observations))
    assert len(sentences) == 1, sentences
    assert sentences[0].startswith(f"{what} fits better")


@pytest.mark.parametrize("wrong", [["thumb"], ["index", "thumb"], NAMES])
def test_taxels_that_read_less_where_they_are_pressed_are_named(rig, observations, wrong):
    excerpt = Excerpt(rig)
    for observation in map(each(np.negative, wrong), observations):
        excerpt.put(observation, touched=False)
    [found], unexplained = find_mistakes(excerpt)
    assert found.what == "the other sign of the taxels' readings"
    assert set(found.fixes) == set(wrong)
    assert not unexplained
