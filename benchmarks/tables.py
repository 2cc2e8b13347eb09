"""Results as tables in the terminal."""

from collections.abc import Iterable
from typing import Any

from benchmarks import gate, targets
from testbed import report

Row = dict[str, Any]


def duration(seconds: float | None) -> str:
    """With the unit that fits."""
    if seconds is None:
        return "-"
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if seconds * scale >= 1:
            return f"{seconds * scale:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def number(value: float | None, form: str = ".3g") -> str:
    """A dash where there is none."""
    return "-" if value is None else f"{value:{form}}"


def yes(value: bool | None) -> str:
    """In a word."""
    return "yes" if value else "no"


def correction(rows: list[Row]) -> None:
    """A table for each object and error of vision."""
    for case in dict.fromkeys((row["object"], row["error"]) for row in rows):
        mine = [row for row in rows if (row["object"], row["error"]) == case]
        cells = [
            [row["name"], yes(row["uses_normals"]), yes(row["uses_prior"]), duration(row["median_s"]),
             duration(row["p99_s"]), duration(row.get("hot_median_s")), number(row["success"], ".3f"),
             number(row.get("median_mm"), ".2f"), number(row.get("median_deg"), ".1f"), row["repeats"]]
            for row in sorted(mine, key=lambda row: row["median_s"])
        ]  # fmt: skip
        report.print_table(
            f"Correction: {case[0]}, five contacts, vision off by {case[1]}",
            ["peer", "normals", "prior", "median", "p99", "hot", "success", "mm", "deg", "problems"],
            cells,
            "normals, prior: whether it can use them. mm, deg: medians of the successes.",
        )


def plain(title: str, rows: Iterable[Row], columns: dict[str, str], note: str = "") -> None:
    """Rows with some of their keys: `columns` maps key to heading; seconds get units."""
    cells = []
    for row in rows:
        if "skipped" in row or "failed" in row:
            first = str(row[next(iter(columns))])
            cells.append([first, str(row.get("skipped") or row.get("failed")), *[""] * (len(columns) - 2)])
            continue
        cells.append([_cell(key, row.get(key)) for key in columns])
    report.print_table(title, list(columns.values()), cells, note)


def _cell(key: str, value: Any) -> str:
    if value is None:
        return "-"
    if key.endswith("_s"):
        return duration(value)
    if key == "per_second":
        return f"{value:,.0f}"
    if key in ("success", "among_8"):
        return f"{value:.3f}"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


TIMES = {"median_s": "median", "p99_s": "p99", "repeats": "repeats"}


def others(sections: dict[str, Any]) -> None:
    """All sections but correction."""
    if rows := sections.get("batch"):
        plain("A batch against a single correction (box, 20 mm; one core)", rows,
              {"name": "", **TIMES, "per_second": "per second"})  # fmt: skip
    if rows := sections.get("blind"):
        plain(
            "Blind: no vision, five contacts with normals where nothing else is said",
            rows,
            {"name": "method", "object": "object", **TIMES, "success": "first", "among_8": "among 8"},
            "first, among 8: the true pose is the first answer, or one of the first eight.",
        )
    if rows := sections.get("closest"):
        plain(
            "How far from the surface, per query, in batch",
            rows,
            {"name": "peer", "curvature": "curvature", **TIMES, "face_error_mm": "face mm", "rim_error_mm": "rim mm",
             "rim_error_95_mm": "rim 95 % mm", "queries": "queries"},
            "face, rim: median error of the distance away from and within 4 mm of a rim, against the true cylinder.",
        )  # fmt: skip
    if rows := sections.get("sensing"):
        plain(
            "Contact sensing, per contact (five fingers: per hand)",
            rows,
            {"name": "", **TIMES, "hot_median_s": "hot", "per_second": "per second", "success": "success",
             "error_99_m": "99 % error m"},
        )  # fmt: skip
    if rows := sections.get("startup"):
        plain("New processes, CPU time, interpreter included", rows, {"name": "", **TIMES})
    if rows := sections.get("memory"):
        plain(
            "Peak memory of a process with one peer",
            rows,
            {"peer": "peer", "peak_mb": "MB", "beyond_none_mb": "beyond none"},
            "none: Python, NumPy, SciPy, handsight and the drawn problems.",
        )


def growth(parts: dict[str, list[Row]]) -> None:
    """Four tables."""
    plain("Growth with contacts (box, 20 mm)", parts.get("contacts", []),
          {"name": "peer", "contacts": "contacts", **TIMES, "success": "success"})  # fmt: skip
    plain("Growth with points of the hand (box, 20 mm)", parts.get("outside", []),
          {"name": "peer", "outside": "points", **TIMES, "success": "success"})  # fmt: skip
    plain("Growth with hypotheses (box, 20 mm, both phases)", parts.get("hypotheses", []),
          {"starts": "hypotheses", "outside": "hand points", **TIMES, "per_second": "per second"})  # fmt: skip
    plain("Growth with triangles", parts.get("meshes", []),
          {"shape": "file", "triangles": "triangles", "build_s": "build", "load_s": "from cache",
           "query_s": "query"})  # fmt: skip


def ratios(found: dict[str, Any]) -> None:
    """What is handsight's time over a peer's."""
    cells = [[k, f"{v['ratio']:.4g}", f"{v['low']:.4g}-{v['high']:.4g}", f"{1 / v['ratio']:.3g} x", v["pairs"]]
             for k, v in found.items()]  # fmt: skip
    report.print_table(
        "Ratios of median times (below 1: the first is faster)",
        ["ratio", "value", "95 %", "faster by", "pairs"],
        cells,
        "Taken in turn in one process; can and box (20 mm) by geometric mean. Interval by bootstrap.",
    )


def everything(results: dict[str, Any]) -> None:
    """All tables of a run, promises last."""
    sections = results["sections"]
    correction(sections.get("correction", []))
    others(sections)
    if "growth" in sections:
        growth(sections["growth"])
    if results["ratios"]:
        ratios(results["ratios"])
    report.print_table(
        "Targets", ["", "measured", "wanted", ""], targets.rows(results), results["machine"]["description"]
    )


def gated(results: dict[str, Any], baseline: dict[str, Any]) -> None:
    """Now and then."""
    title = f"Against the baseline of {baseline['machine']['description']}"
    report.print_table(
        title, ["ratio", "now (95 %)", "then", "change"], gate.compared(results["ratios"], baseline)
    )
