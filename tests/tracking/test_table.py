"""Laws of the table as evidence: it says how an object rests, and is withdrawn where touch contradicts it."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.rig import Table
from handsight.tracking.smoother import PoseAndBias
from handsight.tracking.table import on_table

BOX = hs.ObjectModel.box([0.06, 0.09, 0.14])


def known(T_palm_object, covariance):
    return PoseAndBias(np.stack([T_palm_object, np.eye(4)]), covariance)


@pytest.mark.parametrize("turn", [np.zeros(3), np.array([0, np.pi / 2, 0]), np.array([np.pi, 0, 0])])
def test_a_table_fixes_height_and_tilt_of_whatever_side_is_down(turn):
    side = [0.03, 0.045, 0.07][np.abs(se3.rotation_exp(turn)[2]).argmax()]
    T_world_palm = se3.compose(se3.rotation_exp(np.array([0.3, -0.7, 1.0])), np.array([0.1, 0.0, 0.6]))
    T_world_true = se3.compose(se3.rotation_exp(turn), np.array([0.2, 0.1, 0.4 + side]))
    off = np.array([0.03, -0.02, 0.04, 0.05, -0.04, 0.2])
    T = se3.inverse(T_world_palm) @ se3.moved(T_world_true, off)
    prior = known(T, np.diag([0.05**2] * 3 + [0.15**2] * 3 + [1.0] * 6))
    after = on_table(prior, BOX, Table(height=0.4), T_world_palm)
    delta = se3.difference(T_world_palm @ after.T_palm_object, T_world_true)
    np.testing.assert_allclose(delta[[2, 3, 4]], 0, atol=4e-3)
    np.testing.assert_allclose(delta[:2], off[:2], atol=2e-3)


def test_an_object_in_the_air_is_not_put_on_the_table():
    T = se3.compose(np.eye(3), np.array([0.0, 0.0, 0.5]))
    prior = known(T, np.diag([0.02**2] * 3 + [0.1**2] * 3 + [1.0] * 6))
    assert on_table(prior, BOX, Table(height=0.0), np.eye(4)) is None
