"""Former public names work for one release, and a warning names the new one."""

import importlib
from types import SimpleNamespace

import numpy as np
import pytest

import handsight as hs
from handsight.gaussian_pose import GaussianPose

FORMER = {
    "handsight": ["PinholeCamera"],
    "handsight.rig": ["Camera", "ObjectEntry"],
    "handsight.blind": ["Area", "Belief", "Sweep", "Touch", "best_sweep", "candidates", "cast", "resting"],
    "handsight.dynamics": [
        "Carried",
        "Slip",
        "SlipDetector",
        "Unknowns",
        "Weigher",
        "Weighing",
        "slip_twist",
        "weigh",
    ],
    "handsight.vision": [
        "Found",
        "HandLook",
        "HandNotSeen",
        "SeenHand",
        "followed_hand",
        "seen_hand",
        "Drawn",
        "PinholeCamera",
    ],
    "handsight.messages": ["CameraIntrinsics"],
    "handsight.simulation": ["Found", "blind_rig", "looking", "simulate_blind"],
}


@pytest.mark.parametrize(("room", "name"), [(room, name) for room, names in FORMER.items() for name in names])
def test_a_former_name_is_the_new_object_and_says_its_name(room, name):
    module = importlib.import_module(room)
    with pytest.warns(
        DeprecationWarning, match=rf"^{room}\.{name} is now handsight\.\w+\.\w+; the old name"
    ) as caught:
        value = getattr(module, name)
    new = str(caught[0].message).split(" is now ")[1].split(";")[0]
    home, _, attribute = new.rpartition(".")
    assert value is getattr(importlib.import_module(home), attribute)
    assert caught[0].filename == __file__


@pytest.mark.parametrize("room", FORMER)
def test_what_never_was_is_an_attribute_error(room):
    with pytest.raises(AttributeError, match=f"module '{room}' has no attribute 'nothing'"):
        _ = importlib.import_module(room).nothing


MEMBERS = {
    "search.Area": {"holds": "contains", "middles": "center_heights", "tops": "top_heights"},
    "search.Belief": {"places": "placements"},
    "search.belief.Mode": {
        "sure": "is_certain",
        "weight": "probability",
        "prior": "pose_world_object",
        "T_world_object": "pose_world_object.T_a_b",
    },
    "forces.Weighing": {"chance": "p_value", "chance_fixed": "p_fixed"},
    "hand.HandSurface": {"placed": "points_and_sensitivities"},
    "vision.ObjectDetection": {"looks": "candidates"},
    "vision.PlacedHand": {"look": "appearance", "seen_from": "visible_from"},
    "vision.PalmDetection": {"look": "candidate"},
    "vision.Sighting": {"look": "candidate"},
    "vision.registration.Registered": {"seen": "visible"},
    "simulation.GraspSearchResult": {"held": "succeeded"},
    "gaussian_pose.GaussianPose": {"T_palm_object": "T_a_b"},
}


@pytest.mark.parametrize(
    ("path", "old", "new"), [(path, *pair) for path, names in MEMBERS.items() for pair in names.items()]
)
def test_a_former_attribute_is_the_new_one_and_says_its_name(path, old, new):
    room, _, name = path.rpartition(".")
    cls = getattr(importlib.import_module(f"handsight.{room}"), name)
    first, _, rest = new.partition(".")
    assert hasattr(cls, first) or first in cls.__dataclass_fields__
    value = object()
    # The attribute that the class looks up where it finds none; the rest of the class has its own tests.
    owner = SimpleNamespace(**{first: SimpleNamespace(**{rest: value}) if rest else value})
    with pytest.warns(DeprecationWarning, match=rf"^{name}\.{old} is now {name}\.{new}; the old name"):
        assert cls.__getattr__(owner, old) is value


def test_a_former_attribute_warns_where_it_is_used():
    pose = GaussianPose(np.eye(4), np.eye(6))
    with pytest.warns(DeprecationWarning, match=r"GaussianPose\.T_palm_object is now") as caught:
        assert pose.T_palm_object is pose.T_a_b
    assert caught[0].filename == __file__
    with pytest.raises(AttributeError, match="'GaussianPose' object has no attribute 'nothing'"):
        _ = pose.nothing


def test_former_keywords_work_and_warn_where_they_are_used():
    from handsight.rig import Table
    from handsight.search import Area, Sweep

    model = hs.ObjectModel.box((0.05, 0.06, 0.1))
    area = Area(np.zeros(2), np.ones(2), Table(height=0.0), np.eye(3)[None])
    placements = np.array([[0.5, 0.5, 0.1, 0.0]])
    sweep = Sweep(np.zeros(3), np.array([1.0, 0, 0]), 1.0)
    for call, old, new in (
        (lambda **key: area.poses(model, **key), {"places": placements}, {"placements": placements}),
        (lambda **key: sweep.part(end=0.5, **key).start_world, {"begin": 0.1}, {"start": 0.1}),
    ):
        with pytest.warns(
            DeprecationWarning, match=rf"\({next(iter(old))}=\) is now .*\({next(iter(new))}=\)"
        ) as caught:
            former = call(**old)
        assert caught[0].filename == __file__
        assert np.array_equal(former, call(**new))
