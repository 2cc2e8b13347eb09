"""Runs an experiment, prints as it goes, and writes what it printed to docs/generated, for the manual to include.

`python -m experiments.write touch.blind --trials 6` runs `python -m experiments.touch.blind --trials 6` and writes
docs/generated/blind.md. The first line of the file states command, date, machine and commit.
"""

import os
import platform
import subprocess
import sys
from datetime import date
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GENERATED = ROOT / "docs" / "generated"


def main() -> None:
    """Runs the experiment that the command line names."""
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        sys.exit("usage: python -m experiments.write ROOM.NAME [options of the experiment]")
    name, *options = sys.argv[1:]
    printed = output_of(f"experiments.{name}", options)
    command = " ".join(["python -m", f"experiments.{name}", *options])
    header = f"<!-- {command}; {date.today()}; {machine()}; commit {commit()} -->"
    file = GENERATED / f"{name.rpartition('.')[2]}.md"
    file.write_text(f"{header}\n\n```text\n{printed.strip()}\n```\n", encoding="utf-8")


def output_of(module: str, options: list[str]) -> str:
    """Returns what the module prints, which is shown line by line as it comes; ends this program if it fails."""
    lines = []
    command = [sys.executable, "-u", "-m", module, *options]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, encoding="utf-8") as process:
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="", flush=True)
            if not line.startswith("wrote "):  # names of files, which are no part of a result
                lines.append(line.rstrip())
    if process.returncode:
        sys.exit(process.returncode)
    return "\n".join(lines)


def machine() -> str:
    """Returns the processor, the number of its cores and Python's version."""
    return f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"


def commit() -> str:
    """Returns the short hash of the commit, with a plus sign where tracked files differ from it."""
    hash = subprocess.check_output(["git", "rev-parse", "--short=9", "HEAD"], cwd=ROOT, text=True).strip()
    changed = subprocess.run(["git", "diff", "--quiet", "HEAD"], cwd=ROOT).returncode
    return f"{hash}+" if changed else hash


if __name__ == "__main__":
    main()
