"""Options of an experiment or a benchmark, its progress, tables with standard errors, CSV files."""

import argparse
import csv
import functools
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

from handsight.errors import MissingExtra

Array = np.ndarray
Row = dict[str, Any]
"""The results of one trial, by their column in the CSV file."""
Rows = list[Row]
WIDTH = 130
SEEDS_APART = 10_000


@dataclass(frozen=True)
class Options:
    """`Options` say how an experiment is run."""

    quick: bool
    output: Path
    """Folder for the files, which is created where it is missing."""
    trials: int
    seed: int

    @property
    def first_seed(self) -> int:
        """Seed of the first simulated grasp; no two values of `--seed` have a grasp in common."""
        return self.seed * SEEDS_APART

    def rng(self, *keys: int) -> np.random.Generator:
        """Returns the random generator of one trial, the same for the same seed, whatever else is run."""
        return np.random.default_rng([self.seed, *keys])


def parser(description: str | None) -> argparse.ArgumentParser:
    """Returns a parser whose help shows the experiment's docstring as written."""
    shown = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(description=description, formatter_class=shown)


def options(description: str | None, *, trials: int, quick_trials: int) -> Options:
    """Returns the parsed options of an experiment that has no others."""
    return parsed(parser(description), trials=trials, quick_trials=quick_trials)[0]


def parsed(arguments: argparse.ArgumentParser, *, trials: int, quick_trials: int) -> tuple[Options, Any]:
    """Returns the options that every experiment has, and all parsed arguments."""
    add, default = arguments.add_argument, "(default: %(default)s)"
    add("--quick", action="store_true", help=f"a look in under half a minute: {quick_trials} trials")
    add("--trials", type=at_least(2), metavar="N", help=f"default: {trials}, or {quick_trials} with --quick")
    add("--seed", type=at_least(0), default=0, metavar="S", help=f"another seed, other trials {default}")
    where = f"where files go {default}"
    add("--output", type=Path, default=Path("results"), metavar="DIR", help=where)
    given = arguments.parse_args()
    number = given.trials or (quick_trials if given.quick else trials)
    try:
        given.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        arguments.error(f"argument --output: {given.output}: {error.strerror}")
    return Options(given.quick, given.output, number, given.seed), given


def at_least(least: int) -> Callable[[str], int]:
    """Returns the type of an argument that is a whole number of at least `least`."""

    def whole(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"expected a whole number of at least {least}, got {text!r:.60}")
        return value

    return whole


def amount(text: str) -> float:
    """Returns the number of an argument, which must be finite and at least 0."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < np.inf:
        raise argparse.ArgumentTypeError(f"expected a number of at least 0, got {text!r:.60}")
    return value


def or_skip(main: Callable[[], None]) -> Callable[[], None]:
    """Returns a program that prints which package is missing, and succeeds, where `main` raises MissingExtra."""

    @functools.wraps(main)
    def guarded() -> None:
        try:
            main()
        except MissingExtra as error:
            say(f"skipped: {error}")

    return guarded


def progress(items: Sequence[Any], what: str) -> Iterable[Any]:
    """Yields the items with a progress bar on stderr."""
    return track(items, description=what, console=Console(stderr=True), total=len(items))


def chosen(rows: Iterable[Row], **key: object) -> Rows:
    """Returns the rows whose columns have the given values."""
    return [row for row in rows if all(row[k] == v for k, v in key.items())]


def values(rows: Iterable[Row], name: str, **key: object) -> Array:
    """Returns the numbers of one column in the rows whose other columns have the given values."""
    return np.array([row[name] for row in chosen(rows, **key)])


def distinct(rows: Iterable[Row], name: str) -> list[Any]:
    """Returns the values of a column, each once, in order of appearance."""
    return list(dict.fromkeys(row[name] for row in rows))


def summary(values: Iterable[float]) -> tuple[float, float]:
    """Returns the mean and its standard error."""
    array = np.asarray(list(values), dtype=np.float64)
    return float(array.mean()), float(array.std(ddof=1) / np.sqrt(len(array)))


def plus_minus(values: Iterable[float], digits: int = 2) -> str:
    """Returns the text mean±standard error, with one significant digit where `digits` would show a zero."""
    mean, error = summary(values)
    form = f".{digits}f" if abs(mean) >= 0.5 * 10**-digits or mean == 0 else ".0e"
    return f"{mean:{form}}±{error:{form}}"


def groups(rows: Iterable[Row], keys: Sequence[str]) -> dict[tuple[Any, ...], Rows]:
    """Returns the rows of each combination of `keys`, in order of appearance."""
    found: dict[tuple[Any, ...], Rows] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return found


def grouped(rows: Iterable[Row], keys: Sequence[str], names: Iterable[str]) -> Rows:
    """Returns a row for each combination of `keys`: mean, standard error and median of `names`."""
    columns, table = list(names), []
    for key, members in groups(rows, keys).items():
        line = dict(zip(keys, key, strict=True))
        for name in columns:
            numbers = [row[name] for row in members]
            line[f"{name}_mean"], line[f"{name}_se"] = summary(numbers)
            line[f"{name}_median"] = float(np.median(numbers))
        table.append(line | {"trials": len(members)})
    return table


Cell = Callable[[Rows], str]
"""The text of a table's cell about some rows."""


