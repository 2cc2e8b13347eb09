"""Identifiers and file names in `src` are in the field's words: the glossary of CONTRIBUTING, read by this test."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))
MODULES = {
    "apart",
    "asked",
    "closing",
    "dynamics",
    "blind",
    "lent",
    "linked",
    "loaded",
    "located",
    "past",
    "told",
}
"""Participles and what is missing name no file; a function may have such a name."""


def glossary() -> dict[str, str]:
    """The words that no identifier has, each with the one to use instead."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| ([^|]+?) \| ([^|]+) \|([^|]*)\|$", text.split("\n## Words\n")[1].split("\n## ")[0], re.M
    )
    assert len(rows) >= 60
    return {word: use for use, _, banned in rows if use != "word" for word in re.findall(r"\w+", banned)}


def words(name: str) -> set[str]:
    """The words of an identifier, between underscores and at capitals."""
    return {word.lower() for word in re.findall(r"[a-z]+|[A-Z]+(?![a-z])|[A-Z][a-z]*", name)}


def identifiers(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Every name that a file defines, and its line."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                yield node.name, node.lineno
            case ast.arg():
                yield node.arg, node.lineno
            case ast.Name(ctx=ast.Store()):
                yield node.id, node.lineno
            case ast.Attribute(ctx=ast.Store()):
                yield node.attr, node.lineno
            case ast.alias(asname=str(name)):
                yield name, node.lineno


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT / "src")))
def test_identifiers_are_in_the_glossary_s_words(path):
    banned = glossary()
    found = [
        f"{path.name}:{line}: {name} has '{word}': {banned[word]}"
        for name, line in identifiers(ast.parse(path.read_text(encoding="utf-8")))
        for word in sorted(words(name) & banned.keys())
    ]
    assert not found, "\n".join(found)


def test_files_and_folders_are_named_by_nouns_of_the_field():
    banned = glossary().keys() | MODULES
    sources = [path for path in SOURCES if not path.read_text(encoding="utf-8").startswith('"""Deprecated')]
    parts = {part for path in sources for part in path.relative_to(ROOT / "src").with_suffix("").parts}
    assert not {part for part in parts if words(part) & banned}


def test_the_words_of_a_name_are_found_between_underscores_and_capitals():
    assert words("_T_mount_palmSeen") == {"t", "mount", "palm", "seen"}
    assert words("HTTPLook2") == {"http", "look"}
