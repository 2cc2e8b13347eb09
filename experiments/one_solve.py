"""Sight as a pose with its covariance, or as depth points in one solve with the contacts: which measures better.

The end of simulated grasps of can and box (Shadow hand, exact models; everything SYNTHETIC). Where the object is
expected is drawn, and what is known by that is evidence for each; the last depth image is looked at from there, the
hand's pixels and a part of the object's, on one side, left out. Where the palm is in the camera is drawn with the seen
hand's error. Then the fingers' contacts are added in two ways, to the same evidence:

  pose      the image's pose and its covariance, with what was expected, are the prior of `correct_pose`
  points    48 of the depth points are in the same solve as evidence of their own (`hs.DepthPoints`); what was expected
            is the prior

Errors against the truth modulo symmetry; inside: truths in the 95 % region.
"""

import numpy as np

import handsight as hs
from from_pictures import OBJECTS, RATE, errors, grasped
from handsight import se3
from handsight.camera import Camera
from handsight.gaussian_pose import GaussianPose
from handsight.simulation import Nuisances, Sample, Scenario, model_of, rig_of, true_camera
from handsight.tracking import FingertipSensors
from handsight.vision.depth_noise import STRUCTURED_LIGHT
from handsight.vision.object.depth_tracker import DEPTH_TRACKER
from handsight.vision.object.pose_refiner import PoseRefiner, RefinedPose
from handsight.vision.palm.hand_in_image import HandInImage
from shared import report
from testbed.report import Array, Rows

WAYS = ("pose alone", "pose", "points")
COVERED = (0.0, 0.5, 0.8, 0.95)
EXPECTED = np.repeat([0.005, np.deg2rad(3)], 3)
"""How well the object is known before, per axis [m, rad]: as a tracker knows it once a finger has touched it."""
HAND = np.repeat([0.0015, np.deg2rad(0.6)], 3)
"""Sigma of the palm's pose in the camera, as estimated from images of the hand, per axis [m, rad]."""


def uncovered(depth: Array, drawn: Array, share: float, way: float) -> Array:
    """Returns the image without a share of the object's pixels at one side; `drawn` is where the object is."""
    rows, columns = np.nonzero(np.isfinite(drawn))
    side = columns * np.cos(way) + rows * np.sin(way)
    hidden = side <= np.quantile(side, share)
    out = depth.copy()
    if share:
        out[rows[hidden], columns[hidden]] = np.nan
    return out


def rows_of(scenario: Scenario, samples: tuple[Sample, ...]) -> Rows:
    """Returns the errors of both ways at the last image, for each covered share."""
    rig, model, rng = rig_of(scenario), model_of(scenario), np.random.default_rng(int(scenario.seed))
    last = next(sample for sample in reversed(samples) if sample.observation.depth is not None)
    touched, T = FingertipSensors(rig).contacts(last.observation).contacts, last.T_palm_object
    depth, T_world_palm = last.observation.depth, last.observation.T_world_palm
    if touched is None or depth is None or T_world_palm is None:
        return []
    camera = Camera.of(rig.camera)
    T_camera_world = true_camera(scenario)
    T_camera_palm = T_camera_world @ T_world_palm
    drawn = camera.draw(se3.apply(T_camera_palm @ T, model.vertices), model.faces).depth
    T_seen = se3.moved(T_camera_palm, HAND * rng.normal(size=6))
    joints, T_palm_camera = last.observation.joint_positions, se3.inverse(T_seen)
    mask = HandInImage(rig).mask(camera, depth, joints, T_seen)
    if mask is None:
        return []
    expected = hs.PosePrior(se3.moved(T, EXPECTED * rng.normal(size=6)), np.diag(EXPECTED**2))
    way, found = rng.uniform(0, 2 * np.pi), []
    for share in COVERED:
        image = np.where(mask, np.nan, uncovered(depth, drawn, share, way))
        candidate = PoseRefiner(model, camera, STRUCTURED_LIGHT)
        seen = candidate.at(T_seen @ expected.T_palm_object, np.diag(EXPECTED**-2.0), image, None, None)
        points = camera.points(image).reshape(-1, 3)
        points_palm = se3.apply(T_palm_camera, points[np.isfinite(points).all(axis=1)].astype(np.float64))
        enough = (
            seen.points >= DEPTH_TRACKER.min_points
            and seen.candidate["explained"][0] >= DEPTH_TRACKER.min_pixels
        )
        answers = fused(
            model, touched, expected, in_palm(seen, T_palm_camera) if enough else None, points_palm
        )
        found += [{"covered": share, "way": w, **errors(model, a, T)} for w, a in answers.items()]
    return found


def in_palm(seen: RefinedPose, T_palm_camera: Array) -> hs.PosePrior:
    """Returns the image's pose of the object in the palm, whose own pose is detected in the image."""
    pose = seen.pose_camera_object.transformed(T_palm_camera)
    arm = se3.point_jacobian(pose.T_a_b[:3, 3])
    covariance = pose.covariance + arm @ np.diag(HAND**2) @ arm.T
    return hs.PosePrior(pose.T_a_b, (covariance + covariance.T) / 2)


def both(expected: hs.PosePrior, seen: hs.PosePrior) -> hs.PosePrior:
    """Returns the fusion of two poses by their information."""
    first, second = (GaussianPose(each.T_palm_object, each.covariance) for each in (expected, seen))
    pose = first.fused(second)
    return hs.PosePrior(pose.T_a_b, (pose.covariance + pose.covariance.T) / 2)


def fused(
    model: hs.ObjectModel,
    touched: hs.Contacts,
    expected: hs.PosePrior,
    seen: hs.PosePrior | None,
    points: Array,
) -> dict[str, hs.PoseEstimate]:
    """Returns the estimate of each way; `seen` is None where too little of the object is visible."""
    vision = expected if seen is None else both(expected, seen)
    depth = None if seen is None else hs.DepthPoints.of_image(model, points, seen)
    alone = hs.PoseEstimate.from_gaussian(vision.T_palm_object, vision.covariance, np.empty((0, 6)))
    return {
        "pose alone": alone,
        "pose": hs.correct_pose(model, touched, vision=vision),
        "points": hs.correct_pose(model, touched, vision=expected, depth=depth),
    }


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=12, quick_trials=2)
    rows = []
    for k in report.progress(range(options.trials), "grasps"):
        for name in OBJECTS:
            seed = options.first_seed + 900 + k
            scenario = Scenario(object=name, seed=seed, rate=RATE, images=True, nuisances=Nuisances())
            samples = grasped(scenario)
            found = [] if samples is None else rows_of(scenario, samples)
            rows += [{"object": name, "seed": seed, **row} for row in found]
    report.write_csv(options.output / "one_solve.csv", rows)
    table = [
        [f"{100 * share:.0f} %", way, *cells(report.chosen(rows, covered=share, way=way))]
        for share in COVERED
        for way in WAYS
    ]
    columns = ["covered", "sight as", "middle mm", "nine in ten", "turn °", "nine in ten", "inside"]
    report.print_table("Touch, and sight as a pose or as points (synthetic)", columns, table, "Medians.")


def cells(rows: Rows) -> list[str]:
    """Returns the errors of one way."""
    middle, turn, inside = (report.values(rows, name) for name in ("middle", "turn", "inside"))
    numbers = [np.median(middle), np.quantile(middle, 0.9), np.median(turn), np.quantile(turn, 0.9)]
    return [*(f"{number:.1f}" for number in numbers), f"{100 * inside.mean():.0f} %"]


if __name__ == "__main__":
    main()
