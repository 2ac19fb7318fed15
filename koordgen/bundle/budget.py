"""Whether a round's writes fit in one datagram: decided at build time, with the arithmetic in the message."""

from __future__ import annotations

from koordgen.diagnostics import Diagnostic
from koordgen.ir.decl import Program

# As koordgen/runtime/layout.py and wire.py have them (a test compares the verdicts): MessagePack's longest forms.
DATAGRAM = 1200
_VALUE = {"bool": 1, "int": 9, "float": 9, "Point": 28}
_WRITE, _CLOSING = 4, 25


def check_budget(program: Program, robots: int) -> list[Diagnostic]:
    """An error at the first shared variable that no longer fits for a fleet of that size, if there is one."""
    room = DATAGRAM - overhead(robots)
    needed = _CLOSING
    for variable in program.shared:
        needed += _WRITE + _VALUE[variable.type.name]
        if needed > room:
            total = _CLOSING + sum(_WRITE + _VALUE[v.type.name] for v in program.shared)
            message = (
                f"one round's shared writes take up to {total} bytes; with {robots} robots a datagram of {DATAGRAM} "
                f"has room for {room}"
            )
            help = "share fewer or smaller variables; larger values come with a later version"
            return [Diagnostic("B004", "error", message, variable.span, help=help)]
    return []


def overhead(robots: int) -> int:
    """The most bytes of a datagram beside its closings: head, clock echoes of up to 8 robots, what is held of each."""
    echoes = 20 * min(robots, 8)
    return max(144, 111 + echoes + 9 * robots + (2 if robots >= 16 else 0))
