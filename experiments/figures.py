"""The measured figures of README.md and docs/*.md, from one file: docs/figures.json.

    python -m experiments.figures --check            # the pages against the file: 1 if anything differs
    python -m experiments.figures --check --run      # runs again what is cheap, too, and compares
    python -m experiments.figures --measure NAME...  # runs commands, and writes file and pages
    python -m experiments.figures --pages            # writes the file's blocks into the pages
    python -m experiments.figures --enter            # takes the pages' blocks that differ into the file
    python -m experiments.figures --enter NAME --command 'python experiments/...'    # a new one

A block is a fenced one or a table, or of prose what goes on until an empty line. The line before says where its
figures are from:

    <!-- figures: NAME -->              it is what the command of that entry of the file has printed
    <!-- figures from: NAME, NAME -->   it quotes: each of its figures is one of theirs, rounded
    <!-- figures from: its commands --> of a table: each row quotes the command in its last column, in the one before
    <!-- no figures: REASON -->         its numbers are given, not measured

A table or an output with several decimal fractions, and on the first pages any paragraph with a measure, must have such
a line; ```console blocks need none, for `docs/pages.py` runs them. A quotation is checked by value, not by place, and
as a share or in percent.

An entry has the command, date, machine, the code's commit (+: and changes), and its lines. `transcribed`: the lines
were not written by `--measure`, but are those that the page had; date and code are then of their last change. `note`:
how they differ from what the command prints; `part`: which part of it they are, and `--measure` refuses. `again`: how
far a figure may be off when the command is run again ([absolute, relative, since processors round differently, and a
pattern of what is not compared]).
"""

import argparse
import datetime
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from testbed import report

ROOT = Path(__file__).resolve().parent.parent
FILE = "docs/figures.json"
FIRST = "README.md", "docs/index.md", "docs/install.md", "docs/start.md"
"""The pages that a person sees first."""
MARK = re.compile(r"<!-- (figures|figures from|no figures): (.+?) -->")
FRACTION = re.compile(r"(?<![\w.])\d*\.\d+(?![\w.])")
MEASURE = re.compile(
    r"(?<![\w.])(?P<number>\d*\.\d+|\d+(?: \d{3})*)\s?(?:[mµn]?s|[mcµ]?m|°|%|[kM]?Hz|×|times|a second)(?!\w)"
    r"|(?<![\w.])(?P<share>\.\d+)(?!\w)"
)
NUMBER = re.compile(r"(?<![\w.])-?\d*\.?\d+(?:e-?\d+)?")
COMMANDS = "its commands"
MOST = 4
"""Decimal fractions of a block that need an origin."""
Entries = dict[str, dict[str, Any]]


class Block(NamedTuple):
    """A `Block` is a part of a page: its lines, and where its figures are from."""

    page: str
    kind: str
    """The language after a fence, "table" or "prose"."""
    begin: int
    end: int
    lines: list[str]
    """Without fences."""
    mark: str
    """"figures", "figures from" or "no figures"; empty where nothing is said."""
    said: str
    """What stands behind the mark."""

    @property
    def place(self) -> str:
        """Where it is, for a message."""
        return f"{self.page}:{self.begin + 1}"


def entries() -> Entries:
    """The file."""
    found: Entries = json.loads((ROOT / FILE).read_text(encoding="utf-8"))
    return found


def store(name: str, entry: dict[str, Any]) -> None:
    """Writes an entry into the file."""
    text = json.dumps(dict(sorted((entries() | {name: entry}).items())), indent=1, ensure_ascii=False)
    (ROOT / FILE).write_text(text + "\n", encoding="utf-8")


