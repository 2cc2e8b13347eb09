"""Opening of depth images as `Frames`: an image, a folder of them, a BOP scene, or a robot's recording.

A folder has `camera.json` and depth images of 16 bits. They are either in `depth/`, with optional colour images under
the same names in `rgb/` or `color/`; or in the folder itself, with `depth` in their names.
"""

from pathlib import Path

from handsight.errors import InvalidFile, InvalidInput
from handsight.recording.bop_scene import bop_frames, scenes_in
from handsight.recording.frames import Beside, Frame, Frames, color_beside, read_each
from handsight.recording.robot_images import recorded_frames
from handsight.rig import Rig
from handsight.vision import read_camera, read_color, read_depth


def is_recording(path: Path) -> bool:
    """Returns whether a path is a robot's recording, which needs a rig."""
    return path.suffix.lower() in (".mcap", ".bag", ".db3") or (path / "metadata.yaml").exists()


def open_frames(path: Path, beside: Beside, rig: Rig | None = None) -> Frames:
    """Returns the frames of a depth image, a folder of them, a BOP scene or split, or, with a rig, a recording.

    Raises InvalidFile for any other path, and the errors of the readers.
    """
    try:
        if is_recording(path):
            if rig is None:
                raise InvalidInput(f"rig: expected beside the recording {path}, got none")
            if beside != Beside():
                what = "expected no camera, colour, mask or depth scale beside a recording"
                raise InvalidInput(f"{path}: {what}")
            return recorded_frames(path, rig)
        if path.is_dir() and (scenes := scenes_in(path)):
            return bop_frames(path, scenes, beside)
        return _depth_images(path, beside)
    except OSError as error:
        raise InvalidFile(f"{error.filename or path}: {error.strerror or error}") from None


def _depth_images(path: Path, beside: Beside) -> Frames:
    """Returns the frames of a folder in the order of their names, or of one image; raises InvalidFile, InvalidInput."""
    folder, files, in_folders = path.parent, [path], False
    if path.is_dir():
        if beside.color is not None:
            raise InvalidInput(f"color: expected beside one depth image, got {path}, a folder of them")
        folder, in_folders = path, (path / "depth").is_dir()
        inside = path / "depth" if in_folders else path
        pngs = sorted(file for file in inside.iterdir() if file.suffix.lower() == ".png")
        files = [file for file in pngs if in_folders or "depth" in file.name]
        if not files:
            raise InvalidFile(f"{path}: expected depth images, depth/*.png or *depth*.png, got none")
    camera = read_camera(beside.camera or folder / "camera.json")

    def read(file: Path) -> Frame:
        color = color_beside(folder, file.stem, ("rgb", "color")) if in_folders else beside.color
        return Frame(
            name=file.name,
            camera=camera,
            depth=read_depth(file, beside.depth_scale, camera=camera),
            color=None if color is None else read_color(color, camera=camera),
            wanted=beside.wanted(file.stem, camera),
        )

    return Frames(len(files), read_each(files, read) if folder is path else iter([read(path)]))
