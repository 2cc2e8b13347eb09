"""The pages keep their word: a plugin of pytest, `python -m pytest -p docs.pages docs README.md CONTRIBUTING.md`.

In README.md, CONTRIBUTING.md and docs/*.md

* every relative link and picture leads to a file, and to a heading where it names one;
* every Python file that a page mentions in code type exists, and in method.md every `module.name` of the sources;
* a page's ```python blocks run, one after the other, in a folder of the page's own; HTML comments of Sybil's prepare
  what a reader has (`invisible-code-block: python`) or say what a machine may lack (`skip: next if(..., reason=...)`);
* a ```bash run block is run there, and a ```console block, each line after `$` by itself, with the output that follows
  it (`...` is any text); of the other shell blocks each `handsight` line is a command that exists, with options that
  exist;
* ```json, ```yaml and ```xml blocks can be read, and a rig file among them is one.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import typer
from ruamel.yaml import YAML
from sybil import Document, Example, Region, Sybil
from sybil.parsers.markdown import CodeBlockParser, PythonCodeBlockParser, SkipParser

import handsight as hs
from handsight.cli.main import app

ROOT = Path(__file__).resolve().parent.parent
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)(?:\s+\"[^\"]*\")?\)|(?:src|href)=\"([^\"]+)\"")
ENDS = {"|", "&&", ";", ">", "<"}
SECONDS = 300
HANDS = Path(os.environ.get("HANDSIGHT_DATA", ROOT.parent / "shared" / "data")) / "hands"
os.environ |= {"MPLBACKEND": "Agg", "ROS_PACKAGE_PATH": str(HANDS)}


def links(document: Document) -> Iterable[Region]:
    """The page's links that stay in the repository."""
    blocks = [match.span() for match in FENCE.finditer(document.text)]
    for match in LINK.finditer(document.text):
        target = match[1] or match[2]
        inside = any(begin < match.start() < end for begin, end in blocks)
        if not inside and not re.match(r"[a-z]+:", target):
            yield Region(match.start(), match.end(), parsed=target, evaluator=leads)


def leads(example: Example) -> str | None:
    """What is wrong with a link."""
    page = Path(example.path)
    name, _, anchor = example.parsed.partition("#")
    file = (page.parent / name).resolve() if name else page
    if not file.exists() or not file.is_relative_to(ROOT):
        return f"{example.parsed} leads nowhere"
    if anchor and file.suffix == ".md" and anchor not in headings(file):
        return f"{example.parsed} names a heading that is not there"
    return None


def mentions(document: Document) -> Iterable[Region]:
    """The page's words in code type that name a Python file; in method.md also what a module defines."""
    text = FENCE.sub(lambda block: " " * len(block[0]), document.text)
    form = r"[\w/]+\.py|[a-z_]+\.\w+" if Path(document.path).name == "method.md" else r"[\w/]+\.py"
    for match in re.finditer(rf"`({form})`", text):
        yield Region(match.start(), match.end(), parsed=match[1], evaluator=exists)


def exists(example: Example) -> str | None:
    """What is wrong with the name of a file, or of what a module of the sources defines."""
    stem, _, name = example.parsed.rpartition(".")
    if name == "py":
        there = any(f"/{path}".endswith(f"/{example.parsed}") for path in python_files())
        return None if there else f"no file {example.parsed}"
    modules = [path for path in python_files() if path.startswith("src/") and Path(path).stem == stem]
    defined = re.compile(rf"^\s*(?:(?:def|class) {name}\b|{name}\b.*[:=])", re.MULTILINE)
    if not modules or any(defined.search((ROOT / path).read_text(encoding="utf-8")) for path in modules):
        return None
    return f"{' and '.join(modules)}: defines no {name}"


@cache
def python_files() -> list[str]:
    """The Python files of the repository, from its root."""
    folders = ("src", "tests", "docs", "examples", "experiments", "benchmarks", "testbed", "ros")
    return [path.relative_to(ROOT).as_posix() for folder in folders for path in (ROOT / folder).rglob("*.py")]


