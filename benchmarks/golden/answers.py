"""Answers as plain numbers and words, in files that any later version can read, and how two of them differ."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray
Answer = dict[str, Any]
"""Of one problem, by field: rows of numbers (k, w), or words."""
Answers = Iterator[tuple[str, Answer]]
"""By name, `KIND/...`."""
WIDTHS = {"pose": 16, "modes": 16, "covariance": 36, "covariances": 36, "information": 36}
WIDTHS |= {"residuals": 2, "unobservable": 6, "vectors": 3}
"""Numbers in a row, where there is more than one."""
LIMITS = {"mm": 1e-3, "deg": float(np.rad2deg(1e-6)), "covariance": 1e-4, "other": 1e-4}
"""What rounding may change; of a covariance in parts of its deviations, of other numbers in parts of the largest."""
FLIPPED = {"mm": 1.0, "deg": 1.0}
QUICK = 11
"""Every so many problems are a quick comparison's."""
HEADER = (
    f"{'':<20}{'answers':>8}{'identical':>10}{'mm':>9}{'deg':>9}{'cov':>9}{'other':>9}{'flipped':>8}"
    f"{'words':>7}{'seconds':>8}"
)
SMALLEST = 1e-300


def rows_of(**fields: Any) -> Answer:
    """Returns an answer of numbers and words; None is one row of NaN."""
    answer = {}
    for name, value in fields.items():
        width = WIDTHS.get(name, 1)
        given = np.full(width, np.nan) if value is None else value
        answer[name] = given if isinstance(given, str) else np.array(given, dtype=float).reshape(-1, width)
    return answer


def estimate_rows(estimate: Any) -> Answer:
    """Returns all numbers of an estimate of the object's pose."""
    residuals = estimate.residuals
    return rows_of(
        pose=estimate.T_palm_object,
        covariance=estimate.covariance,
        information=estimate.information,
        residuals=np.stack([residuals.distance, residuals.normal], axis=-1),
        unobservable=estimate.unobservable,
        consistent=estimate.consistent,
        outliers=estimate.outliers,
        modes=[mode.T_palm_object for mode in estimate.hypotheses],
        weights=[mode.weight for mode in estimate.hypotheses],
        iterations=estimate.iterations,
        converged=estimate.converged,
        weight_fits=estimate.weight_fits,
    )


def write(folder: Path, group: str, answers: dict[str, Answer]) -> None:
    """Writes a group's answers: of each field the rows of all answers, one after another, and how many are whose."""
    arrays: dict[str, Array] = {}
    numbers = [{f: v for f, v in answer.items() if not isinstance(v, str)} for answer in answers.values()]
    words = {n: {f: v for f, v in answer.items() if isinstance(v, str)} for n, answer in answers.items()}
    for field in sorted({name for answer in numbers for name in answer}):
        empty = np.empty((0, WIDTHS.get(field, 1)))
        arrays[field] = np.concatenate([answer.get(field, empty) for answer in numbers])
        arrays[f"{field}.rows"] = np.array([len(a[field]) if field in a else -1 for a in numbers])
    np.savez_compressed(folder / f"{group}.npz", **arrays)
    (folder / f"{group}.json").write_text(json.dumps(words, indent=0, ensure_ascii=False), encoding="utf-8")


def read(folder: Path, group: str) -> dict[str, Answer]:
    """Returns the answers that `write` has written."""
    answers: dict[str, Answer] = json.loads((folder / f"{group}.json").read_text(encoding="utf-8"))
    with np.load(folder / f"{group}.npz") as arrays:
        for field in (name for name in arrays.files if not name.endswith(".rows")):
            values, counts = arrays[field], arrays[f"{field}.rows"]
            for answer, count, end in zip(answers.values(), counts, np.cumsum(counts.clip(0)), strict=True):
                if count >= 0:
                    answer[field] = values[end - count : end]
    return answers


