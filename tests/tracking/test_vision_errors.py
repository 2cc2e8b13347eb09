"""Vision's error has a constant part, one that drifts, and a latency: none of them makes an answer worse than said."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.simulation import Scenario, model_of, rig_of
from handsight.tracking import Tracker
from handsight.tracking.measurements import VisionUpdate

ROOT = Path(__file__).resolve().parents[2]
SHIFTS = -0.02, 0.004
"""Of the grasps of two boxes [m]: outwards as far as a third of its width; inwards the palm is in the way."""


def delayed(observations, count):
    """The same observations, with vision's poses so many observations later, by their stamps taken then."""
    poses = [None] * count + [o.vision for o in observations]
    return [replace(o, vision=vision) for o, vision in zip(observations, poses, strict=False)]


def drifting(observations, seed):
    """The same observations, with a random walk of vision's error: 4 mm and 1.5° in a second."""
    rng, off, found, last = np.random.default_rng(seed), np.zeros(6), [], observations[0].stamp
    for o in observations:
        off = off + np.sqrt(o.stamp - last) * rng.normal(size=6) * np.repeat([0.004, np.deg2rad(1.5)], 3)
        last = o.stamp
        if o.vision is not None:
            o = replace(o, vision=replace(o.vision, T_frame_object=se3.moved(o.vision.T_frame_object, off)))
        found.append(o)
    return found


def slid(sample, shift):
    """The same sample, of a box that the hand has grasped that far [m] from its middle, along its faces.

    Flat faces touch the tips alike wherever they are grasped; simulated hands grasp the middle, where an answer that
    knows nothing of the slide is right by chance.
    """
    S, o = se3.compose(np.eye(3), np.array([shift, 0.0, 0.0])), sample.observation
    if o.vision is not None:
        o = replace(o, vision=replace(o.vision, T_frame_object=o.vision.T_frame_object @ S))
    return replace(sample, observation=o, T_palm_object=sample.T_palm_object @ S)


def run(scenario, samples, observations):
    """Errors of the middle [m] and χ², in the last two thirds of a manipulation, and the tracker at its end.

    The rig has the drift that a camera has by default, of which nothing is declared.
    """
    model, rig = model_of(scenario), rig_of(scenario)
    camera = replace(rig.camera, sigma_position_correlated=None, sigma_rotation_correlated=None)
    tracker, errors, chi2 = Tracker(replace(rig, camera=camera), model), [], []
    for sample, observation in zip(samples, observations, strict=True):
        estimate = tracker.update(observation)
        if observation.stamp < 6:
            continue
        T = model.nearest(sample.T_palm_object, estimate.T_palm_object)
        off = se3.difference(estimate.T_palm_object, T)
        errors.append(np.linalg.norm((estimate.T_palm_object - T) @ np.append(model.center_object, 1)))
        chi2.append(off @ estimate.information @ off)
    return np.mean(errors), np.mean(np.array(chi2) < 12.6), tracker


@pytest.fixture(scope="module")
def errors(simulated, made_once):
    """`errors(name)`: what `measured` answers, computed by one worker."""
    return lambda name: made_once(f"errors of vision, {name}", lambda: measured(name, simulated))


def measured(name, simulated):
    """Mean errors [m] and shares inside the 95 % region (of some manipulations), by how vision is wrong."""
    rows = {row: [] for row in ("usual", "first", "late", "drift")}
    for seed in range(2 if name == "box" else 5):  # one run differs from another by half a millimetre
        scenario = Scenario(object=name, seed=seed, motion="manipulate", rate=50)
        shift = SHIFTS[seed] if name == "box" else 0.0
        samples = [slid(sample, shift) for sample in simulated(scenario)]
        usual = [sample.observation for sample in samples]
        first = [o if o.stamp <= 1 else replace(o, vision=None) for o in usual]
        cases = {"usual": usual, "first": first, "late": delayed(usual, 9), "drift": drifting(usual, seed)}
        for row, observations in cases.items():
            error, inside, tracker = run(scenario, samples, observations)
            rows[row].append((error, inside))
            if row in ("usual", "late"):
                latency, sigma = tracker.vision_latency()
                true = 0.2 if row == "late" else 0.02  # the simulator's own is 20 ms
                assert abs(latency - true) < max(0.02, 3 * sigma), (name, seed, row)
    return tuple({row: np.mean(rows[row], axis=0)[k] for row in rows} for k in range(2))


