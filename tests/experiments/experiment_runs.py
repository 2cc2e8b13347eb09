"""Runs of experiments, and what they wrote."""

import contextlib
import csv
import importlib
import io
import sys
from pathlib import Path

import numpy as np
import pytest

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def printed(name, folder, *options):
    """What an experiment prints: its `main` in this process, which saves a start of Python with numba each time."""
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as out:
        patch.setattr(sys, "argv", [name, "--output", str(folder), *map(str, options)])
        code = 0
        try:
            importlib.import_module(name).main()
        except SystemExit as ended:  # so does an experiment whose data are not here
            code = ended.code or 0
    assert code == 0
    return out.getvalue()


def run(name, folder, *options):
    """The rows of an experiment's CSV files by stem, after checking every file that it says it wrote."""
    lines = printed(name, folder, *options).splitlines()
    written = [Path(line.removeprefix("wrote ")) for line in lines if line.startswith("wrote ")]
    assert sorted(written) == sorted(folder.iterdir())
    for path in written:
        assert path.suffix != ".png" or path.read_bytes().startswith(b"\x89PNG")
    if name not in ("latency", "added_by_model", "means", "over_time"):  # tables alone
        assert folder / f"{name}.png" in written
    tables = {path.stem: rows_of(path) for path in written if path.suffix == ".csv"}
    assert all(tables.values())
    return tables


def rows_of(path):
    """Of a CSV file."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def column(rows, name, **key):
    """The numbers of a column, of the rows where other columns are as given."""
    return np.array([float(row[name]) for row in rows if all(row[k] == v for k, v in key.items())])
