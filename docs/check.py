"""Checks that the pages keep their word; run by .ci/run, from anywhere.

* every relative link and picture in README.md, CONTRIBUTING.md and docs/*.md leads to a file, and to a
  heading where it names one;
* the ```python blocks of README.md run, in order, as one program;
* each `handsight` command line in a shell block of a page is a command that exists, with options that exist;
* each ```yaml block of a page is a rig file that can be read.
"""

import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)(?:\s+\"[^\"]*\")?\)|(?:src|href)=\"([^\"]+)\"")
GROUPS = {"rig", "calibrate", "objects"}
"""Commands that have commands."""
ENVIRONMENT = {**os.environ, "MPLBACKEND": "Agg", "COLUMNS": "200", "TERM": "dumb", "NO_COLOR": "1"}


def pages() -> list[Path]:
    """Every page that a reader is led to."""
    return [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def headings(page: Path) -> set[str]:
    """The anchors that the page's headings get."""
    titles = re.findall(r"^#+ +(.+?) *$", FENCE.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def broken_links(page: Path) -> list[str]:
    """What is wrong with the page's links, a sentence each."""
    wrong = []
    for match in LINK.finditer(FENCE.sub("", page.read_text())):
        target = match[1] or match[2]
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        if not file.exists() or not file.is_relative_to(ROOT):
            wrong.append(f"{page.relative_to(ROOT)}: {target} leads nowhere")
        elif anchor and file.suffix == ".md" and anchor not in headings(file):
            wrong.append(f"{page.relative_to(ROOT)}: {target} names a heading that is not there")
    return wrong


def blocks(page: Path, languages: set[str]) -> list[str]:
    """A page's fenced blocks in one of the languages."""
    return [body for language, body in FENCE.findall(page.read_text()) if language in languages]


def broken_python() -> list[str]:
    """The error that README's program ends in, if it does."""
    program = "\n".join(blocks(README, {"python"}))
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True
    )
    return [f"README.md: its python blocks fail:\n{done.stderr.strip()}"] if done.returncode else []


def command_lines(page: Path) -> list[list[str]]:
    """The words after `handsight` on each command line of a page's shell blocks."""
    found = []
    for block in blocks(page, {"bash", "sh", "shell", "console"}):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line.removeprefix("$ "), comments=True)
            for k, word in enumerate(words):
                if Path(word).name == "handsight" and (k == 0 or words[k - 1] in {"|", "&&", ";"}):
                    rest = words[k + 1 :]
                    end = next((i for i, w in enumerate(rest) if w in {"|", "&&", ";", ">", "<"}), len(rest))
                    found.append(rest[:end])
    return found


def broken_command(page: Path, words: list[str]) -> list[str]:
    """What is wrong with one command line: the command, or an option of it, does not exist."""
    depth = 2 if GROUPS & set(words[:1]) else 1
    command = [word for word in words[:depth] if not word.startswith("-")]
    program = Path(sys.executable).with_name("handsight")
    done = subprocess.run([program, *command, "--help"], env=ENVIRONMENT, capture_output=True, text=True)
    if done.returncode:
        return [f"{page.name}: `handsight {' '.join(command)}` is no command"]
    known = set(re.findall(r"(?<![\w-])--?[a-zA-Z][\w-]*", done.stdout))
    options = [word.partition("=")[0] for word in words if re.match(r"--?[a-zA-Z]", word)]
    return [
        f"{page.name}: `handsight {' '.join(command)}` has no option {option}"
        for option in options
        if option not in known
    ]


def broken_rigs(page: Path) -> list[str]:
    """What is wrong with the page's rig files."""
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        for text in blocks(page, {"yaml"}):
            rig = Path(folder, "rig.yaml")
            rig.write_text(text)
            command = [Path(sys.executable).with_name("handsight"), "rig", "check", rig]
            done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True)
            if done.returncode:
                wrong.append(f"{page.name}: its rig is none: {done.stderr.strip()}")
    return wrong


def main() -> int:
    """0 if every page keeps its word; else what does not, and 1."""
    commands = [(page, words) for page in pages() for words in command_lines(page)]
    wrong = [sentence for page in pages() for sentence in broken_links(page)]
    wrong += broken_python() + [
        sentence for page, words in commands for sentence in broken_command(page, words)
    ]
    wrong += [sentence for page in pages() for sentence in broken_rigs(page)]
    print("\n".join(wrong) or f"{len(pages())} pages and {len(commands)} command lines keep their word")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