def of(name: str, form: str = ".2f", statistic: Callable[[Array], Any] = np.mean, scale: float = 1.0) -> Cell:
    """Returns the cell of a statistic over those rows that have a number in a column; empty where none has."""

    def cell(rows: Rows) -> str:
        numbers = np.array([row[name] for row in rows if name in row], dtype=float)
        numbers = numbers[~np.isnan(numbers)]
        return f"{scale * statistic(numbers):{form}}" if len(numbers) else ""

    return cell


def quantile(share: float) -> Callable[[Array], Any]:
    """Returns the function of that quantile."""
    return lambda numbers: np.quantile(numbers, share)


def ratio(name: str, to: str, form: str = ".2f") -> Cell:
    """Returns the cell of the sum of a column over that of another; empty where that is zero."""

    def cell(rows: Rows) -> str:
        total = np.nansum(values(rows, to))
        return f"{np.nansum(values(rows, name)) / total:{form}}" if total else ""

    return cell


def where(cell: Cell, **key: object) -> Cell:
    """Returns the cell about those rows whose columns have the given values; empty where there are none."""
    return lambda rows: cell(mine) if (mine := chosen(rows, **key)) else ""


def error_of(name: str, digits: int = 1) -> Cell:
    """Returns the cell of a column's mean±standard error."""
    return lambda rows: plus_minus(values(rows, name), digits)


def count(rows: Rows) -> str:
    """Returns how many rows there are."""
    return str(len(rows))


def print_by(
    title: str, rows: Rows, keys: str, cells: Mapping[str, Cell], note: str = "", *, detail: bool = False
) -> None:
    """Prints a line for each combination of the columns `keys`, which commas separate, by the cells' titles."""
    names = keys.split(", ")
    lines = [[*key, *(cell(mine) for cell in cells.values())] for key, mine in groups(rows, names).items()]
    print_table(title, [*names, *cells], lines, note, detail=detail)


def print_grouped(
    title: str, rows: Rows, keys: Sequence[str], digits: Mapping[str, int], note: str = ""
) -> None:
    """Prints `grouped` rows as mean±standard error, each column with its number of digits."""
    print_by(title, rows, ", ".join(keys), {name: error_of(name, d) for name, d in digits.items()}, note)


def print_table(
    title: str,
    columns: str | Sequence[str],
    rows: Iterable[Sequence[object]],
    note: str = "",
    *,
    detail: bool = False,
) -> None:
    """Prints a table, its first column aligned left and numbers right, with a note below.

    columns: their titles, in a text separated by " | ". detail: a table that is only shown, on stderr, so that
    `experiments.write` leaves it out of the manual.
    """
    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", padding=(0, 1, 0, 0))
    for i, name in enumerate(columns.split(" | ") if isinstance(columns, str) else columns):
        table.add_column(name, justify="right" if i else "left")
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    console = Console(width=WIDTH, stderr=True) if detail else _console()
    console.print(table)
    if note:
        console.print(note, style="dim")


def say(text: str) -> None:
    """Prints a sentence, its further lines indented."""
    console = _console()
    wrapped = textwrap.fill(text, console.width - 1, subsequent_indent="  ", break_on_hyphens=False)
    console.print(wrapped, markup=False, highlight=False, soft_wrap=True)


def wrote(path: Path) -> None:
    """Prints the name of a file that was written, without wrapping it."""
    _console().print(f"wrote {path}", markup=False, highlight=False, soft_wrap=True)


def _console() -> Console:
    return Console(width=WIDTH)


def write_csv(path: Path, rows: Rows) -> None:
    """Writes rows with one header and floats of six significant digits, and prints the file's name."""
    with path.open("w", newline="", encoding="utf-8") as file:
        names = list(dict.fromkeys(name for row in rows for name in row))
        writer = csv.DictWriter(file, fieldnames=names, restval="", lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({key: f"{v:.6g}" if isinstance(v, float) else v for key, v in row.items()})
    wrote(path)


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """Returns the result of a call, and its duration [s]."""
    begin = time.perf_counter()
    answer = call()
    return answer, time.perf_counter() - begin


def machine() -> str:
    """Returns the machine's processor, cores and versions, to be printed below times."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), name)
    except OSError:
        pass  # not Linux: the short name is kept
    return f"{name}, {os.cpu_count()} cores, Python {platform.python_version()}, NumPy {np.__version__}"