@cache
def headings(page: Path) -> set[str]:
    """The anchors that a page's headings get."""
    titles = re.findall(r"^#+ +(.+?) *$", FENCE.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def commands(example: Example) -> str | None:
    """What is wrong with the `handsight` lines of a shell block: no such command, or no such option of it."""
    wrong = [sentence for words in lines_of(example.parsed) for sentence in wrong_command(words)]
    return "\n".join(wrong) or None


def lines_of(block: str) -> Iterator[list[str]]:
    """The words after `handsight` on each of its command lines."""
    for line in block.replace("\\\n", " ").splitlines():
        words = shlex.split(line.removeprefix("$ "), comments=True)
        for k, word in enumerate(words):
            if Path(word).name == "handsight" and (k == 0 or words[k - 1] in ENDS):
                rest = words[k + 1 :]
                yield rest[: next((i for i, word in enumerate(rest) if word in ENDS), len(rest))]


def wrong_command(words: list[str]) -> Iterator[str]:
    """What is wrong with one command line."""
    command: Any = typer.main.get_command(app)
    said, rest = "handsight", list(words)
    while hasattr(command, "commands") and rest and not rest[0].startswith("-"):
        name = rest.pop(0)
        if name not in command.commands:
            yield f"`{said} {name}` is no command"
            return
        said, command = f"{said} {name}", command.commands[name]
    known = {"--help", *(option for each in command.params for option in (*each.opts, *each.secondary_opts))}
    options = (word.partition("=")[0] for word in rest if re.match(r"--?[a-zA-Z]", word))
    yield from (f"`{said}` has no option {option}" for option in options if option not in known)


def bash(script: str) -> "subprocess.CompletedProcess[str]":
    """Runs a script with this Python's commands."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        env=os.environ | {"PATH": path, "TERM": "dumb"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=SECONDS,
    )


def run(example: Example) -> str | None:
    """Runs a shell block; what it said if it failed."""
    done = bash(str(example.parsed))
    return f"exit code {done.returncode}: {done.stderr}" if done.returncode else commands(example)


def shown(example: Example) -> str | None:
    """What is wrong with a block of commands and their outputs, which is what is printed to both channels."""
    for block in re.split(r"^\$ ", str(example.parsed), flags=re.MULTILINE)[1:]:
        command, _, expected = block.partition("\n")
        printed = bash(f"exec 2>&1\n{command}").stdout
        pattern = ".*".join(re.escape(part) for part in expected.strip().split("..."))
        if not re.fullmatch(pattern, printed.strip(), re.DOTALL):
            return f"$ {command}\nexpected:\n{expected}\ngot:\n{printed}"
    return commands(example)


def readable(example: Example) -> str | None:
    """What is wrong with a block of data; a rig file is read as one."""
    language, text = example.region.lexemes["arguments"], str(example.parsed)
    if language == "yaml" and re.search(r"^version:", text, re.MULTILINE):
        rig = Path("of-the-page.rig.yaml")
        rig.write_text(text)
        hs.Rig.from_file(rig)
    elif language == "yaml":
        YAML(typ="safe").load(text)
    elif language == "json":
        [json.loads(line) for line in text.splitlines()]
    else:
        ElementTree.fromstring(text)
    return None


def begin(namespace: dict[str, Any]) -> None:
    """A folder for the page's files, with the examples in it; `no_allegro` says why that hand's blocks are skipped."""
    folder = tempfile.TemporaryDirectory()
    namespace |= {
        "no_allegro": not (HANDS / "allegro_hand").is_dir(),
        "_before": Path.cwd(),
        "_folder": folder,
    }
    os.chdir(folder.name)
    os.symlink(ROOT / "examples", "examples")


def end(namespace: dict[str, Any]) -> None:
    """Back to where the run began."""
    os.chdir(namespace["_before"])
    namespace["_folder"].cleanup()


shells = [CodeBlockParser(language, commands) for language in ("bash", "sh", "shell")]
data = [CodeBlockParser(language, readable) for language in ("json", "yaml", "xml")]
pytest_collect_file = Sybil(
    [
        SkipParser(),
        PythonCodeBlockParser(),
        links,
        mentions,
        CodeBlockParser("bash run", run),
        CodeBlockParser("console", shown),
        *shells,
        *data,
    ],
    path=str(ROOT),
    patterns=["README.md", "CONTRIBUTING.md", "docs/*.md"],
    setup=begin,
    teardown=end,
).pytest()