def pages() -> list[str]:
    """The pages, from the repository's root."""
    return ["README.md", *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md")))]


def blocks(page: str) -> Iterator[Block]:
    """Yields the blocks of a page."""
    lines = [*(ROOT / page).read_text(encoding="utf-8").splitlines(), ""]
    k, mark = 0, ("", "")
    while k < len(lines):
        if found := MARK.fullmatch(lines[k].strip()):
            mark, k = (found[1], found[2]), k + 1
            continue
        begin, line = k, lines[k].strip()
        if line.startswith("<!--"):
            while "-->" not in lines[k]:
                k += 1
        elif fence := re.match(r"(`{3,})(.*)", line):
            k += 1
            while lines[k].strip() != fence[1]:
                k += 1
            yield Block(page, fence[2], begin + 1, k, lines[begin + 1 : k], *mark)
        elif line:
            kind = "table" if line.startswith("|") else "prose"
            while lines[k + 1].strip() and lines[k + 1].startswith("|") == (kind == "table"):
                if re.match(r"\s*(```|<!-- (no )?figures)", lines[k + 1]):
                    break
                k += 1
            yield Block(page, kind, begin, k + 1, lines[begin : k + 1], *mark)
        mark, k = ("", ""), k + 1


def without_origin(block: Block) -> bool:
    """Whether a block has measured figures, as far as can be told, and does not say where they are from."""
    if block.mark or block.kind not in ("", "text", "table", "prose"):
        return False
    text = re.sub(r"`[^`]*`|\]\([^)]*\)", "", "\n".join(block.lines))
    return len(FRACTION.findall(text)) >= MOST if block.kind != "prose" else MEASURE.search(text) is not None


def unfounded(block: Block, known: Entries) -> list[str]:
    """Returns the figures of a block that are in none of the entries which it quotes."""
    text = "\n".join("\n".join(known[name]["lines"]) for name in block.said.split(", "))
    numbers = [float(number) for number in NUMBER.findall(text)]
    unquoted = r"`[^`]*`" if block.kind in ("table", "prose") else r"(?m)^[^#\n]*"  # code, but its comments
    quoted = re.sub(unquoted, "", "\n".join(block.lines))
    wrong = []
    for match in MEASURE.finditer(quoted):
        number = (match["number"] or match["share"]).replace(" ", "")
        half = 0.5001 * 10.0 ** -len(number.partition(".")[2])
        if all(abs(factor * each - float(number)) > half for each in numbers for factor in (1, 100, 0.01)):
            wrong.append(match[0])
    return wrong


def quotations(block: Block, known: Entries) -> Iterator[Block]:
    """Yields what quotes other entries than the rest of a block: the rows of a table of commands, or the block."""
    if block.said != COMMANDS:
        yield block
        return
    names = list[str]()
    for k, line in enumerate(block.lines[2:], block.begin + 2):
        *_, quoted, last, _ = line.split("|")
        programs = re.findall(r"\w+\.py|benchmarks\.\w+", last)
        if "the same" not in last:
            names = [name for name in known if any(each in known[name]["command"] for each in programs)]
        if names:
            yield block._replace(begin=k, lines=[quoted], said=", ".join(names))


def check() -> list[str]:
    """Returns sentences about pages that do not agree with the file."""
    wrong, shown, known = [], set[str](), entries()
    every = (each for page in pages() for block in blocks(page) for each in quotations(block, known))
    for block in every:
        names = block.said.split(", ") if block.mark.startswith("figures") else []
        shown |= {*names}
        if missing := [name for name in names if name not in known]:
            wrong.append(f"{block.place}: {FILE} has no {', '.join(missing)}")
        elif block.mark == "figures" and block.lines != known[block.said]["lines"]:
            wrong.append(f"{block.place}: other figures than {block.said} in {FILE}")
        elif block.mark == "figures from" and (found := unfounded(block, known)):
            wrong.append(f"{block.place}: {', '.join(found)}: not in {block.said}")
        elif without_origin(block) and (block.kind != "prose" or block.page in FIRST):
            wrong.append(f"{block.place}: figures without an origin")
    return wrong + [f"{FILE}: no page shows {name}" for name in known if name not in shown]


def run(command: str) -> list[str]:
    """Runs a line of the shell, and returns the lines that it prints: in the repository if it starts with `python`,
    else in an empty folder with the examples and the recordings of the package."""
    with tempfile.TemporaryDirectory() as folder:
        place = ROOT if command.startswith("python") else Path(folder)
        for name in ("examples", "src/handsight/data"):
            (Path(folder) / Path(name).name).symlink_to(ROOT / name)
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", command],
            cwd=place,
            env=os.environ | {"PATH": path, "TERM": "dumb", "COLUMNS": str(report.WIDTH)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )
    if done.returncode:
        raise SystemExit(f"{command}: exit code {done.returncode}: {done.stderr}")
    kept = [line.rstrip() for line in done.stdout.splitlines() if not line.startswith("wrote ")]
    return "\n".join(kept).strip("\n").split("\n")


def differences(name: str, entry: dict[str, Any]) -> list[str]:
    """Runs an entry's command again; returns sentences about lines that are others."""
    absolute, relative, ignored = entry["again"]
    found, now = [], run(entry["command"])
    for old, new in zip(entry["lines"], now, strict=False):
        a, b = (re.sub(ignored, "", line) if ignored else line for line in (old, new))
        pairs = zip(NUMBER.findall(a), NUMBER.findall(b), strict=False)
        far = any(abs(float(x) - float(y)) > max(absolute, relative * abs(float(x))) for x, y in pairs)
        if far or NUMBER.sub("", a).split() != NUMBER.sub("", b).split():
            found.append(f"{name}: has {old!r}, got {new!r}")
    if len(now) != len(entry["lines"]):
        found.append(f"{name}: has {len(entry['lines'])} lines, got {len(now)}")
    return found


def git(*words: str) -> str:
    """Returns what git prints; empty where there is none, or no repository."""
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True).stdout.strip()


