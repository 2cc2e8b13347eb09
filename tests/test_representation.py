"""What a terminal shows of handsight: values in a few lines, signatures and names that can be read."""

import pydoc
from pathlib import Path

import numpy as np
import pytest

import handsight as hs
from handsight.gaussian_pose import GaussianPose
from handsight.simulation import Scenario, rig_of

CAN = hs.ObjectModel.cylinder(radius=0.033, height=0.115)
RNG = np.random.default_rng(0)
CONTACTS = hs.Contacts(RNG.random((50, 3)), RNG.normal(size=(50, 3)), sigma_point=1e-3, sigma_normal=0.1)
VISION = hs.PosePrior.from_sigmas(np.eye(4), 0.01, 0.1)


def values():
    rig = rig_of(Scenario(object="can"))
    tracker, estimate = hs.Tracker(rig, CAN), hs.correct_pose(CAN, CONTACTS, vision=VISION)
    camera = hs.Camera(np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), (640, 480))
    return [
        *(
            CAN,
            CONTACTS,
            VISION,
            estimate,
            estimate.hypotheses[0],
            estimate.residuals,
            rig,
            rig.camera,
            rig.hand,
        ),
        *(*rig.fingers.values(), tracker, tracker.track_state, camera, hs.PoseMeasurement(np.eye(4))),
        hs.Observation(1.0, dict.fromkeys(map(str, range(40)), 0.1), dict.fromkeys("abcdef", np.zeros(6))),
        *(hs.Outside(np.zeros((200, 3))), hs.Plane([0, 0, 0], [0, 0, 1], 1e-3), hs.Sphere(0.01)),
        hs.WeightEvidence([0, 0, 0], [0, 0, 0], 1e-6 * np.eye(3)),
        GaussianPose(np.eye(4), np.eye(6)),
    ]


def test_a_public_value_is_shown_in_ten_lines_without_its_record():
    for value in values():
        shown = repr(value)
        assert type(value).__name__ in shown
        assert len(shown.splitlines()) <= 10
        assert len(shown) <= 1000
        assert not [word for word in ("dtype", "record", " at 0x") if word in shown]


def test_a_pose_is_shown_by_position_and_angle_and_a_default_is_left_out():
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = (0.01, -0.02, 0.3), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    assert repr(hs.PoseMeasurement(T)) == (
        "PoseMeasurement(T_frame_object=<[0.01, -0.02, 0.3] m, turned 90°>, frame='camera')"
    )


@pytest.mark.parametrize(
    "function", [hs.correct_pose, hs.contact_from_wrench, hs.Contacts, hs.PosePrior.from_sigmas]
)
def test_help_shows_array_like_and_nothing_of_what_numpy_means_by_it(function):
    shown = pydoc.plain(pydoc.render_doc(function)).splitlines()
    assert "ArrayLike" in "".join(shown[:12])
    assert "_NestedSequence" not in "".join(shown)


def test_names_are_listed_and_each_is_in_the_manual_s_table():
    page = (Path(__file__).parents[1] / "docs/api.md").read_text(encoding="utf-8").split("```")[0]
    assert dir(hs) == sorted(dir(hs))
    for name in dir(hs):
        assert getattr(hs, name) is not None
        assert f"`{name}`" in page or f"`hs.{name}`" in page or name == "__version__"
