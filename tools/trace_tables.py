"""Generator of the tables of docs/reference/trace.md that describe a trace, from the types and comments of its schema.

    python -m tools.trace_tables [--check]

In `koordgen/runtime/trace/schema.py`, the comment of a field says what the key means, with its unit in brackets. A
field without a comment is an error (exit status 1). With --check nothing is written, and the exit status is 1 if the
tables of the page are out of date.
"""

from __future__ import annotations

import ast
import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
SCHEMA, PAGE = ROOT / "koordgen/runtime/trace/schema.py", ROOT / "docs/reference/trace.md"
BEGIN, END = "<!-- tables of the schema: python -m tools.trace_tables -->", "<!-- end of the tables -->"
NAMES = {
    "str": "text", "int": "integer", "float": "number", "bool": "boolean", "Any": "JSON", "Raw": "JSON",
    "None": "null", "Values": "values by name", "Vector": "[x, y, z]", "RoundNumber": "integer",
    "LastRound": "integer", "Incarnation": "integer", "Found": "text", "Obstacle": "obstacle",
}  # fmt: skip


class NoComment(Exception):
    """Raised for a field of the schema without a comment. The message names it."""


def tables() -> str:
    """Return all tables. Raises NoComment."""
    text = SCHEMA.read_text(encoding="utf-8")
    classes = [node for node in ast.parse(text).body if isinstance(node, ast.ClassDef) and _is_public(node)]
    heads = {node.name: _heading(node) for node in classes}
    return "\n\n".join(_table(node, heads, text.splitlines()) for node in classes) + "\n"


def _is_public(node: ast.ClassDef) -> bool:
    bases = {ast.unparse(base) for base in node.bases}
    return not node.name.startswith("_") and bool(bases & {"msgspec.Struct", "TypedDict"})


def _heading(node: ast.ClassDef) -> str:
    tag = next((ast.literal_eval(each.value) for each in node.keywords if each.arg == "tag"), "")
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", node.name).lower()
    return {"RobotHeader": "header of a robot's own trace", "Header": "header of a merged trace"}.get(
        node.name, tag or words
    )


def _table(node: ast.ClassDef, heads: dict[str, str], lines: list[str]) -> str:
    name, is_record = heads[node.name], any(each.arg == "tag" for each in node.keywords)
    title = name.capitalize() if "header" in name else f"Record `{name}`" if is_record else f"Value: {name}"
    rows = [f"### {title}", ""]
    rows += [
        *textwrap.wrap(" ".join((ast.get_docstring(node) or "").split()), 100, break_on_hyphens=False),
        "",
        "| key | type | unit | meaning |",
        "|---|---|---|---|",
    ]
    if is_record:
        rows.append(f"| `kind` | text | | `{name.split()[0]}` |")
    for field in node.body:
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            _, _, comment = lines[field.lineno - 1].partition("  # ")
            if not comment:
                raise NoComment(f"{SCHEMA}:{field.lineno}: {field.target.id} has no comment")
            meaning, _, unit = comment.partition(" [")
            if "UnsetType" in ast.unparse(field.annotation):
                meaning += "; left out elsewhere"
            type_ = " or ".join(_types(field.annotation, heads))
            rows.append(f"| `{field.target.id}` | {type_} | {unit.rstrip(']')} | {meaning} |".replace("|  |", "| |"))
    return "\n".join(rows)


def _types(node: ast.expr, heads: dict[str, str]) -> Iterator[str]:
    """Yield the names of a field's types, one for each alternative."""
    match node:
        case ast.BinOp(left=left, right=right):
            yield from _types(left, heads)
            yield from _types(right, heads)
        case ast.Name(id="UnsetType"):
            return
        case ast.Name(id=name) | ast.Attribute(attr=name):
            yield NAMES.get(name) or heads[name]
        case ast.Constant(value=value):
            yield "null" if value is None else f"`{value!s}`"
        case ast.Subscript(value=ast.Name(id="Literal"), slice=ast.Tuple(elts=words)):
            for word in words:
                yield from _types(word, heads)
        case ast.Subscript(value=ast.Name(id="Annotated"), slice=ast.Tuple(elts=[first, *_])):
            yield from _types(first, heads)
        case ast.Subscript(value=ast.Name(id="Mapping" | "dict"), slice=ast.Tuple(elts=[_, value])):
            yield f"object of {' or '.join(_types(value, heads))}"
        case ast.Subscript(slice=ast.Tuple(elts=[each, ast.Constant()])):
            yield f"list of {' or '.join(_types(each, heads))}"
        case ast.Subscript(slice=ast.Tuple(elts=parts)):
            yield f"[{', '.join(' or '.join(_types(each, heads)) for each in parts)}]"
        case _:
            raise TypeError(ast.unparse(node))


def main(arguments: list[str]) -> int:
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(f"{BEGIN}\n")
    _, _, after = rest.partition(f"\n{END}")
    try:
        made = f"{before}{BEGIN}\n\n{tables()}\n{END}{after}"
    except NoComment as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if "--check" in arguments:
        return int(made != page)
    PAGE.write_text(made, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
