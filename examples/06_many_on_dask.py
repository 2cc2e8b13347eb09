"""Two hundred problems on a Dask cluster, here two processes of this machine; use your scheduler's address instead.

The same from the command line: handsight correct many.jsonl --output answers.jsonl --cluster tcp://scheduler:8786
"""

import io
import json
import sys
from pathlib import Path

import numpy as np

import _picture
from handsight import se3
from handsight.batch import answering

try:
    from dask.distributed import LocalCluster
except ImportError:
    sys.exit(print("skipped, Dask is not installed: pip install 'handsight[cluster]'"))

NORMALS = np.array([[1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [-1, 0, 0]], dtype=float)
PLACES = NORMALS * [0.03, 0.045, 0.07] + 0.01 * np.array(
    [[0, 1, 3], [1, 0, 0], [-1, 0, 2], [0, 2, 0], [0, 0, -4]]
)


def problem(rng: np.random.Generator) -> tuple[bytes, np.ndarray]:
    """Returns a line with a box, five contacts on it and vision that is 3 cm off; and the box's true pose (4, 4)."""
    T_palm_box = se3.random(rng, 1)[0]
    points = PLACES @ T_palm_box[:3, :3].T + T_palm_box[:3, 3] + 5e-4 * rng.normal(size=PLACES.shape)
    normals = NORMALS @ T_palm_box[:3, :3].T
    position, quaternion = T_palm_box[:3, 3], se3.quaternion_from_rotation(T_palm_box[:3, :3])
    line = {
        "object": {"box": [0.06, 0.09, 0.14]},
        "contacts": [{"point": [*p], "normal": [*n]} for p, n in zip(points, normals, strict=True)],
        "vision": {
            "position": [*(position + 0.03 * rng.normal(size=3))],
            "quaternion_xyzw": [*quaternion],
            "sigma_position": 0.03,
            "sigma_rotation_deg": 10,
        },
    }
    return json.dumps(line).encode(), T_palm_box


if __name__ == "__main__":  # workers are processes that read this file again
    rng = np.random.default_rng(0)
    lines, truths = zip(*(problem(rng) for _ in range(200)), strict=True)
    with LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs="CRITICAL"
    ) as cluster:
        source = io.BufferedReader(io.BytesIO(b"\n".join(lines)))
        with answering(source, Path.cwd(), cluster=cluster.scheduler_address) as answered:
            answers = [json.loads(text) for _, some in answered for text in some.texts]
    positions = np.array([answer["position"] for answer in answers])
    errors = 1e3 * np.linalg.norm(positions - np.array(truths)[:, :3, 3], axis=1)
    print(
        f"{len(answers)} boxes, median error {np.median(errors):.2f} mm, 90 % below {np.quantile(errors, 0.9):.2f} mm"
    )
    seen = np.array([json.loads(line)["vision"]["position"] for line in lines])
    before = 1e3 * np.linalg.norm(seen - np.array(truths)[:, :3, 3], axis=1)
    if (plt := _picture.pyplot()) is not None:
        axes = plt.subplots(figsize=(8, 4.2), layout="constrained")[1]
        bins = np.geomspace(0.1, 200, 40)
        axes.hist(before, bins, color="#808080", alpha=0.7, label="vision")
        axes.hist(errors, bins, color="#e0a100", alpha=0.7, label="corrected")
        axes.set(xscale="log", xlabel="error of the position [mm]", ylabel="boxes", title="Two hundred boxes")
        axes.legend()
        _picture.save(plt)
