import numpy as np
import pytest

from hand.hands import ROBOT, ROBOT_TIPS, shadow
from handsight.hand import Hand


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.fixture(scope="session")
def shadow_hand():
    return shadow()


@pytest.fixture
def robot_file(tmp_path):
    path = tmp_path / "two_fingers.urdf"
    path.write_text(ROBOT)
    return path


@pytest.fixture
def robot(robot_file):
    pytest.importorskip("mujoco")
    return Hand.from_file(robot_file, palm="palm", tips=ROBOT_TIPS)
