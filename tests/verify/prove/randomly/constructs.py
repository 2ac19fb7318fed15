"""Language constructs in a text, for tables of coverage."""

from __future__ import annotations

import re
from typing import NamedTuple

from tests.verify.prove.randomly.names import WORDS


def _names(*types: str) -> str:
    return "(?:" + "|".join(word for type_ in types for word in WORDS[type_]) + ")"


LISTS, MAPS = (
    _names("List<int>", "List<Task>", "List<List<int>>", "List<Point>"),
    _names("Map<int, int>", "Map<string, int>"),
)
LOOP = r"^\s*(?:for|while) "


class Block(NamedTuple):
    """A function, `init`, an event or a line of anything else; `kind` says which."""

    kind: str
    text: str


ANYWHERE: dict[str, str] = {
    "for over a range of numbers": r"for \w+ in range\(\d+(?:, \d+)?\)",
    "for over a range without a known end": r"for \w+ in range\([^)]*[a-z]",
    "for with a step": r"for .* in range\(.*, .*, [23]\)",
    "for downwards": r"for .* in range\(.*, -1\)",
    "for over robots": r"for \w+ in (?:ID|range\(N_SYS)",
    "for over a list": rf"for \w+ in (?:{LISTS}|values)(?:\[pid\])?:",
    "for over a map's keys": rf"for \w+ in {MAPS}(?:\[pid\])?(?:\.keys\(\))?:",
    "for over pairs": r"for \w+, \w+ in ",
    "for over a set": rf"for \w+ in {_names('Set<int>')}(?:\[pid\])?:",
    "while with a condition": r"while (?!True)",
    "while True": r"while True:",
    "break": r"\bbreak\b",
    "continue": r"\bcontinue\b",
    "return in a loop": r"if .*: return .*\n(?=.*\n)",
    "search with break": r"for .*:\n\s*if .*:\n(?:.*\n)+?\s*break\b",
    "fold": r"for .*:\n\s*(\S+) (?:= (?:max|min)\(\1|\+=)",
    "invariant of a loop": r"^ +invariant ",
    "priority": r"^priority:",
    "stop": r"\bstop\b",
    "atomic": r"eff: atomic:",
    "param": r"^param ",
    "stream": r"Log\.stdout <<",
    "planner": r"PathPlanner",
    "planner that is called": r"Motion\.planner\(",
    "target with position": r"Point position\n(?:.*\n)*?\s+actuators: Point target",
    "reached": r"sensors: bool reached",
    "assumption": r"^ +assume ",
    "sensor of ints": r"sensors: int",
    "sensor of bools": r"sensors: bool on",
    "sensor of floats": r"sensors: float",
    "allread": r"^allread:",
    "allwrite": r"^allwrite:",
    "list": r"^ +List<int> ",
    "list of records": r"^ +List<Task> ",
    "list of lists": r"^ +List<List<int>> ",
    "list of pairs": r"^ +List<\(int, int\)> ",
    "map": r"^ +Map<",
    "set": r"^ +Set<",
    "queue": r"^ +Queue<",
    "tuple": r"^ +\(int, bool\) ",
    "record": r"^ +Task ",
    "Point": r"^ +Point ",
    "float": r"^ +float ",
    "index by a variable or a number": r"\w\[(?:(?!pid)[a-z]\w*|\d)\](?!:)",
    "first or last": r"\b(?:first|last)\(",
    "division by what may be zero": r"// len\(|1 / \(",
    "remove": r"\.remove\(",
    "sqrt": r"sqrt\(",
    "invariant of pairs": r"^invariant .*forall i, j",
    "invariant that some": r"^invariant .*exists i",
    "invariant with a condition": r"^invariant .* or ",
}


def constructs(text: str) -> list[str]:
    """The names of the constructs of a program's text."""
    found = [name for name, pattern in ANYWHERE.items() if re.search(pattern, text, re.MULTILINE)]
    blocks = list(_blocks(text))
    kinds = [block.kind for block in blocks]
    found += [kind for kind in ("function", "init") if kind in kinds]
    found += [f"loop in {block}" for block in ("event", "init", "function") if any(
        b.kind == block and re.search(LOOP, b.text, re.MULTILINE) for b in blocks)]  # fmt: skip
    if any(_nested(block.text) for block in blocks):
        found.append("loop in a loop")
    if kinds.count("event") > 1:
        found.append("two events or more")
    if "Point target" in text and "Point position" not in text:
        found.append("target without position")
    return found


def _blocks(text: str) -> list[Block]:
    found: list[Block] = []
    within = 0  # the indentation of what stands under `priority:`
    for whole in text.split("\n"):
        within = 2 if whole == "priority:" else within if whole.startswith(" ") or not whole else 0
        line = whole[within:] if whole.startswith(" ") else whole
        if line and not line.startswith(" "):
            kind = "function" if line.startswith("fun ") else "init" if line.startswith("init:") else "other"
            if re.fullmatch(r"[A-Z]\w*:", line):
                kind = "event"
            found.append(Block(kind, line))
        elif found:
            found[-1] = Block(found[-1].kind, f"{found[-1].text}\n{line}")
    return found


def _nested(text: str) -> bool:
    within: list[int] = []
    for line in text.split("\n"):
        indent = len(line) - len(line.lstrip())
        within = [at for at in within if at < indent]
        if re.match(LOOP, line):
            if within:
                return True
            within.append(indent)
    return False