def measured(name: str, entry: dict[str, Any]) -> dict[str, Any]:
    """Returns an entry with what its command prints now."""
    if "part" in entry:
        raise SystemExit(f"{name}: {entry['part']}, of {entry['command']}: change the page, then --enter it")
    print(f"{name}: {entry['command']}", flush=True)
    changed = git("status", "--porcelain", "--", "src", "experiments", "benchmarks", "testbed")
    code = git("rev-parse", "--short", "HEAD") + ("+" if changed else "")
    kept = {key: entry[key] for key in ("command", "again") if key in entry}
    return kept | {"date": today(), "machine": report.machine(), "code": code, "lines": run(entry["command"])}


def entered(block: Block, entry: dict[str, Any]) -> dict[str, Any]:
    """Returns an entry of a page's block as it stands, with the commit that last changed its lines."""
    if "command" not in entry:
        raise SystemExit(f"{block.place}: {block.said}: --command: expected what prints it, got none")
    blame = git("blame", "-w", "--date=short", f"-L{block.begin + 1},{block.end}", block.page)
    changes = re.findall(r"^\^?(\w+).*? (\d{4}-\d\d-\d\d) +\d+\)", blame, re.MULTILINE)
    date, code = max(((date, code) for code, date in changes), default=(today(), ""))
    kept = {key: entry[key] for key in ("command", "note", "part", "again", "machine") if key in entry}
    return kept | {"transcribed": True, "date": date, "code": code, "lines": block.lines}


def today() -> str:
    """The date in UTC."""
    return datetime.datetime.now(datetime.UTC).date().isoformat()


def write_pages() -> None:
    """Writes the file's blocks into the pages."""
    known = entries()
    for page in pages():
        lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
        for block in reversed([*blocks(page)]):
            if block.mark == "figures" and block.said in known:
                lines[block.begin : block.end] = known[block.said]["lines"]
        (ROOT / page).write_text("\n".join(lines) + "\n", encoding="utf-8")


def main(words: list[str] | None = None) -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for flag in ("--check", "--run", "--pages"):
        parser.add_argument(flag, action="store_true")
    parser.add_argument("--measure", nargs="+", default=[], metavar="NAME")
    parser.add_argument("--enter", nargs="*", metavar="NAME", help="without a name all that differ")
    parser.add_argument("--command", help="of what is measured or entered; without it the entry's own")
    given = parser.parse_args(words)
    told = {"command": given.command} if given.command else {}
    for name in given.measure:
        store(name, measured(name, entries().get(name, {}) | told))
    marked = {b.said: b for page in pages() for b in blocks(page) if b.mark == "figures"}
    every = [name for name, block in marked.items() if block.lines != entries().get(name, {}).get("lines")]
    for name in given.enter or (every if given.enter == [] else []):
        store(name, entered(marked[name], entries().get(name, {}) | told))
    if given.measure or given.pages:
        write_pages()
    wrong = check()
    for name, entry in entries().items():
        if given.run and "again" in entry:
            wrong += differences(name, entry)
    print("\n".join(wrong) or f"the pages agree with {FILE}")
    unchecked = Counter(b.page for page in pages() for b in blocks(page) if without_origin(b))
    print(
        "paragraphs with a measure that nothing checks:", ", ".join(f"{k} {n}" for k, n in unchecked.items())
    )
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
