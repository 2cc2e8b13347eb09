"""First poses from one depth image and tracking in many, beside their peers: `python -m benchmarks.sight`.

`--trials` pictures a bin of occlusion and half as many sequences: YCB objects,
drawn with a structured light's noise. Every peer gets the same region
without table and hand, as far as ours finds them. In turn in one process; times are of its CPU, all threads. An answer
is right when its ADD-S is below 10 % of the diameter. The gate has no part in this: it needs data.
"""

import functools
import os
from collections.abc import Iterable, Sequence
from time import process_time
from typing import Any

import numpy as np

import handsight as hs
from benchmarks import peers, timing
from benchmarks.targets import Target
from handsight.vision.object.region import Scene, scene_of, table_plane
from testbed import report, sequences, sight, ycb
from testbed import sequences as drawn
from testbed import sight_scenes as scenes
from testbed.report import Rows

RIGHT = 0.1
OURS, FPFH, GICP = "ours", "open3d_fpfh", "small_gicp"


def scene_in(picture: scenes.Picture) -> Scene:
    """Returns the parts of a picture that may be the object, which every peer gets."""
    clear = np.ones(picture.depth.shape, dtype=bool) if picture.hand is None else ~picture.hand
    table = table_plane(scenes.WIDE, picture.depth, clear, extent=1.5 * picture.model.diameter)
    return scene_of(scenes.WIDE, picture.depth, wanted=picture.wanted, hand=picture.hand, table=table)


@functools.cache
def prepared(peer: str, of: str) -> Any:
    """Returns a peer that has prepared an object."""
    made = peers.FIRST_POSES[peer]()
    made.prepare(sight.objects()[of])
    return made


def first_poses(names: Sequence[str], trials: int, seed: int) -> Rows:
    """Returns a row for each picture and peer; the order of the peers rotates."""
    rows: Rows = []
    for k, (name, number, _) in enumerate(report.progress(sight.tasks(trials, [seed]), "first poses")):
        of, picture = sight.picture(name, number, seed)
        scene = scene_in(picture)
        for j in range(len(names)):
            peer = names[(j + k) % len(names)]
            solve = prepared(peer, of).ready(scene)
            if k < len(names):
                solve()  # the first calls load what they run
            begin = process_time()
            T = solve()
            seconds = process_time() - begin
            off = 9.0 if T is None else scenes.adds(picture.model, picture.T_camera_object, T[None])[0]
            row = {"hidden": name, "picture": number, "object": of, "peer": peer}
            rows.append(row | {"right": off < RIGHT, "seconds": seconds})
    return rows


def followed(number: int, seed: int) -> Rows:
    """Returns a row for each image and follower, taken in turn; each begins at the true pose."""
    folder, hand, rows = ycb.data_or_goodbye(), sequences.hand_shape(), []
    for k in report.progress(range(number), "following"):
        of, rng = sequences.OBJECTS[k % len(sequences.OBJECTS)], np.random.default_rng([seed, k])
        model: hs.ObjectModel = ycb.load(folder, of).model
        aside = sequences.ASIDE[k % len(sequences.ASIDE)]
        images = drawn.sequence(model, hand, rng, aside=aside, hold=k % 2 == 0)
        for row in sequences.followed(of, model, images, {"sequence": k}):
            peer = {"handsight": OURS, "small_gicp": GICP}.get(row["method"])
            if peer is not None:
                rows.append({key: row[key] for key in ("sequence", "image", "mm", "deg")}
                            | {"hidden": binned(row["hidden"]), "peer": peer, "right": not row["adds_off"]}
                            | {"seconds": 1e-3 * row["ms"]})  # fmt: skip
    return rows


def binned(hidden: float) -> str:
    """Returns the bin of occlusion of an image of a sequence."""
    low, high = next((low, high) for low, high in sequences.BINS if low < hidden <= high)
    return f"{max(low, 0):.0%} to {min(high, 1):.0%}"


def show(title: str, rows: Rows, names: Iterable[str]) -> None:
    """Prints a line for each bin and peer; the ratio is of median times, the peer's over ours."""
    names = list(names)
    shown = sorted(rows, key=lambda row: (row["hidden"], names.index(row["peer"])))
    cells: dict[str, report.Cell] = {"images": report.count, "right": report.of("right")}
    cells["CPU ms"] = report.of("seconds", ".3g", np.median, 1e3)
    cells["p99"] = report.of("seconds", ".3g", report.quantile(0.99), 1e3)
    if "mm" in rows[0]:
        cells |= {name: report.of(name, ".2f", np.median) for name in ("mm", "deg")}
    cells["its time / ours, 95 %"] = lambda mine: spread(rows, mine[0]["peer"], mine[0]["hidden"])
    report.print_by(title, shown, "hidden, peer", cells, report.machine())


def ratio(rows: Rows, peer: str, **key: object) -> dict[str, float]:
    """Returns a peer's median time over ours, with its interval; raises KeyError where the peer is missing."""
    here(rows, peer)
    theirs, mine = (report.values(rows, "seconds", peer=who, **key) for who in (peer, OURS))
    return timing.ratio(theirs, mine)


def here(rows: Rows, peer: str) -> None:
    """Raises KeyError where a peer has no rows, so that its comparison is not measured."""
    if peer not in report.distinct(rows, "peer"):
        raise KeyError(peer)


def spread(rows: Rows, peer: str, name: str) -> str:
    """Returns the text of the ratio in one bin; empty for ours."""
    if peer == OURS:
        return ""
    found = ratio(rows, peer, hidden=name)
    return f"{found['ratio']:.1f} ({found['low']:.1f}-{found['high']:.1f})"


def ahead(rows: Rows, peer: str) -> float:
    """Returns our share of right answers less a peer's, in the bin where that is least; raises KeyError as `ratio`."""
    here(rows, peer)
    shares = [
        report.values(rows, "right", hidden=name, peer=OURS).mean()
        - report.values(rows, "right", hidden=name, peer=peer).mean()
        for name in report.distinct(rows, "hidden")
    ]
    return float(min(shares))


def judge(found: dict[str, Rows]) -> None:
    """Prints targets and measurements."""
    wanted = [
        Target("first pose, right more often in each bin, by", lambda r: ahead(r["first"], FPFH), 0.2, False),
        Target("first pose, faster by", lambda r: ratio(r["first"], FPFH)["ratio"], 20, False, unit="x"),
        Target("tracking, right more often in each bin, by", lambda r: ahead(r["then"], GICP), 0.0, False),
        Target("tracking, faster by", lambda r: ratio(r["then"], GICP)["ratio"], 3, False, unit="x"),
    ]
    cells = [target.row(found) for target in wanted]
    report.print_table("Sight: targets", ["", "measured", "wanted", ""], cells, detail=True)


@report.or_skip
def main() -> None:
    """Measures and prints."""
    options = report.options(__doc__, trials=20, quick_trials=2)
    ycb.data_or_goodbye()
    os.environ["OMP_NUM_THREADS"] = "1"  # before Open3D is there: threads that wait would count as well
    made, missing = peers.made(makers=peers.FIRST_POSES)
    for name, why in missing.items():
        report.say(f"skipped {name}: {why}")
    found = {"first": first_poses(list(made), options.trials, options.seed)}
    show("First poses (synthetic)", found["first"], made)
    report.write_csv(options.output / "benchmark_first_poses.csv", found["first"])
    found["then"] = followed(options.trials // 2, options.seed)
    show("An object followed (synthetic)", found["then"], report.distinct(found["then"], "peer"))
    report.write_csv(options.output / "benchmark_following.csv", found["then"])
    judge(found)


if __name__ == "__main__":
    main()
