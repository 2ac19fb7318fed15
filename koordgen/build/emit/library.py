"""Imports of generated modules, and the comments at a module's head that explain the functions it uses."""

from __future__ import annotations

from collections.abc import Container

from koordgen.build.emit.layout import WIDTH, Page, brackets

# Modules of the generated import lines, in the order of the lines.
_MODULES: dict[str, tuple[str, ...]] = {
    "math": ("acos", "asin", "atan", "atan2", "ceil", "cos", "exp", "floor", "log", "sin", "sqrt", "tan"),
    "typing": ("Annotated", "Any"),
    "msgspec": ("Struct",),
    "msgspec.structs": ("replace",),
    "koordgen.runtime.program.extern": ("Extern", "Library"),
    "koordgen.runtime.program.metered": ("area", "clear", "mark_free", "mark_occupied", "merge", "path_distance"),
    "koordgen.runtime.program.program": (
        "Cell", "Event", "Frame", "Port", "Program", "Slots", "Stopped", "Transaction", "Variable", "behind", "claim",
    ),
    "koordgen.runtime.program.property": (
        "Assumption", "Each", "GoalCall", "Known", "One", "Properties", "Property", "Trail", "Unchecked",
    ),
    "koordgen.runtime.values.bounds": ("Blob", "Cells", "Distinct", "Fixed", "Many", "Pairs", "Parts", "Rays", "Text"),
    "koordgen.runtime.values.containers": (
        "appended", "at", "difference", "extended", "first", "has_key", "index_of", "inserted", "intersection", "keys",
        "last", "map_at", "map_get", "map_of", "map_with", "map_without", "popped", "power", "removed", "set_of",
        "set_with", "set_without", "slice_", "total", "union", "updated", "values", "without",
    ),
    "koordgen.runtime.values.gridmap": ("GridMap", "cell", "center", "is_free", "is_known", "is_occupied"),
    "koordgen.runtime.values.points": (
        "Grid", "Opaque", "Point", "Pose", "Scan", "distance", "no_nan", "no_nan_in",
    ),
    "koordgen.runtime.values.region": ("Ball", "Rect"),
    "koordgen.runtime.values.text": ("part", "shown"),
    "koordgen.runtime.values.turns": (
        "checked", "looked", "looked_in", "made", "minus", "plus", "product", "turn", "turns",
    ),
}  # fmt: skip
HOME = {name: module for module, names in _MODULES.items() for name in names}

_CHANGES = (
    "updated", "appended", "extended", "inserted", "removed", "without", "popped", "replace", "map_with", "map_without",
    "set_with", "set_without",
)  # fmt: skip
_SORTED = ("set_of", "map_of", "map_at", "map_get", "keys", "values", "has_key", "union", "intersection", "difference")
# Each row: names or marks of operators (see `expr.py`), an example, and its explanation. A generated module contains
# the explanation if it uses one of the names or operators. "Discards the event": the whole event has no effect.
_NOTES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("+",), "a + b", "of ints has no overflow; more than 64 bits in a variable discard the event"),
    (("//", "%"), "a // b, a % b", "round down, also below 0: -7 // 2 is -4, and -7 % 2 is 1"),
    (("/",), "a / b", "of ints is a float; b == 0 discards the event"),
    (("[]",), "xs[i]", "never counts from the end: the compiler has proved 0 <= i < len(xs)"),
    (("at", "first", "last"), "at(xs, i)", "is xs[i]; i < 0 or i >= len(xs) discards the event"),
    (("slice_", "part"), "slice_(xs, a, b)", "is xs[a:b]; a < 0 or b < 0 discards the event"),
    (("power",), "power(a, b)", "is a ** b; of two ints it is an int, and b < 0 discards the event"),
    (("plus", "minus", "product", "checked"), "plus(a, b)", "is a + b; more than 4096 bits discard the event"),
    (("total",), "total(xs)", "adds floats from left to right: how `sum` rounds depends on Python's version"),
    (("round",), "round(x)", "rounds half to even: round(2.5) is 2"),
    (("no_nan", "no_nan_in"), "no_nan(x)", "is x; NaN discards the event, where a comparison alone would be false"),
    (("str()", "shown"), "str(x), shown(p)", "write numbers as Python does, 2.5 or 1e+20, and a Point as (x, y, z)"),
    (_CHANGES, "appended, replace", "make a new value: values never change, so an assignment need not copy"),
    (_SORTED, "set_of, map_of", "make sorted tuples: all robots iterate over a set or map in the same order"),
    (("turn", "turns"), "turns(xs)", "is xs, and counts turns: an event has at most a million turns and calls"),
    (("made", "looked", "looked_in"), "made(xs)", "is xs, and counts a turn for each 100 elements; so does looked(xs)"),
    (("claim",), "claim(n, holds)", "is True, and reports the loop invariant of line n if it is false"),
    (("calls",), "f(a) + g(b)", "calls f first: operands are evaluated from left to right, as in Koord"),
)  # fmt: skip


def imports(used: Container[str]) -> tuple[list[str], list[str], list[str]]:
    """Return the import lines for used names, in three groups: Python's library, packages, the runtime."""
    groups: tuple[list[str], list[str], list[str]] = ([], [], [])
    for module, names in _MODULES.items():
        found = [name for name in names if name in used]
        if found:
            group = groups[2 if module.startswith("koordgen") else 1 if module.startswith("msgspec") else 0]
            group += imported(module, found)
    return groups


def imported(module: str, names: list[str]) -> list[str]:
    """Return the lines of one import statement."""
    flat = f"from {module} import {', '.join(names)}"
    if len(flat) <= WIDTH:
        return [flat]
    page = Page()
    page.add(brackets(f"from {module} import (", names, ")", dense=True))
    return [line for line, _ in page.lines]


def notes(used: Container[str], heading: str) -> list[str]:
    """Return the comment lines that explain the used names and operators; [] if no explanation is needed."""
    found = [f"#   {shown:<18}{says}" for keys, shown, says in _NOTES if any(key in used for key in keys)]
    return [heading, *found] if found else []
