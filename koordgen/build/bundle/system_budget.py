"""Message sizes of several applications, checked at build time: one entry has all that a robot's applications write.

All sizes are upper bounds, equal to those of koordgen/runtime/net/layout.py (a test compares them)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil
from typing import TYPE_CHECKING

from koordgen.build.bundle.budget import (
    ENTRY,
    MOST_SHARED,
    WRITE,
    Traffic,
    array_head,
    check_budget,
    check_link,
    longest_event,
    most_bytes,
    most_entry,
    most_in,
    most_init,
    most_store,
    traffic_of,
)
from koordgen.build.emit.system import is_alone
from koordgen.build.emit.types import NUMBER
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import Program, Shared
from koordgen.lang.node import Node
from koordgen.lang.semantics.composition import System

if TYPE_CHECKING:
    from koordgen.fleet.medium import Medium

_PARTS, _PART = (
    3,
    12,
)  # bytes that an entry with several parts adds once, and for each part; equal to those of runtime/net/layout.py
_HELP = "share fewer or smaller variables, declare smaller capacities with `max`, or give a robot fewer applications"

# A diagnostic, and the number of the application into whose program its span points.
Found = tuple[int, Diagnostic]


class Size(Node):
    """Size of a variable in a message, in bytes. `application`: number of the application that writes or owns it."""

    bytes: int
    application: int
    variable: Shared


def check_system_budget(system: System, names: Sequence[str]) -> list[Found]:
    """Return errors if the shared variables of all applications are too large for the fleet.

    Three messages are checked: the log entry of one round of each robot, the state transfer to a robot that rejoins,
    and the values that `init` writes. Each error points at the largest variable. `names`: the robots' names.
    """
    if is_alone(system):
        return [(0, found) for found in check_budget(system.applications[0].program, system.robots)]
    own = [variable for index in range(len(system.applications)) for variable in system.own(index)]
    if len(own) > MOST_SHARED:
        last = max(i for i in range(len(system.applications)) if system.own(i))
        message = f"all applications together have {len(own)} shared variables; at most {MOST_SHARED} are supported"
        span = system.own(last)[-1].span
        return [(last, Diagnostic("B004", "error", message, span, help="combine some of them in a record"))]
    entry = _check_robots(system, names, entry_sizes, most_entry(system.robots), "shared writes of one round")
    init = _check_robots(system, names, init_sizes, most_init(system.robots), "writes of `init` to shared variables")
    return [*(entry or _check_store(system)), *(init if system.robots > 1 else [])]


def check_system_link(
    system: System, names: Sequence[str], delta: float, link: Medium | None, to_all: bool = False
) -> list[Found]:
    """Check the traffic of one round of all applications against the `link` of the fleet file; see check_link.

    B008 (error): a round is too short. B009 (warning): the writes of a robot's events need several datagrams."""
    if is_alone(system):
        only = system.applications[0].program
        return [(0, found) for found in check_link(only, system.robots, delta, link, to_all)]
    sizes = [event_sizes(system, robot) for robot in range(system.robots)]
    if link is None or system.robots < 2 or not any(sizes):
        return []
    found = [traffic_of(entry_bytes(system, r, own), system.robots, link, to_all) for r, own in enumerate(sizes)]
    needed = ceil(sum(each.receivers * (each.entry + each.acknowledgement) for each in found) / (1 - link.loss))
    robot = max((r for r in range(system.robots) if sizes[r]), key=lambda r: found[r].writes)
    largest = max(sizes[robot], key=_bytes)
    if needed * 8 <= link.rate * delta:
        return [] if found[robot].datagrams == 1 else [_fragments(names[robot], found[robot], largest)]
    message = (
        f"all applications together may send {needed} bytes in a round, but a round of {delta:g} s at {link.rate:g} "
        f"bit/s carries {int(link.rate * delta / 8)} bytes; the writes of {names[robot]} alone take up to "
        f"{found[robot].writes} bytes for each receiver"
    )
    help = f"use a longer delta or a faster link, or {_HELP}"
    return [(largest.application, Diagnostic("B008", "error", message, largest.variable.span, help=help))]


