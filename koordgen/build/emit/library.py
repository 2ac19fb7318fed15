"""What generated programs import: where each name comes from, and which of them a text uses."""

from __future__ import annotations

import re
from collections.abc import Iterator

_MODULES: dict[str, tuple[str, ...]] = {
    "math": ("acos", "asin", "atan", "atan2", "ceil", "cos", "exp", "floor", "log", "sin", "sqrt", "tan"),
    "typing": ("Annotated", "Any"),
    "msgspec": ("Struct",),
    "msgspec.structs": ("replace",),
    "koordgen.runtime.values.bounds": ("Blob", "Cells", "Distinct", "Fixed", "Many", "Pairs", "Parts", "Rays", "Text"),
    "koordgen.runtime.values.containers": (
        "appended", "at", "difference", "extended", "first", "has_key", "index_of", "inserted", "intersection", "keys",
        "last", "map_at", "map_get", "map_of", "map_with", "map_without", "popped", "power", "removed", "set_of",
        "set_with", "set_without", "slice_", "total", "union", "updated", "values", "without",
    ),
    "koordgen.runtime.program.extern": ("Extern", "Library"),
    "koordgen.runtime.values.gridmap": ("GridMap", "cell", "center", "is_free", "is_known", "is_occupied"),
    "koordgen.runtime.program.metered": ("area", "clear", "mark_free", "mark_occupied", "merge", "path_distance"),
    "koordgen.runtime.program.program": (
        "Cell", "Event", "Frame", "Port", "Program", "Slots", "Stopped", "Transaction", "Variable", "behind", "claim",
    ),
    "koordgen.runtime.program.property": (
        "Asking", "Assumption", "Each", "Known", "One", "Properties", "Property", "Trail", "Unchecked",
    ),
    "koordgen.runtime.values.region": ("Ball", "Rect"),
    "koordgen.runtime.values.text": ("part", "shown"),
    "koordgen.runtime.values.turns": (
        "checked", "looked", "looked_in", "made", "minus", "plus", "product", "turn", "turns",
    ),
    "koordgen.runtime.values.points": ("Grid", "Opaque", "Point", "Pose", "Scan", "distance", "no_nan", "no_nan_in"),
}  # fmt: skip
HOME = {name: module for module, names in _MODULES.items() for name in names}


_WORD = re.compile(r"(?<![\w.\"'])([A-Za-z_]\w*)(\(?)")


def imports(body: str) -> tuple[list[str], list[str], list[str]]:
    """The import lines that a module's text needs: of Python's library, of packages, of the runtime. Functions are
    called, never spoken of; a class may stand in an annotation."""
    used = {word for word, called in _WORD.findall(body) if called or word[0].isupper()}
    groups: tuple[list[str], list[str], list[str]] = ([], [], [])
    for module, names in _MODULES.items():
        found = [name for name in names if name in used]
        if found:
            group = groups[2 if module.startswith("koordgen") else 1 if module.startswith("msgspec") else 0]
            group += _lines(module, found)
    return groups


def _lines(module: str, names: list[str]) -> Iterator[str]:
    line = f"from {module} import {', '.join(names)}"
    if len(line) <= 120:
        yield line
    else:
        yield f"from {module} import ("
        yield from (f"    {name}," for name in names)
        yield ")"
