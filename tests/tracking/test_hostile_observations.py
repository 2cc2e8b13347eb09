"""A tracker that is given many invalid observations among good ones: its state and its counts stay right."""

import random
from dataclasses import replace

import numpy as np
import pytest

import handsight as hs
from handsight import checks, se3
from handsight.errors import InvalidInput
from handsight.observation import PoseMeasurement
from tracking.gripper import BOX, gripper, observed

UPDATES = 1_500
NAN, ROTATED = np.full((4, 4), np.nan), se3.compose(se3.rotation_exp(np.array([0.3, 0.2, 1.0])), np.zeros(3))
BAD = [
    *({"T_world_palm": T} for T in (NAN, 2 * np.eye(4), np.diag([1.0, 1, -1, 1]), np.eye(3), "palm", 1e200 * ROTATED)),
    *({"wrenches": {"left": wrench}} for wrench in (np.zeros(5), np.full(6, 1e20), "six", None, np.eye(6), [True] * 6)),
    *({"wrenches": wrenches} for wrenches in (None, [1.0], "left")),
    *({"stamp": stamp} for stamp in (np.nan, np.inf, None, "1", True, 1.7e18, 10**400, [0.0])),
    *({"joint_positions": joints} for joints in ({}, [0.0], {"left": np.nan, "right": 0.0})),
    *({"joint_positions": {"left": q, "right": 0.0}} for q in (1e20, "0", None, [0.0], np.inf)),
    *({"vision": vision} for vision in (np.eye(4), 1.0, "seen")),
]  # fmt: skip


