"""Runs of experiments, and what they wrote."""

import contextlib
import csv
import importlib
import io
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest


def printed(name: str, folder: Path, *options: Any) -> str:
    """Returns what an experiment, such as `touch.blind`, prints; it runs in this process, as numba starts slowly."""
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as out:
        patch.setattr(sys, "argv", [name, "--output", str(folder), *map(str, options)])
        code: Any = 0
        try:
            importlib.import_module(f"experiments.{name}").main()
        except SystemExit as ended:  # so does an experiment whose data are not here
            code = ended.code or 0
    assert code == 0
    return out.getvalue()


def run(name: str, folder: Path, *options: Any) -> dict[str, list[dict[str, str]]]:
    """Returns the rows of an experiment's CSV files by stem, after checking every file that it says it wrote."""
    lines = printed(name, folder, *options).splitlines()
    written = [Path(line.removeprefix("wrote ")) for line in lines if line.startswith("wrote ")]
    assert sorted(written) == sorted(folder.iterdir())
    for path in written:
        assert path.suffix != ".png" or path.read_bytes().startswith(b"\x89PNG")
    tables = {path.stem: rows_of(path) for path in written if path.suffix == ".csv"}
    assert all(tables.values())
    return tables


def rows_of(path: Path) -> list[dict[str, str]]:
    """Returns the rows of a CSV file."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def column(rows: list[dict[str, str]], name: str, **key: str) -> np.ndarray:
    """Returns the numbers of a column, of the rows where other columns are as given."""
    return np.array([float(row[name]) for row in rows if all(row[k] == v for k, v in key.items())])
