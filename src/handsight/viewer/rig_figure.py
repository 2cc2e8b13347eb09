"""A rig as a picture: the hand from its taxels' side and from beside, tips, sensors, camera, taxels with normals."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array, Indices
from handsight.rig import Rig
from handsight.viewer.correction_figures import new_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PIXELS, FAR = 1000, 3.0  # width and height of a view; distance from which it is drawn [m]
NORMAL, AXIS, SMALL, BEHIND = 0.004, 0.03, 0.012, 0.0015
"""Length of a normal, of the palm's and camera's axes, of other axes; a taxel farther behind the hand is hollow [m]."""
RING = 2 * np.pi * np.arange(41) / 40


def draw_rig(rig: Rig, name: str, path: Path) -> None:
    """Writes a picture of a rig, its joints as near to 0 as they can be; raises MissingExtra, HandsightError."""
    figure = new_figure(13, 7)
    from matplotlib import colormaps

    hand = rig.hand
    joints = dict(zip(hand.joint_names, np.clip(0.0, *hand.limits.T).tolist(), strict=True))
    Ts, vertices, faces = hand.link_poses(joints), [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)]
    for link, mesh in hand.link_meshes().items():
        faces.append(mesh.faces + sum(map(len, vertices)))
        vertices.append(se3.apply(Ts[link], mesh.vertices))
    tips = [Ts[finger.frame] @ finger.T_frame_surface for finger in rig.fingers.values()]
    sensors = [
        T @ (np.eye(4) if finger.tip.T_surface_sensor is None else finger.tip.T_surface_sensor)
        for name, T, finger in zip(rig.fingers, tips, rig.fingers.values(), strict=True)
        if name in rig.topics.wrenches
    ]
    cameras = [] if rig.camera is None or rig.camera.on == "world" else [rig.camera.T_mount_camera]
    taxels = {name: (Ts[each.frame], each) for name, each in rig.skin.items() if each.frame in Ts}
    corners, triangles = np.concatenate(vertices), np.concatenate(faces)
    places = [T[:3, 3] for T in (*Ts.values(), *cameras, *tips)] + [T[:3, 3] + AXIS * T[:3, 2] for T in tips]
    all_points = np.concatenate([corners, AXIS * np.eye(3), places])
    up = np.median([T[:3, 2] for T in tips], axis=0)
    thin = np.linalg.svd(all_points - all_points.mean(axis=0), full_matrices=False)[2][2]
    out = sum(((T[:3, :3] @ each.normals.T).sum(axis=1) for T, each in taxels.values()), 1e-3 * thin)
    sides = (out, "from the taxels' side" if taxels else "from above"), (np.cross(up, out), "from beside")
    for axes, (toward, title) in zip(figure.subplots(1, 2), sides, strict=True):
        view = _View(toward, up, all_points)
        view.draw_hand(axes, corners, triangles, np.array([T[:3, 3] for T in Ts.values()]))
        view.draw_tips(axes, rig, tips)
        view.draw_axes(axes, Ts[hand.palm], AXIS, "palm ")
        for T in sensors:
            view.draw_axes(axes, T, SMALL)
        for T in cameras:
            view.draw_axes(axes, T, AXIS, "camera ")
        for k, (label, (T, each)) in enumerate(taxels.items()):
            normals = each.normals @ T[:3, :3].T
            view.draw_taxels(axes, se3.apply(T, each.points), normals, colormaps["tab20"](k % 20), label)
        axes.set_title(title, fontsize=10)
    title = f"{name}: {len(tips)} tips (arrows: where they point)"
    title += f", {len(sensors)} sensors (axes x, y, z: red, green, blue)"
    title += f", {sum(len(e.points) for _, e in taxels.values())} taxels" if taxels else ""
    title += "; the camera is in the world, not here" if rig.camera is not None and not cameras else ""
    figure.suptitle(title, fontsize=10)
    save(figure, path)


class _View:
    """A `_View` is a camera so far from the hand that it draws almost parallel."""

    def __init__(self, toward: Array, up: Array, points: Array) -> None:
        """`toward`: from the hand to the camera; `up` in the picture; `points` (n, 3): what is to be in it [m]."""
        z = -toward / np.linalg.norm(toward)
        y = -(up - up @ z * z)
        y = y / np.linalg.norm(y) if np.linalg.norm(y) > 1e-6 else se3.perpendicular(z)
        R = np.stack([np.cross(y, z), y, z], axis=1)
        low, high = (points @ R).min(axis=0), (points @ R).max(axis=0)
        half = float((high - low)[:2].max()) / 2 + 0.012
        self.T_camera_palm = se3.inverse(se3.compose(R, R @ ((low + high) / 2 - [0, 0, FAR])))
        focal, center = PIXELS / 2 * FAR / half, (PIXELS - 1) / 2
        K = np.array([[focal, 0, center], [0, focal, center], [0, 0, 1.0]])
        self.camera, self.depth = Camera(K, (PIXELS, PIXELS)), np.full((PIXELS, PIXELS), np.inf)

    def project(self, points: Array) -> Array:
        """Returns the pixels (n, 2) of points in the palm (n, 3)."""
        return self.camera.project(se3.apply(self.T_camera_palm, points))

    def draw_hand(self, axes: "Axes", vertices: Array, faces: Indices, origins: Array) -> None:
        """Draws the links, lit from the camera; the origins of their frames (k, 3) where they have no shape."""
        axes.set(xlim=(0, PIXELS), ylim=(PIXELS, 0), aspect="equal")
        axes.set_axis_off()
        if not len(faces):
            axes.plot(*self.project(origins).T, "o", color="0.6", ms=4, label="links' origins")
            return
        corners_camera = se3.apply(self.T_camera_palm, vertices)
        corners = corners_camera[faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        light = np.abs(across[:, 2]) / np.linalg.norm(across, axis=1).clip(min=1e-15)
        grey = (255 * (0.45 + 0.5 * light)).astype(np.int64)
        self.depth, shades = self.camera.draw(corners_camera, faces, grey)
        shades = np.where(shades < 0, 255, shades)
        axes.imshow(shades, cmap="gray", vmin=0, vmax=255, interpolation="bilinear")

    def draw_tips(self, axes: "Axes", rig: Rig, Ts_palm_tip: list[Array]) -> None:
        """Draws the three great circles of each tip's shape, and where it points: from its centre along its z."""
        for i, (finger, T) in enumerate(zip(rig.fingers.values(), Ts_palm_tip, strict=True)):
            for k in range(3):
                ring = np.zeros((len(RING), 3))
                ring[:, k], ring[:, (k + 1) % 3] = np.cos(RING), np.sin(RING)
                pixels = self.project(se3.apply(T, ring * finger.tip.semi_axes))
                axes.plot(*pixels.T, color="#c2185b", lw=0.7, alpha=0.7, label=None if i + k else "fingertip")
            start, end = self.project(np.array([T[:3, 3], T[:3, 3] + AXIS * T[:3, 2]]))
            axes.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": "#c2185b", "lw": 1.3})

    def draw_axes(self, axes: "Axes", T: Array, length: float, label: str = "") -> None:
        """Draws a frame with axes of a length [m]; with a label at their ends, if there is one."""
        for name, axis, color in zip("xyz", T[:3, :3].T, ("#d00000", "#008000", "#0000d0"), strict=True):
            ends = self.project(np.array([T[:3, 3], T[:3, 3] + length * axis]))
            axes.plot(*ends.T, color=color, lw=2.2 if label else 1.2)
            if label:
                axes.annotate(f"{label}{name}", ends[1], color=color, fontsize=8)

    def draw_taxels(self, axes: "Axes", points: Array, normals: Array, color: Any, label: str) -> None:
        """Draws taxels with their normals; hollow where the hand hides them."""
        pixels, ends = self.project(points), self.project(points + NORMAL * normals)
        column, row = np.round(pixels).astype(int).clip(0, PIXELS - 1).T
        hidden = self.depth[row, column] < se3.apply(self.T_camera_palm, points)[:, 2] - BEHIND
        axes.plot(*np.stack([pixels, ends])[:, ~hidden].transpose(2, 0, 1), color=color, lw=0.8)
        axes.plot(*pixels[hidden].T, "o", color=color, ms=2.5, mfc="none", mew=0.4, alpha=0.6)
        axes.plot(*pixels[~hidden].T, "o", color=color, ms=2.5, label=label)
