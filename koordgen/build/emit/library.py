"""What generated programs import, and what the head of a module explains: where Python could be taken to do something
else than Koord."""

from __future__ import annotations

from collections.abc import Container

from koordgen.build.emit.layout import WIDTH, Page, brackets

# In the order in which they are imported.
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
        "Asking", "Assumption", "Each", "Known", "One", "Properties", "Property", "Trail", "Unchecked",
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
# Names, and marks of operators (`expr.py`), with what is said of them where a module has one: what is shown, how it is
# meant. In generated code, so short: what is "discarded" there is the event, as a whole.
_NOTES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("+",), "a + b", "of ints has no overflow; more than 64 bits in a variable discard the event"),
    (("//", "%"), "a // b, a % b", "round down, also below 0: -7 // 2 is -4, and -7 % 2 is 1"),
    (("/",), "a / b", "of ints is a float; b == 0 discards the event"),
    (("[]",), "xs[i]", "never counts from the end: the compiler has shown that 0 <= i < len(xs)"),
    (("at", "first", "last"), "at(xs, i)", "is xs[i]; an i below 0 or beyond the end discards the event"),
    (("slice_", "part"), "slice_(xs, a, b)", "is xs[a:b]; an a or b below 0 discards the event"),
    (("power",), "power(a, b)", "is a ** b, of two ints an int; then b < 0 discards the event"),
    (("plus", "minus", "product", "checked"), "plus(a, b)", "is a + b; more than 4096 bits discard the event"),
    (("total",), "total(xs)", "adds floats from left to right: Pythons differ in what `sum` rounds to"),
    (("round",), "round(x)", "takes the even one of two ints that are as near: round(2.5) is 2"),
    (("no_nan", "no_nan_in"), "no_nan(x)", "is x; NaN discards the event, where a comparison alone would be false"),
    (("str()", "shown"), "str(x), shown(p)", "write numbers as Python does, 2.5 or 1e+20, and a Point as (x, y, z)"),
    (_CHANGES, "appended, replace", "make a new value: none ever changes, so an assignment need not copy"),
    (_SORTED, "set_of, map_of", "make sorted tuples: robots go through a set or map in the same order"),
    (("turn", "turns"), "turns(xs)", "is xs, and counts: an event has a million turns of loops and calls"),
    (("made", "looked", "looked_in"), "made(xs)", "is xs, and counts a turn for each 100 elements; so does looked(xs)"),
    (("claim",), "claim(n, holds)", "is True, and reports the loop invariant of line n where it does not hold"),
    (("calls",), "f(a) + g(b)", "calls f first: operands are evaluated from left to right, as in Koord"),
)  # fmt: skip


def imports(used: Container[str]) -> tuple[list[str], list[str], list[str]]:
    """Return the import lines for the names that are used: of Python's library, of packages, of the runtime."""
    groups: tuple[list[str], list[str], list[str]] = ([], [], [])
    for module, names in _MODULES.items():
        found = [name for name in names if name in used]
        if found:
            group = groups[2 if module.startswith("koordgen") else 1 if module.startswith("msgspec") else 0]
            group += imported(module, found)
    return groups


def imported(module: str, names: list[str]) -> list[str]:
    """The lines that import names from a module."""
    flat = f"from {module} import {', '.join(names)}"
    if len(flat) <= WIDTH:
        return [flat]
    page = Page()
    page.add(brackets(f"from {module} import (", names, ")", dense=True))
    return [line for line, _ in page.lines]


def notes(used: Container[str], heading: str) -> list[str]:
    """The comments on what is used; none where nothing needs one."""
    found = [f"#   {shown:<18}{says}" for keys, shown, says in _NOTES if any(key in used for key in keys)]
    return [heading, *found] if found else []