def _fragments(name: str, found: Traffic, largest: Size) -> Found:
    """Return a warning that the writes of a robot's applications need several datagrams."""
    message = (
        f"the writes of all applications of {name} in a round take up to {found.writes} bytes and need "
        f"{found.datagrams} datagrams: the loss of one of them delays the round"
    )
    help = "write fewer or smaller variables in one event, or give a robot fewer applications"
    return largest.application, Diagnostic("B009", "warning", message, largest.variable.span, help=help)


def entry_bytes(system: System, robot: int, sizes: Sequence[Size]) -> int:
    """Return the largest size in bytes of a robot's log entry with writes of these sizes."""
    count = sum(robot in application.members for application in system.applications)
    return ENTRY + (_PARTS + _PART * count if count > 1 else 0) + sum(map(_bytes, sizes))


def entry_sizes(system: System, robot: int) -> list[Size]:
    """Return the sizes of all variables that a robot's applications may write."""
    return _sizes(system, robot, lambda program, v: WRITE + most_bytes(v.type) if _may_write(program, v) else 0)


def init_sizes(system: System, robot: int) -> list[Size]:
    """Return the sizes of the variables that the `init` blocks of a robot's applications write."""
    return _sizes(system, robot, lambda program, v: most_in(program.init, v))


def event_sizes(system: System, robot: int) -> list[Size]:
    """Return the sizes of the variables that a robot writes in its largest round.

    Of each application, the event with the largest writes counts."""
    return _sizes(system, robot, lambda program, v: WRITE + most_bytes(v.type) if v in longest_event(program) else 0)


def store_sizes(system: System) -> list[Size]:
    """Return the sizes of all variables in a state transfer, with all slots."""
    found = []
    for index, application in enumerate(system.applications):
        slots = len(application.members)
        for variable in system.own(index):
            most = most_bytes(variable.type)
            all_ = array_head(slots, 16, 0) + slots * most if variable.kind == "allread" else most
            found.append(Size(all_, index, variable))
    return found


def store_total(system: System) -> int:
    """Return the largest size in bytes of a state transfer, which contains the variables of all applications."""
    robots, sizes, count = system.robots, store_sizes(system), len(system.instances())
    view = 1 + 2 * NUMBER + array_head(robots, 16, 0) + NUMBER * robots
    instances = 2 * array_head(count, 16, 0) + (NUMBER + 5) * count
    return 1 + view + NUMBER + array_head(len(sizes), 16, 0) + instances + sum(map(_bytes, sizes))


def _sizes(system: System, robot: int, size: Callable[[Program, Shared], int]) -> list[Size]:
    found = [
        Size(size(application.program, variable), index, variable)
        for index, application in enumerate(system.applications)
        if robot in application.members
        for variable in application.program.shared
    ]
    return [each for each in found if each.bytes]


def _may_write(program: Program, variable: Shared) -> bool:
    imported = [each for each in program.imports if variable.name in each.variables]
    return not imported or variable.name in imported[0].written


def _check_robots(
    system: System, names: Sequence[str], sizes: Callable[[System, int], list[Size]], room: int, what: str
) -> list[Found]:
    """Check a message of the robot that may send the most bytes. Return an error at the message's largest variable.

    Return no error if the message fits."""
    totals = [entry_bytes(system, robot, sizes(system, robot)) for robot in range(system.robots)]
    robot = max(range(system.robots), key=lambda r: totals[r])
    if totals[robot] <= room:
        return []
    largest = max(sizes(system, robot), key=_bytes)
    message = (
        f"{what} of all applications of {names[robot]} take up to {totals[robot]} bytes; with {system.robots} robots "
        f"at most {room} bytes can be sent; {largest.variable.name} alone takes up to {largest.bytes} bytes"
    )
    return [(largest.application, Diagnostic("B004", "error", message, largest.variable.span, help=_HELP))]


def _check_store(system: System) -> list[Found]:
    total, room = store_total(system), most_store(system.robots)
    if total <= room:
        return []
    largest = max(store_sizes(system), key=_bytes)
    message = (
        f"the variables of all applications together take up to {total} bytes; with {system.robots} robots, a robot "
        f"that rejoins can receive at most {room} bytes; {largest.variable.name} alone takes up to {largest.bytes} "
        f"bytes"
    )
    return [(largest.application, Diagnostic("B004", "error", message, largest.variable.span, help=_HELP))]


def _bytes(size: Size) -> int:
    return size.bytes
