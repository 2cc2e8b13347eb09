"""The demo's box, not seen after its first second: what its weight says once the hand has tilted it."""

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from experiments.tracking import weight


def test_the_weight_locates_the_box_after_the_tilt():
    """A box slides between two faces unnoticed by contacts: below 4 mm without vision."""
    mean, most = weight.after_the_tilt(weighed=True)
    assert most < 4e-3
    assert mean < 0.5 * weight.after_the_tilt(weighed=False)[0]
