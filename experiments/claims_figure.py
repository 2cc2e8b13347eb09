"""The figure of `claims.py`: a panel or two for each claim."""

import numpy as np

import report

COLOURS = ("#4878a8", "#c2185b", "#8f5fb8")


def draw(measured, path):
    """Writes the six panels."""
    figure, panels = report.pyplot().subplots(2, 3, figsize=(14.5, 8.6), layout="constrained")
    draw_edges(panels[0, 0], measured["edges"])
    draw_weights(panels[0, 1], measured["w_n"], {"rme_mm": "RME [mm]", "distance_mm": "distance left [mm]"})
    draw_weights(
        panels[0, 2], measured["w_n"], {"mae_deg": "MAE [°]", "normal_deg": "normals' angle left [°]"}
    )
    draw_minima(panels[1, 0], measured["minima"])
    draw_speed(panels[1, 1], measured["speed"], "evaluate", "points in the cloud")
    draw_speed(panels[1, 2], measured["speed"], "rotate", "points rotated")
    titles = (
        "a  contacts on the wrong face of a box",
        "b  LM with normals: distances",
        "b  LM with normals: angles",
        "c  error at the paper's minima",
        "d  one evaluation of the cost",
        "d  one rotation",
    )
    for axes, title in zip(panels.flat, titles, strict=True):
        axes.set_title(title, loc="left")
        axes.set_axisbelow(True)
    figure.get_layout_engine().set(wspace=0.05, hspace=0.06)
    report.save_figure(figure, path)


def draw_edges(axes, rows):
    """Bars with standard errors: near an edge and far from any, for each method."""
    table = report.grouped(rows, ("near_edge", "method"), ("wrong_face",))
    for near, label, color, shift in (
        (1, "1-5 mm from an edge", "#c2185b", -0.2),
        (0, "over 15 mm from any", "0.65", 0.2),
    ):
        chosen = [row for row in table if row["near_edge"] == near]
        mean, error = ([row[f"wrong_face_{n}"] for row in chosen] for n in ("mean", "se"))
        x = np.arange(len(chosen)) + shift
        axes.bar(x, mean, 0.38, yerr=error, color=color, capsize=3, label=label)
    names = [
        row["method"].replace(" with normals", "\nwith normals").replace(" (paper)", "") for row in chosen
    ]
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel("share of contacts")
    axes.legend(title="contacts")
    axes.grid(axis="y", color="0.92")


def draw_weights(axes, rows, names):
    """Means with standard errors against w_n, the error solid and what the method sees of it dashed."""
    table = report.grouped(rows, ("shape", "w_n_cm"), names)
    for shape, color in zip(("cube", "cylinder"), COLOURS, strict=False):
        chosen = [row for row in table if row["shape"] == shape]
        for (name, label), line in zip(names.items(), ("-", "--"), strict=True):
            columns = ([row[key] for row in chosen] for key in ("w_n_cm", f"{name}_mean", f"{name}_se"))
            style = {"color": color, "linestyle": line, "marker": "o", "markersize": 4, "capsize": 3}
            axes.errorbar(*columns, **style, label=f"{shape}: {label}")
    axes.set(xscale="log", yscale="log", xlabel="w_n [cm]", ylabel=" / ".join(names.values()))
    axes.set_ylim(top=2.2 * axes.get_ylim()[1])  # room for the legend
    plain(axes)
    ticks = sorted({row["w_n_cm"] for row in rows})
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.grid(color="0.92")
    axes.legend(fontsize=7.5, loc="upper right", ncols=2, columnspacing=0.8)


def plain(axes):
    """Plain numbers at 1, 2 and 5 on logarithmic axes."""
    from matplotlib.ticker import LogLocator

    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 1000 * low else (1,)))
        axis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.minorticks_off()


def draw_minima(axes, rows):
    """Each grasp's error at the nearest minimum and the cheapest; above the diagonal the latter is worse."""
    for shape, color in zip(("box", "can"), COLOURS, strict=False):
        for part, filled, label in (("_symmetric", True, "modulo symmetry"), ("", False, "as it is")):
            chosen = [row for row in rows if row["object"] == shape]
            x, y = ([row[f"{name}{part}_mm"] for row in chosen] for name in ("nearest", "cheapest"))
            style = {"facecolors": color if filled else "none", "edgecolors": color, "alpha": 0.7, "s": 26}
            axes.scatter(x, y, **style, label=f"{shape}, {label}")
    axes.set(xscale="log", yscale="log")
    limits = axes.get_xlim() + axes.get_ylim()
    low, high = min(limits), max(limits)
    axes.plot([low, high], [low, high], color="0.7", zorder=0)
    plain(axes)
    axes.set(xlabel="nearest to the initial estimate: error [mm]", ylabel="of least cost: error [mm]")
    axes.set_ylim(low, 12 * high)  # room for the legend
    axes.legend(fontsize=8, loc="upper center", ncols=2)


def draw_speed(axes, rows, task, xlabel):
    """Medians with quartiles against the number of points."""
    chosen = [row for row in rows if row["task"] == task]
    for way, color in zip(dict.fromkeys(row["way"] for row in chosen), COLOURS, strict=False):
        points, low, middle, high = np.array(
            [[r["points"], r["q25_us"], r["median_us"], r["q75_us"]] for r in chosen if r["way"] == way]
        ).T
        axes.fill_between(points, low, high, color=color, alpha=0.2, linewidth=0)
        axes.plot(points, middle, "o-", color=color, markersize=4, label=way)
    axes.set(xscale="log", yscale="log", xlabel=xlabel, ylabel="time [µs], median and quartiles")
    plain(axes)
    axes.grid(color="0.92")
    axes.legend(fontsize=8)
