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


def correction(rows: list[Row]) -> None:
    """A table for each object and error of vision."""
    shown = [
        row
        | {"normals": "yes" if row["uses_normals"] else "no", "prior": "yes" if row["uses_prior"] else "no"}
        for row in sorted(rows, key=lambda row: row["median_s"])
    ]
    columns = {"name": "peer", "normals": "normals", "prior": "prior", "median_s": "median", "p99_s": "p99"}
    columns |= {"hot_median_s": "hot", "success": "success", "median_mm": "mm", "median_deg": "deg"}
    for object_name, error in dict.fromkeys((row["object"], row["error"]) for row in rows):
        mine = report.chosen(shown, object=object_name, error=error)
        title = f"Correction: {object_name}, five contacts, vision off by {error}"
        plain(title, mine, columns | {"repeats": "problems"})
    report.say("normals, prior: whether it can use them. mm, deg: medians of the successes.")


def plain(
    title: str, rows: Iterable[Row], columns: dict[str, str], note: str = "", *, detail: bool = False
) -> None:
    """Rows with some of their keys: `columns` maps key to heading; seconds get units."""
    cells = []
    for row in rows:
        if "failed" in row:
            cells.append([str(row["name"]), str(row["failed"]), *[""] * (len(columns) - 2)])
        else:
            cells.append([_cell(key, row.get(key)) for key in columns])
    report.print_table(title, list(columns.values()), cells, note, detail=detail)


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
OTHERS: dict[str, tuple[str, dict[str, str], str]] = {
    "batch": (
        "Descents of many starts against a single correction (box, 20 mm; one core)",
        {"name": "", **TIMES, "per_second": "per second"},
        "",
    ),
    "blind": (
        "Blind: no vision, five contacts with normals where nothing else is said",
        {"name": "method", "object": "object", **TIMES, "success": "first", "among_8": "among 8"},
        "first, among 8: the true pose is the first answer, or one of the first eight.",
    ),
    "closest": (
        "How far from the surface, per query, in batch",
        {"name": "peer", **TIMES, "queries": "queries"},
        "",
    ),
    "startup": ("New processes, CPU time, interpreter included", {"name": "", **TIMES}, ""),
}
"""Of each section but correction: title, columns, note."""


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
    for name, (title, columns, note) in OTHERS.items():
        if found := sections.get(name):
            plain(title, found, columns, note, detail=name == "closest")
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