@pytest.mark.slow
def test_latency_and_drift_of_vision_are_covered(errors):
    """χ² of six numbers is below 12.6 in 95 %. One fifth of a second late, vision is 8 mm wrong where nothing tells."""
    both = [errors(name) for name in ("can", "box")]
    error, inside = ({row: np.mean([each[k][row] for each in both]) for row in both[0][k]} for k in range(2))
    assert error["late"] <= 1.5 * error["usual"]
    assert min(inside.values()) >= 0.92, inside


@pytest.mark.slow
@pytest.mark.parametrize("name", ["can", "box"])
def test_more_vision_makes_no_answer_worse(name, errors):
    error, _ = errors(name)
    assert error["usual"] <= 1.1 * error["first"]


def poses(path):
    """Poses (n, 4, 4) of a file of quaternions and positions, and which were detected."""
    rows = np.loadtxt(path)
    found = np.linalg.norm(rows[:, :4], axis=1) > 0.5
    Ts = np.tile(np.eye(4), (len(rows), 1, 1))
    Ts[found] = [se3.from_position_quaternion(row[4:7], row[[1, 2, 3, 0]]) for row in rows[found]]
    return Ts, found


def test_published_estimators_share_most_of_their_error_from_image_to_image():
    """Of objects without symmetry: the covariance of successive key frames' errors, less each sequence's mean."""
    folder = Path(os.environ.get("HANDSIGHT_DATA", ROOT.parent / "shared" / "data")) / "ycbv_vision_poses"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there: set HANDSIGHT_DATA to the folder with the test data")
    for method in ("cosypose", "posecnn_rss2018", "sundermeyer", "posecnn_icp_rss2018"):
        shared, total = np.zeros(2), np.zeros(2)
        for path in sorted((folder / "ground_truth").glob("*mustard*")) + sorted(
            (folder / "ground_truth").glob("*sugar*")
        ):
            (true, _), (vision, found) = poses(path), poses(folder / method / path.name)
            off = se3.difference(vision, true)
            good = found & (np.linalg.norm(off[:, :3], axis=1) < 0.08)
            good &= np.linalg.norm(off[:, 3:], axis=1) < np.deg2rad(60)
            off -= off[good].mean(axis=0)
            both = good[1:] & good[:-1]
            for k in range(2):
                part = off[:, 3 * k : 3 * k + 3]
                shared[k] += (part[1:] * part[:-1])[both].sum()
                total[k] += (part[1:] ** 2)[both].sum()
        ratio = np.sqrt(shared / (total - shared))
        assert (ratio > 0.8).all(), (method, ratio)
        assert (ratio < 3.2).all(), (method, ratio)


def test_a_rejected_pose_is_not_where_vision_starts_anew(can):
    """One pose of ten is a quarter of a metre off: it is rejected, and a new start is from the one before it."""
    T = can.T_palm_object
    vision, smoother = VisionUpdate(can.rig, can.model), None
    for k in range(10):
        off = np.array([0.257 * (k == 9), 0, 0, 0, 0, 0])
        seen = hs.Observation(0.1 * k, vision=hs.PoseMeasurement(se3.moved(T, off), "palm"))
        vision, smoother = vision.updated(seen, smoother, None)
    assert vision.rejected == 1
    anew = vision.afresh().now.T_palm_object
    assert np.linalg.norm((anew - T)[:3, 3]) < 0.01
