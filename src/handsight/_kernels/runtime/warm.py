"""Every kernel compiled, or loaded, ahead of its first use."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handsight._kernels import records
from handsight._kernels.math import chain, spreading
from handsight._kernels.mesh import connected_nodes, field, nearest_triangle, patches, quadrics, winding
from handsight._kernels.posterior import mean, pose_bias, propagation
from handsight._kernels.runtime import warm_vision
from handsight._kernels.solve import batch, search
from handsight._kernels.touch import contacts_to_palm, sensing, surface_at_contacts

Report = Callable[[str, float], None]


def warm(report: Report) -> None:
    """Calls every kernel once; tells `report` what each group is for and the seconds it took."""
    for name, run in GROUPS.items():
        began = time.perf_counter()
        run()
        report(name, time.perf_counter() - began)


def warm_tracker() -> None:
    """Compiles what a tracker calls, so that its first answer is not late: loading takes half a second, compiling a
    minute."""
    for run in (_corrections, _starts, sensing.warm, _hands, _time):
        run()


def _starts() -> None:
    model, nodes, contacts, problems, outside = _ball()
    constraints, descents = problems["constraints"].copy(), np.zeros(2, dtype=records.DESCENT)
    pose = constraints["prior"]["pose"]
    descents["pose"] = pose
    given = (model, nodes, contacts[None], constraints, outside)
    for kernel in (batch.weigh, batch.cost_all):
        kernel(*given, descents)
    search.search(*given, descents[None, :, None])
    search.draw(constraints, np.zeros((2, 6)), descents)
    search.spin(model, np.eye(3)[None], np.zeros((1, 1, records.SAMPLES), dtype=records.DESCENT))
    search.score(model, nodes, contacts, np.ones(2), descents, np.empty((2, len(contacts))))
    answers = np.zeros(1, dtype=records.ANSWER)
    answers["pose"] = pose
    batch.summarize_all(*given, answers)
    mean.integrate(*given, answers)
    batch.width(model, constraints)
    batch.equivalent(model, np.eye(4), np.eye(4), np.empty((4, 4)))
    batch.residuals_at(model, nodes, contacts, descents, np.empty((len(contacts), 2)))
    batch.distinct(model, descents, np.arange(2), np.ones(2), np.empty(1, dtype=np.int64))


def _corrections() -> None:
    model, nodes, contacts, problems, outside = _ball()
    batch.correct_all(model, nodes, contacts, outside, problems, np.empty((len(contacts), 2)))


def _fields() -> None:
    model, nodes, *_ = _ball()
    field.evaluate(nodes, model["fine"], np.zeros((1, 3)), np.empty((1, 13)))


def _objects() -> None:
    for kernels in (nearest_triangle, winding, connected_nodes, spreading, quadrics, patches):
        kernels.warm()


def _hands() -> None:
    chain.warm()
    contacts_to_palm.warm()


def _time() -> None:
    model, nodes, *_ = _ball()
    pose_bias.warm()
    propagation.warm()
    surface_at_contacts.warm(model, nodes)


def _vision() -> None:
    model, nodes, *_ = _ball()
    warm_vision.warm(model, nodes)


GROUPS: dict[str, Callable[[], None]] = {
    "corrections from a near pose": _corrections,
    "corrections from many starts": _starts,
    "distance fields": _fields,
    "objects from meshes": _objects,
    "contact sensing": sensing.warm,
    "hands": _hands,
    "time": _time,
    "vision": _vision,
}


def _ball() -> tuple[NDArray[Any], ...]:
    """Returns a ball between three contacts, as the kernels take it: model, nodes, contacts, problems, outside
    points."""
    radius, directions = 0.05, np.vstack([np.eye(3), -np.eye(3)])[np.arange(records.SAMPLES) % 6]
    model = np.zeros(1, dtype=records.MODEL)
    row = model[0]
    for name in ("coarse", "fine"):
        row[name]["kind"], row[name]["origin"], row[name]["least_radius"] = records.SPHERE, radius, 1e-3
    row["radius"], row["normal_weight2"], row["band"] = radius, 1e-2, 1.0
    row["sample_variance_distance"], row["sample_variance_normal"], row["edge_curvature2"] = 1e-6, 1e-3, 1e6
    row["error"]["least_distance"], row["error"]["least_normal"] = 1e-8, 1e-5
    row["samples"] = np.stack([radius * directions, directions], axis=1)
    row["scan"] = np.vstack([np.full(records.SAMPLES, radius**2), radius * directions.T, directions.T])
    contacts = np.zeros(3, dtype=records.CONTACT)
    contacts["point"], contacts["normal"] = radius * np.eye(3), np.eye(3)
    contacts["has_normal"] = contacts["used"] = 1
    contacts["covariance"] = np.diag([1e-6] * 3 + [1e-3] * 3)
    problems = np.zeros(1, dtype=records.PROBLEM)
    problems["constraints"]["has_prior"] = 1
    prior = problems[0]["constraints"]["prior"]
    prior["pose"]["rotation"], prior["pose"]["position"] = np.eye(3), 0.01
    prior["covariance"] = np.diag([1e-4] * 3 + [1e-2] * 3)
    problems["last"] = 3
    return model, np.empty(0, dtype=np.float32), contacts, problems, np.empty(0, dtype=records.OUTSIDE)
