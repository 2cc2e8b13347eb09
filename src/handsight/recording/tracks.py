"""What was tracked, as MCAP, TUM text and CSV. Rows without a pose are in the CSV only."""

import csv
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidFile, InvalidInput
from handsight.messages.topics import POSE_COVARIANCE
from handsight.recording.write import McapFile, header, pose_with_covariance

TOPIC = "/handsight/pose"
POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
SIGMA_COLUMNS = ("sigma_x", "sigma_y", "sigma_z", "sigma_rx", "sigma_ry", "sigma_rz")


@dataclass(frozen=True, slots=True, eq=False)
class TrackRow:
    """Where the object was at one instant."""

    stamp: float
    """[s]"""
    T_palm_object: Array | None
    """(4, 4); None: not known."""
    covariance: Array | None
    """(6, 6) of (δp [m], δθ [rad]) along the palm's axes; None: unbounded in some direction, or not known."""
    state: str
    """tracking, uncertain or lost."""
    reason: str = ""
    """Why it is not tracking; empty: it is."""

    def __post_init__(self) -> None:
        if not np.isfinite(self.stamp):
            raise InvalidInput(f"row.stamp: expected a finite number, got {self.stamp}")
        if self.T_palm_object is not None:
            object.__setattr__(self, "T_palm_object", se3.check(self.T_palm_object, "row.T_palm_object"))
        if self.covariance is not None:
            covariance = checks.covariance(self.covariance, "row.covariance", (6, 6))
            object.__setattr__(self, "covariance", covariance)


def write_track_mcap(path: str | Path, rows: Iterable[TrackRow], *, frame: str = "palm") -> None:
    """PoseWithCovarianceStamped on /handsight/pose, in the palm's frame id `frame`; no covariance is all zero.

    Raises InvalidFile, and MissingExtra without rosbags.
    """
    with McapFile(Path(path)) as file:
        for row in rows:
            if row.T_palm_object is not None:
                top, pose = header(row.stamp, frame), pose_with_covariance(row.T_palm_object, row.covariance)
                file.append(TOPIC, POSE_COVARIANCE, row.stamp, header=top, pose=pose)


def write_track_tum(path: str | Path, rows: Iterable[TrackRow]) -> None:
    """Lines `stamp x y z qx qy qz qw` [s, m], as evo and the TUM benchmark read them; raises InvalidFile."""
    with _writing(path) as file:
        for row in rows:
            if row.T_palm_object is not None:
                file.write(f"{row.stamp:.9f} {' '.join(_pose(row.T_palm_object))}\n")


def write_track_csv(path: str | Path, rows: Iterable[TrackRow]) -> None:
    """Columns stamp, state, reason, position [m], quaternion xyzw, sigmas [m], [rad]; unknown is empty.

    Raises InvalidFile.
    """
    with _writing(path) as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("stamp", "state", "reason", *POSE_COLUMNS, *SIGMA_COLUMNS))
        for row in rows:
            pose = [""] * 7 if row.T_palm_object is None else _pose(row.T_palm_object)
            sigmas = [""] * 6
            if row.covariance is not None:
                sigmas = [f"{x:.6g}" for x in np.sqrt(np.diagonal(row.covariance))]
            table.writerow([f"{row.stamp:.9f}", row.state, row.reason, *pose, *sigmas])


@contextmanager
def _writing(path: str | Path) -> Iterator[TextIO]:
    try:
        with Path(path).open("w", encoding="utf-8", newline="") as file:
            yield file
    except OSError as error:
        raise InvalidFile(f"{path}: cannot be written: {error.strerror}") from None


def _pose(T: Array) -> list[str]:
    return [f"{x:.9f}" for x in (*T[:3, 3], *se3.quaternion_from_rotation(T[:3, :3]))]
