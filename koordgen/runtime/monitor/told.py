"""What made a property false, in words for people."""

from __future__ import annotations

from typing import Any

import msgspec

from koordgen.runtime.program.property import Bound, Read, Trail
from koordgen.runtime.values.points import Point

MOST_READ = 8  # values that are told
LONGEST = 120  # characters of one of them


def told(trail: Trail, names: tuple[str, ...], why: str = "", pid: int = -1) -> tuple[tuple[str, ...], str]:
    """The robots that a formula was about when it came out false, and what was bound and read then. `pid` is the robot
    of an assumption."""
    bound = [step for step in trail if isinstance(step, Bound)]
    robots = [names[b.value] for b in bound if b.robot and _is_pid(b.value, names)]
    if pid >= 0:
        robots = [names[pid]]
    read = list(dict.fromkeys(_read(step) for step in trail if isinstance(step, Read)))
    if len(read) > MOST_READ:
        read = [*read[:MOST_READ], f"and {len(read) - MOST_READ} more"]
    parts = [", ".join(_bound(b, names) for b in bound), "; ".join(read), why]
    return tuple(dict.fromkeys(robots)), ": ".join(part for part in parts if part)


def _is_pid(value: Any, names: tuple[str, ...]) -> bool:
    return isinstance(value, int) and 0 <= value < len(names)


def _bound(bound: Bound, names: tuple[str, ...]) -> str:
    name = f" ({names[bound.value]})" if bound.robot and _is_pid(bound.value, names) else ""
    return f"{bound.name} = {shown(bound.value)}{name}"


def _read(read: Read) -> str:
    place = "" if read.robot is None else f"[{read.robot}]"
    return f"{read.name}{place} = {shown(read.value)}"


def shown(value: Any) -> str:
    """A value as Koord has it, to six digits."""
    text = _shown(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


def _shown(value: Any) -> str:
    match value:
        case Point(x, y, z):
            return f"({x:.6g}, {y:.6g}, {z:.6g})"
        case bool():
            return str(value)
        case float():
            return f"{value:.6g}"
        case str():
            return f'"{value}"'
        case tuple() | list():
            return f"[{', '.join(map(_shown, value))}]"
        case msgspec.Struct():
            fields = (f"{name}={_shown(getattr(value, name))}" for name in value.__struct_fields__)
            return f"{type(value).__name__}({', '.join(fields)})"
        case _:
            return str(value)