class Life:
    """Observations in turn, and what a tracker should make of them."""

    def __init__(self, seed):
        self.rng, self.tracker = random.Random(seed), hs.Tracker(gripper(), BOX)
        self.stamp, self.touching = 0.0, False
        self.taken = self.measured_at = self.touched_at = -np.inf
        self.late = self.refused = self.left_out = 0
        self.poses, self.covariances = [], []
        """That were answered."""

    def good(self, stamp):
        """One that a robot may send: hardly ever something new is touched, for that costs the most."""
        rng = self.rng
        if rng.random() < 0.01:
            self.touching = not self.touching
        seen = observed(stamp, touching=self.touching, visible=rng.random() < 0.05, T_world_palm=self.palm())
        kind = rng.random()
        if kind < 0.02:
            return replace(seen, wrenches={"left": np.full(6, np.nan)})
        if kind < 0.04:
            return replace(seen, T_world_palm=None)
        if kind < 0.05:
            return replace(seen, joint_positions=None)
        return seen

    def palm(self):
        """It drifts."""
        T = se3.compose(se3.rotation_exp(np.array([0.0, 0.0, 1e-4 * self.stamp % 1.0])), np.zeros(3))
        T[0, 3] = 0.1
        return T

    def take(self, stamp):
        """One that is taken."""
        given = self.good(stamp)
        answered = self.tracker.update(given)
        assert self.tracker.stamp == stamp
        assert answered is self.tracker.estimate
        if given.joint_positions is not None and (given.wrenches["left"][2] < -0.1):
            self.measured_at = self.touched_at = stamp
        elif given.vision is not None:  # it may yet be beyond the gate
            self.measured_at = stamp
        self.taken, self.left_out = stamp, 0
        # Nothing of the caller's is kept.
        if given.T_world_palm is not None:
            given.T_world_palm[:] = np.nan
        for wrench in given.wrenches.values():
            if isinstance(wrench, np.ndarray):
                wrench[:] = np.nan

    def leave(self, stamp):
        """One that is late."""
        before = self.tracker.estimate
        assert self.tracker.update(self.good(stamp)) is before
        self.late, self.left_out = self.late + 1, self.left_out + 1

    def hold(self, stamp):
        """One whose stamp jumped, and is used with the next one."""
        given = self.good(stamp)
        before = self.tracker.stamp
        self.tracker.update(given)
        assert self.tracker.stamp == before
        if given.joint_positions is not None and given.wrenches["left"][2] < -0.1:
            self.measured_at = self.touched_at = stamp
        elif given.vision is not None:
            self.measured_at = stamp

    def refuse(self):
        """One that is wrong in itself."""
        before = self.tracker.estimate
        with pytest.raises(InvalidInput):
            self.tracker.update(replace(self.good(self.stamp + 0.01), **self.rng.choice(BAD)))
        assert self.tracker.estimate is before
        self.refused, self.left_out = self.refused + 1, self.left_out + 1

    def take_wild(self, stamp):
        """One whose vision is as far off as it may be: taken, or with all that is known out of all bounds."""
        sigmas = np.array([10 ** self.rng.uniform(-9, 3) for _ in range(6)])
        place = np.array([self.rng.uniform(-6.0, 6.0) for _ in range(3)])
        vision = PoseMeasurement(se3.compose(ROTATED[:3, :3], place), "world", np.diag(sigmas**2))
        try:
            self.tracker.update(
                replace(observed(stamp, touching=False, T_world_palm=self.palm()), vision=vision)
            )
        except InvalidInput:
            self.refused, self.left_out = self.refused + 1, self.left_out + 1
        else:
            self.taken, self.measured_at, self.left_out = stamp, stamp, 0

    def live(self):
        """A few observations; how many."""
        rng, kind, step = self.rng, self.rng.random(), 0.01
        self.stamp = (self.taken if np.isfinite(self.taken) else 0.0) + step
        if kind < 0.02:  # one far ahead
            self.leave(self.stamp + 10 ** rng.uniform(0.5, 9))
            self.take(self.stamp)
        elif kind < 0.022:  # the sensors pause
            self.stamp += 10 ** rng.uniform(0.5, 4)
            self.hold(self.stamp)
            self.stamp += step
            self.take(self.stamp)
        elif kind < 0.03:  # one far back
            self.leave(self.stamp - 10 ** rng.uniform(0.1, 9))
            self.take(self.stamp)
        elif kind < 0.032:  # the clock is set back
            self.stamp -= 10 ** rng.uniform(0.5, 5)
            self.measured_at = self.touched_at = -np.inf
            self.hold(self.stamp)
            self.stamp += step
            self.take(self.stamp)
            assert "the clock went back by" in self.tracker.reason
        elif kind < 0.05:  # out of order
            self.leave(self.stamp - step - rng.uniform(1e-6, 0.9))
            self.take(self.stamp)
        elif kind < 0.06:
            self.take_wild(self.stamp)
            return 1
        elif kind < 0.25:
            self.refuse()
            return 1
        elif kind < 0.2505:
            for _ in range(150):
                self.refuse()
            return 150
        else:
            self.take(self.stamp)
            return 1
        return 2

    def check(self):
        """What the tracker says of itself is what has come of what it was given."""
        tracker = self.tracker
        if (estimate := tracker.estimate) is None:
            assert tracker.state == "lost"
        else:
            self.poses.append(estimate.T_palm_object)
            if estimate.covariance is not None:
                self.covariances.append(estimate.covariance)
        assert (tracker.reason == "") == (tracker.state == "tracking")
        assert (tracker.late, tracker.refused) == (self.late, self.refused)
        assert tracker.stamp == self.taken
        if self.left_out >= 100:
            assert (tracker.state, "in a row" in tracker.reason) == ("lost", True)
        elif tracker.stamp - self.measured_at > tracker.settings.lost_after:
            assert tracker.state == "lost"
        elif tracker.state == "tracking":
            assert tracker.stamp - self.touched_at <= 0.2  # so long a grasp outlives its contacts
            assert tracker.estimate.consistent
            assert tracker.sigma <= tracker.settings.uncertain_position


@pytest.mark.slow
def test_a_tracker_stays_right_through_many_updates_with_invalid_ones_among_them():
    life, updates = Life(0), 0
    while updates < UPDATES:
        updates += life.live()
        life.check()
    assert life.late > UPDATES / 50
    assert life.refused > UPDATES / 10
    assert life.tracker.corrections > UPDATES / 1000
    Ts, covariances = np.array(life.poses), np.array(life.covariances)
    assert np.abs(Ts[:, :3, 3]).max() <= 1000
    np.testing.assert_allclose(
        Ts[:, :3, :3] @ Ts[:, :3, :3].swapaxes(1, 2), np.tile(np.eye(3), (len(Ts), 1, 1)), atol=1e-6
    )
    checks.covariance(covariances, "covariances", (None, 6, 6))
    assert len(covariances) > UPDATES / 2
