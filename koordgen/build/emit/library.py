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

# Names and operators, with what is said of them where a module has one of them. A call that is shown stands for all.
_NOTES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("int",), "a + b of ints", "never overflows; an int beyond 64 bits that a variable would keep discards the event"),
    (("//", "%"), "a // b, a % b", "round down, also below 0, as in Koord: -7 // 2 is -4, -7 % 2 is 1"),
    (("/",), "a / b", "a float, also of two ints; if b is 0, the event is discarded"),
    (("plus", "minus", "product", "checked"), "plus(a, b), ...", "a + b, ... of ints that may be large; discards the event beyond 4096 bits"),
    (("power",), "power(a, b)", "a ** b; of two ints an int, and a negative b discards the event"),
    (("round",), "round(x)", "to the nearest int; of two that are equally near, to the even one: round(2.5) is 2"),
    (("no_nan", "no_nan_in"), "no_nan(x)", "x; discards the event if it is NaN, where Python's comparison is false"),
    (("total",), "total(xs)", "the sum of floats from left to right, the same on all robots and Pythons"),
    (("str", "shown"), "str(x), shown(p)", "numbers as Python writes them, such as 2.5 and 1e+20; a Point as (x, y, z)"),
    (("at", "first", "last"), "at(xs, i)", "xs[i]; discards the event if there is none; i does not count from the end"),
    (("[]",), "xs[i]", "the compiler has shown that 0 <= i < len(xs)"),
    (("slice_", "part"), "slice_(xs, a, b)", "xs[a:b]; discards the event if a or b is negative"),
    (("updated", "appended", "extended", "inserted", "removed", "without", "popped", "replace", "map_with", "map_without", "set_with", "set_without"),
     "replace(r, f=v)", "a new value; records and lists never change, so that an assignment need not copy them"),
    (("set_of", "map_of", "map_at", "map_get", "keys", "values", "has_key", "union", "intersection", "difference"),
     "set_of, map_of", "sets and maps are sorted tuples: all robots go through them in one order"),
    (("turn", "turns"), "turns(xs)", "xs; a turn of a loop or a call takes a turn, and an event has 1,000,000"),
    (("made", "looked", "looked_in"), "made(xs)", "xs, new; looked(xs): xs, read; each 100 elements take a turn"),
    (("claim", "behind"), "claim(n, holds)", "True; reports the loop invariant of line n where it does not hold"),
    (("calls",), "f(x) + g(y)", "is evaluated from left to right, as in Koord"),
)  # fmt: skip
_HEADING = "# What stands below, where one may ask whether Python does as Koord:"


def imports(used: Container[str]) -> tuple[list[str], list[str], list[str]]:
    """The import lines for what is used: of Python's library, of packages, of the runtime. A text may be given for its
    names: then what it has in other words, too, is imported."""
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
    page.add(brackets(f"from {module} import (", names, ")"))
    return [line for line, _ in page.lines]


def notes(used: Container[str]) -> list[str]:
    """The comments on what is used; none where nothing needs one."""
    found = [(shown, says) for keys, shown, says in _NOTES if any(key in used for key in keys)]
    return [_HEADING, *(f"#   {shown:<18}{says}" for shown, says in found)] if found else []
