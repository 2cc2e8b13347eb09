"""The kernels of vision, compiled or loaded ahead of their first use."""

from typing import Any

import numpy as np

from handsight._kernels.image import (
    depth_covariance,
    depth_image,
    depth_term,
    hand_term,
    palm_scan,
    pinhole,
    pose_score,
    raster,
    volume,
    votes,
)
from handsight._kernels.image.vision_records import (
    CAMERA,
    CANDIDATE,
    DEPTH_ERROR,
    DEPTH_POINT,
    STAGE,
    VOXEL,
    WINDOW,
)
from handsight._kernels.solve import distinct_poses


def warm(model: Any, nodes: Any) -> None:
    """Calls each with a picture of few pixels; `model` (1,) MODEL and its nodes."""
    camera, rays = np.zeros(1, dtype=CAMERA), np.empty((8, 8, 2), dtype=np.float32)
    for name, value in (("fx", 8.0), ("fy", 8.0), ("cx", 3.5), ("cy", 3.5), ("reach2", np.inf)):
        camera[name] = value
    pinhole.rays(camera, rays)
    rays.setflags(write=False)
    pinhole.pixels_of(camera, np.ones((1, 3)), np.empty((1, 2)))
    depth, labels = np.full((8, 8), np.inf, dtype=np.float32), np.full((8, 8), -1, dtype=np.int32)
    corners, face = np.eye(3) + np.array([0, 0, 1.0]), np.arange(3)[None]
    raster.draw(camera, corners, face, np.zeros(1, dtype=np.int64), depth, labels)
    wanted = np.isfinite(depth)
    depth_image.sort_pixels(rays, (depth, wanted, wanted), np.ones(5), depth, labels)
    depth_image.label_parts(depth, labels, 1, np.empty(64))
    observed, candidates = np.zeros(2, dtype=DEPTH_POINT), np.zeros(4, dtype=CANDIDATE)
    chosen = np.zeros(2, dtype=np.int64)
    depth_image.spread(rays, depth, chosen, 1.0, chosen)
    depth_image.normals_at(rays, depth, labels, chosen, observed)

    points, normals = (model["samples"][0, :4, k].copy() for k in range(2))
    cells, spins = np.empty((4, 4), dtype=np.int64), np.empty((4, 4))
    votes.pairs_of(points, normals, 0.1, cells, spins)
    pairs = np.zeros(votes.CELLS + 1, dtype=np.int32), np.zeros(1, dtype=np.int32)
    voters, voted = np.stack([points, normals]), np.zeros((1, votes.PEAKS), dtype=CANDIDATE)
    votes.vote(pairs, voters, 0.1, observed, np.zeros(1, dtype=np.int64), 2, voted)

    sides = voters, np.eye(3), np.empty((3, 4), dtype=np.bool_), 1e-4
    visible = sides[2]
    pose_score.visible_sets(model, nodes, points.copy(), normals.copy(), np.eye(3), visible)
    stages = np.array([(1, 0.01, 0.01, 2, 1)], dtype=STAGE)
    depth_term.refine_poses(model, nodes, observed, stages, 1.0, np.eye(6), candidates)
    depth_term.closeness(model, nodes, observed, np.full(4, 0.01), candidates)
    errors = np.zeros(4, dtype=DEPTH_ERROR)
    depth_term.inform_all(model, nodes, observed, errors, candidates, np.empty((4, 2, 6, 6)))
    group, order = (np.eye(4)[None], np.zeros((0, 3))), np.arange(4)
    distinct_poses.distinct_candidates(group, np.ones(5), candidates, order, np.empty(4, dtype=np.int64))
    pose_score.score_all(camera, (depth, labels), sides, np.ones(1), np.zeros(3), candidates)
    volume.fuse(camera, depth, np.ones((3, 4)), 0.01, np.zeros((2, 2, 2), dtype=VOXEL))
    window, image = np.zeros(1, dtype=WINDOW), (rays, depth, labels)
    window["step"] = 1
    depth_image.leave_out_plane(image, window)
    depth_image.near_points((model, nodes), image, window, candidates[:1], observed)
    _warm_hand(camera, rays, depth)


def _warm_hand(camera: Any, rays: Any, depth: Any) -> None:
    """Calls each kernel of the seen hand, with one of three points."""
    cells, corner = np.empty((8, 8, 4), dtype=np.float32), np.array([-0.5, -0.5, 0.125])
    palm_scan.cells_of(camera, rays, depth, corner, cells)
    hand, candidates = np.ones((2, 3, 3)), np.zeros(2, dtype=CANDIDATE)
    found = np.empty((1, 1, 2))
    palm_scan.scan(cells, corner, 0.01, hand, np.ones((1, 3)), np.eye(3)[None], found)
    image = depth, rays, cells, corner
    stages = np.array([(0, 0.02, 0.01, 2, 1)], dtype=STAGE)
    hand_term.refine_hand(camera, image, hand, np.ones(3), 0.1, stages, candidates)
    hand_term.score_hand(camera, image, hand, 1e-4, 0.01, candidates)
    hand_term.rows_of(camera, image, hand, candidates["pose"][:1].copy(), 0.01, np.empty((3, 8)))
    points = np.ones((3, 3))
    depth_covariance.inform_points(
        np.ones(3), points, points, np.ones(3), 0.1, np.zeros(1, dtype=DEPTH_ERROR), 2, np.empty((2, 6, 6))
    )
