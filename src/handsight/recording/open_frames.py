"""A path to depth images, whatever lies there, as `Frames`."""

from pathlib import Path

from handsight.errors import InvalidFile, InvalidInput
from handsight.recording.bop_scene import bop_scenes, is_scenes
from handsight.recording.frames import Frames
from handsight.recording.rgbd import Beside, depth_file, depth_folder
from handsight.recording.robot_images import recorded_frames
from handsight.rig import Rig

RECORDED = (".mcap", ".bag", ".db3")
METADATA = "metadata.yaml"


def is_recording(path: Path) -> bool:
    """Returns whether a path is a robot's recording, whose images need a rig."""
    return path.suffix.lower() in RECORDED or (path / METADATA).exists()


def open_frames(path: Path, beside: Beside, rig: Rig | None = None) -> Frames:
    """Returns the pictures of a depth image, a folder of them, a BOP scene or split, or a recording, for which there
    is a rig.

    Raises InvalidFile where there is none of these, and as those who read them.
    """
    try:
        if is_recording(path):
            if rig is None:
                raise InvalidInput(f"rig: expected beside the recording {path}, got none")
            if beside != Beside():
                raise InvalidInput(
                    f"{path}: expected no camera, colour, mask or depth scale beside a recording"
                )
            return recorded_frames(path, rig)
        if not path.is_dir():
            return depth_file(path, beside)
        return bop_scenes(path, beside) if is_scenes(path) else depth_folder(path, beside)
    except OSError as error:
        raise InvalidFile(f"{error.filename or path}: {error.strerror or error}") from None
