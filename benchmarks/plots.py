"""Time against success, and how time grows, as log-log figures (PNG and SVG)."""

from pathlib import Path
from typing import Any

from benchmarks import frontier
from testbed import figures

COLOURS = {
    "ours": "#2e9e4f",
    "ours_kernel": "#7fc97f",
    "paper": "#e6b400",
    "paper_pruned": "#c26a00",
    "scipy": "#5b7fb5",
    "open3d": "#8c6bb1",
    "small_gicp": "#c0392b",
}
Row = dict[str, Any]


def save(figure: Any, folder: Path, name: str) -> None:
    """Writes a figure in both formats."""
    figure.savefig(folder / f"{name}.svg")
    figures.save(figure, folder / f"{name}.png")


def time_and_success(rows: list[Row], chosen: Row, folder: Path) -> None:
    """Draws a panel for each case: median time, its p99 as a whisker, success; the paper's frontier as a line."""
    plt = figures.pyplot()
    cases = list(dict.fromkeys((row["object"], row["error"]) for row in rows))
    columns = (len(cases) + 1) // 2 if len(cases) > 2 else len(cases)
    lines = -(-len(cases) // columns)
    figure, panels = plt.subplots(
        lines, columns, figsize=(4.6 * columns, 3.1 * lines), layout="constrained", sharey=True, squeeze=False
    )
    for panel, case in zip(panels.flat, cases, strict=False):
        mine = [r for r in rows if (r["object"], r["error"]) == case and r["success"] is not None]
        for row in mine:
            microseconds = [1e6 * row["median_s"], 1e6 * row["p99_s"]]
            colour = COLOURS.get(row["peer"], "0.4")
            panel.plot(microseconds, [row["success"]] * 2, color=colour, lw=1, alpha=0.5)
            panel.plot(microseconds[0], row["success"], "o", color=colour, label=row["name"])
        _front(panel, chosen, case)
        panel.set_xscale("log")
        panel.set_ylim(-0.03, 1.05)
        panel.set_title(f"{case[0]}, vision off by {case[1]}")
        panel.set_xlabel("median time, whisker to p99 [µs]")
    for line in panels:
        line[0].set_ylabel("success")
    handles, labels = panels.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8)
    save(figure, folder, "time_and_success")


def _front(panel: Any, chosen: Row, case: tuple[str, str]) -> None:
    """Draws the paper's settings that no other beats, on the seed for choosing."""
    entry = chosen["peers"].get("paper", {}).get(frontier.case_name(*case))
    if entry:
        front = entry["front"]
        panel.plot(
            [1e6 * point["median_s"] for point in front],
            [point["success"] for point in front],
            ".-",
            color=COLOURS["paper"],
            lw=0.8,
            ms=4,
            alpha=0.7,
            label="the paper's frontier (other seed)",
        )


def growth(parts: dict[str, list[Row]], folder: Path) -> None:
    """Draws four log-log panels."""
    plt = figures.pyplot()
    figure, ((a, b), (c, d)) = plt.subplots(2, 2, figsize=(9.6, 7.2), layout="constrained")
    _by_peer(a, parts["contacts"], "contacts", "contacts")
    a.legend(fontsize=7, loc="upper left", bbox_to_anchor=(0.0, 0.93), ncols=2)
    _by_peer(b, [row for row in parts["outside"] if row["outside"]], "outside", "points of the hand")
    without = [row for row in parts["outside"] if not row["outside"]]
    for row in without:
        b.axhline(1e6 * row["median_s"], color="0.6", lw=0.8, ls="--", label="without a hand")
    b.legend(fontsize=7)
    _hypotheses(c, parts["hypotheses"])
    rows = [row for row in parts["meshes"] if "build_s" in row and row["shape"].startswith("bumpy")]
    for key, label in (
        ("build_s", "build"),
        ("load_s", "from the cache"),
        ("query_s", "one query, in batch"),
    ):
        d.plot([r["triangles"] for r in rows], [1e6 * r[key] for r in rows], "o-", ms=4, label=label)
    d.set_xlabel("triangles (bumpy ball)")
    d.legend(fontsize=7)
    for panel, section, key in (
        (a, "contacts", "contacts"),
        (b, "outside", "outside"),
        (c, "", ""),
        (d, "", ""),
    ):
        if panel is d and not rows:  # no time was left
            continue
        panel.set_xscale("log")
        if section:
            ticks = sorted({row[key] for row in parts[section] if row[key]})
            panel.set_xticks(ticks, [str(tick) for tick in ticks])
            panel.minorticks_off()
        panel.set_yscale("log")
        panel.set_ylabel("time [µs]")
        panel.grid(alpha=0.25, which="major")
    save(figure, folder, "growth")


def _hypotheses(panel: Any, rows: list[Row]) -> None:
    for outside, colour in (
        (0, COLOURS["ours"]),
        (max(r["outside"] for r in rows), "#14532d"),
    ):
        mine = [r for r in rows if r["outside"] == outside and "median_s" in r]
        panel.plot([r["starts"] for r in mine], [1e6 * r["median_s"] for r in mine], "o-", ms=4, color=colour,
               label=f"{outside} points of the hand")  # fmt: skip
    panel.set_xlabel("hypotheses")
    panel.legend(fontsize=7)


def _by_peer(panel: Any, rows: list[Row], key: str, label: str) -> None:
    for peer in dict.fromkeys(row["peer"] for row in rows):
        mine = [row for row in rows if row["peer"] == peer]
        panel.plot([r[key] for r in mine], [1e6 * r["median_s"] for r in mine], "o-", ms=4,
                   color=COLOURS.get(peer, "0.4"), label=mine[0]["name"])  # fmt: skip
    panel.set_xlabel(label)
    panel.legend(fontsize=7)