def apart(field: str, before: Array, now: Array) -> dict[str, float]:
    """Returns the difference of a field's numbers in the units of LIMITS; infinity where they cannot be compared."""
    width = WIDTHS.get(field, 1)
    kinds = ("mm", "deg") if width == 16 else ("covariance",) if width == 36 else ("other",)
    if before.shape != now.shape or (np.isnan(before) != np.isnan(now)).any():
        return dict.fromkeys(kinds, np.inf)
    a, b = np.nan_to_num(before), np.nan_to_num(now)
    if width == 16:
        gap = (a - b).reshape(-1, 4, 4)
        sine = np.linalg.norm(gap[:, :3, :3], axis=(1, 2)) / np.sqrt(8)
        mm, deg = (
            1e3 * np.linalg.norm(gap[:, :3, 3], axis=1),
            np.rad2deg(2 * np.arcsin(np.minimum(sine, 1))),
        )
        return {"mm": float(mm.max(initial=0)), "deg": float(deg.max(initial=0))}
    if width == 36:
        a, b = a.reshape(-1, 6, 6), b.reshape(-1, 6, 6)
        size = np.abs(np.einsum("nii->ni", a))
        least = np.maximum(1e-12 * size.max(axis=1, initial=0, keepdims=True), SMALLEST)
        scale = np.sqrt(np.maximum(size, least))
        return {"covariance": float((np.abs(a - b) / scale[:, :, None] / scale[:, None]).max(initial=0))}
    if field == "unobservable":  # a subspace: its basis has no meaning
        a, b = a.T @ a, b.T @ b
    return {"other": float(np.abs(a - b).max(initial=0) / np.abs(a).max(initial=SMALLEST))}


def compared(before: Answer, now: Answer, *, rounding: bool) -> dict[str, Any]:
    """Returns whether numbers or words of an answer differ, by how much, and whether its pose has flipped."""
    same, words, flipped = before.keys() == now.keys(), False, False
    most = dict.fromkeys(LIMITS, 0.0) | {"other": 0.0 if same else np.inf}
    for field in before.keys() & now.keys():
        a, b = before[field], now[field]
        if isinstance(a, str) or isinstance(b, str):
            words |= type(a) is not type(b) or a != b
        elif a.shape != b.shape or a.tobytes() != b.tobytes():
            same, found = False, apart(field, a, b)
            flipped |= field == "pose" and any(found[kind] > limit for kind, limit in FLIPPED.items())
            if field != "iterations" or not rounding:
                most = {kind: max(most[kind], found.get(kind, 0.0)) for kind in most}
    accepted = all(most[kind] < limit for kind, limit in LIMITS.items()) if rounding else same and not words
    return {"same": same, "words": words, "flipped": flipped, "accepted": accepted, **most}


def comparison(
    folder: Path, group: str, answers: Answers, *, whole: bool, rounding: bool
) -> tuple[list[str], bool]:
    """A table's lines, of the group and of each kind of its problems that differs, and whether all is accepted.

    `whole`: what was recorded and is not answered now differs too.
    """
    before, rows = read(folder, group), dict[str, list[dict[str, Any]]]()
    now = dict(answers)
    for name in dict.fromkeys((*now, *(before if whole else ()))):
        row = compared(before.get(name, {}), now.get(name, {}), rounding=rounding)
        rows.setdefault(name.split("/")[0], []).append(row)
    every = [row for each in rows.values() for row in each]
    parts = {
        f"  {k}": each for k, each in rows.items() if not all(r["same"] and not r["words"] for r in each)
    }
    lines = []
    for name, each in {group: every, **parts}.items():
        most = "".join(f"{max((row[kind] for row in each), default=0.0):9.2g}" for kind in LIMITS)
        same, flipped, words = (sum(row[kind] for row in each) for kind in ("same", "flipped", "words"))
        lines.append(f"{name:<20}{len(each):>8}{same:>10}{most}{flipped:>8}{words:>7}")
    return lines, bool(every) and all(row["accepted"] for row in every)
