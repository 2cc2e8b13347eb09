"""Every kernel compiled, or loaded, ahead of its first use."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handsight._kernels import (
    chain,
    contacts_to_palm,
    correct,
    field,
    layout,
    linking,
    many,
    nearest_triangle,
    sensing,
    spreading,
    winding,
)

Report = Callable[[str, float], None]


def warm(report: Report) -> None:
    """Calls every kernel once; tells `report` what each group is for and the seconds it took."""
    for name, run in GROUPS.items():
        began = time.perf_counter()
        run()
        report(name, time.perf_counter() - began)


def warm_tracker() -> None:
    """What a tracker calls, so that its first answer is not late: loading takes half a second, compiling a minute."""
    for run in (_corrections, _starts, sensing.warm, _hands):
        run()


def _starts() -> None:
    model, singles, contacts, prior, hand = _ball()
    sight, held, center = np.empty(layout.SIGHT), np.empty(layout.SIGHT), np.empty(3)
    correct.prepare(model, contacts, prior, sight, held, center)
    used, poses, found = np.ones((1, 3), dtype=bool), prior[None, :12].copy(), np.empty((2, 3))
    many.approach_all(model, singles, contacts, used, sight, sight, hand, center, poses, found, 0, 1)
    likely = poses.copy()
    many.finish_all(model, singles, contacts, used, sight, held, hand, center, poses, likely, found, 0, 1)
    evidence = (model, singles, contacts, used[0], sight, held, hand)
    many.weigh_all(*evidence, poses, 1.0, np.empty((1, 2)))
    many.cost_all(*evidence, poses, np.empty(1))
    answers = np.zeros((1, layout.RESIDUALS + 6))
    answers[:, :12] = poses
    many.explain_all(*evidence, 0.0, answers)
    many.nearest_all(model, poses, prior[:12])
    many.distinct(model, poses, np.zeros(1, dtype=np.int64), 1, 1.0, 1.0, np.empty(1, dtype=np.int64))


def _corrections() -> None:
    model, singles, contacts, prior, hand = _ball()
    begins, answers = np.array([0, len(contacts)]), np.empty((1, layout.RESIDUALS + 6))
    many.correct_all(model, singles, contacts, begins, prior, np.empty(0), hand, 1.0, answers, 0, 1)


def _fields() -> None:
    model, singles, *_ = _ball()
    singles.flags.writeable = False  # as a model's own are
    field.evaluate(model, singles, 0, np.zeros((1, 3)), np.empty((1, 13)), 0, 1)


def _objects() -> None:
    for kernels in (nearest_triangle, winding, linking, spreading):
        kernels.warm()


def _hands() -> None:
    chain.warm()
    contacts_to_palm.warm()


GROUPS: dict[str, Callable[[], None]] = {
    "corrections from a near pose": _corrections,
    "corrections from many starts": _starts,
    "distance fields": _fields,
    "objects from meshes": _objects,
    "contact sensing": sensing.warm,
    "hands": _hands,
}


def _ball() -> tuple[NDArray[Any], ...]:
    """A ball between three contacts, as the kernels take it: model, singles, contacts, prior, hand."""
    radius, directions = 0.05, np.vstack([np.eye(3), -np.eye(3), np.eye(3)[:2]])
    head = np.zeros(layout.MODEL)
    for at in (layout.COARSE, layout.FINE):
        head[at + layout.KIND], head[at + layout.ORIGIN], head[at + layout.LEAST] = (
            layout.SPHERE,
            radius,
            1e-3,
        )
    head[layout.RADIUS], head[layout.MATCH_WEIGHT], head[layout.BAND] = radius, 1e-2, 1.0
    head[layout.SAMPLE_VARIANCE : layout.SAMPLE_VARIANCE + 2] = 1e-6, 1e-3
    head[layout.LEAST_ROUGH : layout.LEAST_ROUGH + 2] = 1e-8, 1e-5
    head[layout.SHARP] = 1e6
    head[layout.ROTATION_COUNT], head[layout.ROTATIONS] = 1, layout.MODEL
    head[layout.SAMPLES] = layout.MODEL + 12
    head[layout.SCAN_COUNT] = len(directions)
    still = np.eye(4)[:3, [0, 1, 2]].reshape(-1)
    samples = np.hstack([radius * directions, directions]).reshape(-1)
    model = np.concatenate([head, still, np.zeros(3), samples])
    table = np.vstack([np.full(len(directions), radius**2), radius * directions.T, directions.T])
    contacts = np.zeros((3, layout.CONTACT))
    contacts[:, : layout.NORMAL], contacts[:, layout.NORMAL : layout.HAS_NORMAL] = (
        radius * np.eye(3),
        np.eye(3),
    )
    contacts[:, layout.HAS_NORMAL] = 1
    contacts[:, layout.COVARIANCE :] = np.diag([1e-6] * 3 + [1e-3] * 3).reshape(-1)
    prior = np.concatenate([still, np.full(3, 0.01), np.diag([1e-4] * 3 + [1e-2] * 3).reshape(-1)])
    return model, table.astype(np.float32).reshape(-1), contacts.reshape(-1), prior, np.array([1.0])
