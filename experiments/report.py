"""What the experiments share: their options, progress, tables with spread, CSV files and figures."""

import argparse
import csv
import itertools
import os
import platform
import textwrap
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

INITIAL, TRUTH, RESULT = "0.6", "#2e9e4f", "#e6b400"
"""The paper's colours of its Fig. 3: grey, green, yellow."""
WIDTH = 130


@dataclass(frozen=True)
class Options:
    """How an experiment was asked to run."""

    quick: bool
    output: Path
    """Folder for the files; made where it is missing."""
    trials: int
    seed: int

    def rng(self, *keys: int) -> np.random.Generator:
        """The generator of one trial: the same for the same seed, whatever else is run."""
        return np.random.default_rng([self.seed, *keys])


def parser(description: str) -> argparse.ArgumentParser:
    """A parser that shows the experiment's docstring as written."""
    return argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def parsed(arguments: argparse.ArgumentParser, *, trials: int, quick_trials: int) -> tuple[Options, Any]:
    """The options that every experiment has, and all that was parsed."""
    add = arguments.add_argument
    add("--quick", action="store_true", help=f"a look in under half a minute: {quick_trials} trials")
    add("--trials", type=_positive, metavar="N", help=f"default: {trials}, or {quick_trials} with --quick")
    add("--seed", type=int, default=0, metavar="S", help="another seed, other trials (default: %(default)s)")
    add(
        "--output",
        type=Path,
        default=Path("results"),
        metavar="DIR",
        help="where CSV and PNG go (default: %(default)s/)",
    )
    given = arguments.parse_args()
    number = given.trials or (quick_trials if given.quick else trials)
    given.output.mkdir(parents=True, exist_ok=True)
    return Options(given.quick, given.output, number, given.seed), given


def _positive(text: str) -> int:
    value = int(text)
    if value < 2:
        raise argparse.ArgumentTypeError(f"expected at least 2, got {value}")
    return value


def progress(items: Sequence[Any], what: str) -> Iterable[Any]:
    """The items, with a bar on stderr."""
    return track(items, description=what, console=Console(stderr=True), total=len(items))


def values(rows: Iterable[Mapping[str, Any]], name: str, **key: object) -> np.ndarray:
    """The numbers of one column, of the rows whose other columns are as given."""
    return np.array([row[name] for row in rows if all(row[k] == v for k, v in key.items())])


def summary(values: Iterable[float]) -> tuple[float, float]:
    """Mean and its standard error."""
    array = np.asarray(list(values), dtype=np.float64)
    return float(array.mean()), float(array.std(ddof=1) / np.sqrt(len(array)))


def positive(differences: Iterable[float]) -> bool | None:
    """Whether the mean is above zero; None where it is within two standard errors of it."""
    mean, error = summary(differences)
    return None if abs(mean) <= 2 * error else mean > 0


def all_of(answers: Iterable[bool | None]) -> bool | None:
    """False where any is false, else None where any is open."""
    listed = list(answers)
    return False if False in listed else None if None in listed else True


def plus_minus(values: Iterable[float], digits: int = 2) -> str:
    """Mean±standard error, as text; one significant digit where the digits would show a zero."""
    return with_error(*summary(values), digits)


def with_error(mean: float, error: float, digits: int = 2) -> str:
    """Mean±error, as text, as `plus_minus`."""
    form = f".{digits}f" if abs(mean) >= 0.5 * 10**-digits or mean == 0 else ".0e"
    return f"{mean:{form}}±{error:{form}}"


def grouped(
    rows: Sequence[Mapping[str, Any]], keys: Sequence[str], names: Iterable[str]
) -> list[dict[str, Any]]:
    """A row per combination of `keys`, in order of appearance: mean, standard error, median of each name."""
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    table = []
    for values, members in groups.items():
        line: dict[str, Any] = dict(zip(keys, values, strict=True))
        for name in names:
            found = [row[name] for row in members]
            line[f"{name}_mean"], line[f"{name}_se"] = summary(found)
            line[f"{name}_median"] = float(np.median(found))
        table.append(line | {"trials": len(members)})
    return table


