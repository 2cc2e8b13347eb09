"""Draws docs/architecture.svg, the rooms of handsight and what each imports, and lists them in docs/architecture.md.

Everything is read from the sources: `python docs/architecture.py` writes the picture and the table of rooms,
`tests/test_architecture.py` holds them to the sources.
"""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "src" / "handsight"
PICTURE, PAGE = ROOT / "docs" / "architecture.svg", ROOT / "docs" / "architecture.md"
NAMES = {"_kernels": "kernels"}
WIDTH, ROW, BOX = 760, 70, 34
"""Of the picture, of a layer, and of a room's box [pixels]."""
COLORS = ("#e8eef7", "#e3f1e6", "#fbf0dd", "#f3e6f2")


def modules() -> dict[str, Path]:
    """Returns every module of the package by its dotted name."""
    found = {}
    for path in sorted(SOURCE.rglob("*.py")):
        if path.name != "__main__.py":
            parts = path.relative_to(SOURCE.parent).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(name: str, path: Path, known: dict[str, Path]) -> Iterator[str]:
    """Yields the modules of the package that a module imports, anywhere but for type checkers alone."""
    skipped: set[ast.AST] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            skipped.update(child for statement in node.body for child in ast.walk(statement))
        if node in skipped:
            continue
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "handsight":
            for alias in node.names:
                target = f"{node.module}.{alias.name}"
                yield target if target in known else node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)


def graph() -> dict[str, set[str]]:
    """Returns for every module those of the package that it imports."""
    known = modules()
    return {name: {m for m in imports(name, path, known) if m != name} for name, path in known.items()}


def room(module: str) -> str:
    """Returns the room of a module: the folder or the file right below the package."""
    return [*module.split("."), ""][1]


def layers() -> list[list[str]]:
    """Returns the rooms layer by layer, the highest first, as import-linter is told to hold them."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    rows = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    return [re.findall(r"handsight\.(\w+)", row) for row in rows]


def arrows() -> set[tuple[str, str]]:
    """Returns which room imports which, without what already follows through a third."""
    direct: dict[str, set[str]] = {}
    for module, targets in graph().items():
        if room(module):
            direct.setdefault(room(module), set()).update(room(t) for t in targets)
    drawn = {name for row in layers() for name in row if (SOURCE / name).is_dir()}
    direct = {a: {b for b in bs if b != a and b in drawn} for a, bs in direct.items() if a in drawn}

    def reach(a: str) -> set[str]:
        return direct[a].union(*(reach(b) for b in direct[a]))

    return {(a, b) for a in direct for b in direct[a] if not any(b in reach(c) for c in direct[a] - {b})}


def purposes() -> dict[str, str]:
    """Returns for each room the first sentence of its docstring."""
    docs = {m: ast.get_docstring(ast.parse(p.read_text(encoding="utf-8"))) for m, p in modules().items()}
    return {
        room(m): (text or "").partition("\n")[0] for m, text in docs.items() if m == f"handsight.{room(m)}"
    }


def picture() -> str:
    """Returns the picture as SVG; modules that are no folders, on which all rooms stand, are one box at its foot."""
    rows = [[name for name in row if (SOURCE / name).is_dir()] for row in layers()]
    rows = [row for row in rows if row]
    base = [name for row in layers() for name in row if not (SOURCE / name).is_dir()]
    height = ROW * (len(rows) + 1)
    places: dict[str, tuple[float, float, float]] = {}
    boxes = []
    for i, row in enumerate(rows):
        widths = [28 + 8.4 * len(NAMES.get(name, name)) for name in row]
        gap = (WIDTH - sum(widths)) / (len(row) + 1)
        x, y = gap, 12 + ROW * i
        for name, width in zip(row, widths, strict=True):
            places[name] = x, y, width
            boxes.append(_box(x, y, width, NAMES.get(name, name), COLORS[i * len(COLORS) // len(rows)]))
            x += width + gap
    boxes.append(_box(20, 12 + ROW * len(rows), WIDTH - 40, ", ".join(base), "#eeeeee"))
    lines = []
    for a, b in sorted(arrows()):
        (xa, ya, wa), (xb, yb, wb) = places[a], places[b]
        x1, y1, x2, y2 = xa + wa / 2, ya + BOX, xb + wb / 2, yb - 2
        bend = (y2 - y1) / 2
        lines.append(
            f'<path d="M{x1:.0f},{y1} C{x1:.0f},{y1 + bend:.0f} {x2:.0f},{y2 - bend:.0f} {x2:.0f},{y2}"/>'
        )
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" '
            'font-size="14">',
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
            'orient="auto"><path d="M0,0 L8,4 L0,8 z" fill="#889"/></marker></defs>',
            f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
            '<g fill="none" stroke="#99a" stroke-width="1.2" marker-end="url(#tip)">',
            *lines,
            "</g>",
            *boxes,
            "</svg>",
            "",
        ]
    )


def _box(x: float, y: float, width: float, text: str, color: str) -> str:
    return (
        f'<rect x="{x:.0f}" y="{y}" width="{width:.0f}" height="{BOX}" rx="6" fill="{color}" stroke="#556"/>'
        f'<text x="{x + width / 2:.0f}" y="{y + 22}" text-anchor="middle">{text}</text>'
    )


def table() -> str:
    """Returns the rooms from the highest layer to the lowest, and what each is for, as a Markdown table."""
    purpose = purposes()
    rows = [f"| `{name}` | {purpose[name].replace('|', '/')} |" for row in layers() for name in row]
    return "\n".join(["| room | what it is for |", "|---|---|", *rows])


def page(text: str) -> str:
    """Returns the page's text with its table of rooms made anew."""
    return re.sub(
        r"(?<=<!-- rooms -->\n\n).*?(?=\n\n<!-- end -->)", table().replace("\\", r"\\"), text, flags=re.S
    )


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