def print_grouped(
    title: str,
    rows: Sequence[Mapping[str, Any]],
    keys: Sequence[str],
    digits: Mapping[str, int],
    note: str = "",
) -> None:
    """Prints `grouped` rows as mean±standard error, each column with its digits."""
    cells = []
    for line in grouped(rows, keys, digits):
        numbers = (with_error(line[f"{name}_mean"], line[f"{name}_se"], d) for name, d in digits.items())
        cells.append([*(line[key] for key in keys), *numbers])
    print_table(title, [*keys, *digits], cells, note)


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], note: str = "") -> None:
    """Prints a table: first column left, numbers right, the note below."""
    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", padding=(0, 1, 0, 0))
    for i, name in enumerate(columns):
        table.add_column(name, justify="right" if i else "left")
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    console = _console()
    console.print(table)
    if note:
        console.print(note, style="dim")


def say(text: str) -> None:
    """Prints a sentence, wrapped under its first word."""
    console = _console()
    wrapped = textwrap.fill(text, console.width - 1, subsequent_indent="  ", break_on_hyphens=False)
    console.print(wrapped, markup=False, highlight=False, soft_wrap=True)


def wrote(path: Path) -> None:
    """Prints the name of a file, never wrapped."""
    _console().print(f"wrote {path}", markup=False, highlight=False, soft_wrap=True)


def verdict(claim: str, holds: bool | None, numbers: str) -> dict[str, str]:
    """Prints a claim with its outcome; the same as a row for a CSV file. None: the numbers do not decide."""
    outcome = {True: "confirmed", False: "NOT confirmed", None: "not decided by so few trials"}[holds]
    say(f"* {claim}: {outcome}. {numbers}")
    return {"claim": claim, "outcome": outcome, "numbers": numbers}


def _console() -> Console:
    return Console(width=WIDTH)


def write_csv(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Writes rows with one header, floats to six significant digits, and says so."""
    with path.open("w", newline="", encoding="utf-8") as file:
        names = list(dict.fromkeys(name for row in rows for name in row))
        writer = csv.DictWriter(file, fieldnames=names, restval="", lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({key: f"{v:.6g}" if isinstance(v, float) else v for key, v in row.items()})
    wrote(path)


def pyplot() -> Any:
    """matplotlib's pyplot on a backend that needs no screen."""
    try:
        import matplotlib
    except ImportError:
        raise SystemExit("figures need matplotlib: pip install 'handsight[plot]'") from None
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"font.size": 9, "axes.titlesize": 10, "axes.spines.top": False})
    plt.rcParams.update({"axes.spines.right": False, "legend.frameon": False})
    return plt


def save_figure(figure: Any, path: Path) -> None:
    """Writes the figure as PNG, closes it, and says so."""
    figure.savefig(path, dpi=140)
    pyplot().close(figure)
    wrote(path)


def frame_3d(
    axes: Any, points: np.ndarray, *, unit: str = "cm", view: tuple[float, float] = (22, -58)
) -> None:
    """Equal scales around the points, ticks in centimetres, few of them."""
    from matplotlib.ticker import MaxNLocator

    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2, 0.5 * (high - low).max()
    for name, center in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{name}lim")(center - half, center + half)
        axis = getattr(axes, f"{name}axis")
        axis.set_major_formatter(lambda value, _: f"{100 * value:.0f}")
        axis.set_major_locator(MaxNLocator(4))
        axis.set_tick_params(labelsize=7, pad=-1)
        axis.set_label_text(f"palm {name} [cm]", fontsize=8)
        axis.labelpad = -3
    axes.grid(False)
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=view[0], azim=view[1])


def outline(model: Any) -> list[np.ndarray]:
    """Polylines (k, 3), object frame, of a box' edges or of a cylinder's rims."""
    low, high = model.bounds_object
    if model.symmetries.axes:
        angle = np.linspace(0, 2 * np.pi, 73)
        rim = high[0] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return [np.column_stack([rim, np.full(len(rim), z)]) for z in (low[2], high[2])]
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    pairs = itertools.combinations(range(8), 2)
    return [corners[[i, j]] for i, j in pairs if (corners[i] != corners[j]).sum() == 1]


def faces_viewer(axes: Any, normals: np.ndarray) -> np.ndarray:
    """(n,) bool: the surface there is turned to the viewer of these axes, as `frame_3d` has set them."""
    elevation, azimuth = np.deg2rad([axes.elev, axes.azim])
    toward = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    return np.asarray(normals @ np.array(toward) > 0)


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """What the call answers, and the seconds it took."""
    begin = time.perf_counter()
    answer = call()
    return answer, time.perf_counter() - begin


def machine() -> str:
    """Processor and number of cores, for times."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), name)
    except OSError:
        pass  # not Linux: the short name does
    return f"{name}, {os.cpu_count()} cores, Python {platform.python_version()}, NumPy {np.__version__}"
