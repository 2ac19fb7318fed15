"""Sizes of messages of a squad: the application of the outer program in the inner fleet, as its messages show it.

At run time this application is built by koordgen/runtime/agent/squad.py. Its hidden variable holds the record of the
outer robot, which any inner robot may have to continue. All sizes are upper bounds (tests compare them)."""

from __future__ import annotations

from collections.abc import Sequence

from koordgen.build.bundle.budget import most_bytes
from koordgen.lang.ir.decl import Event, Import, Local, Param, Program, Provided, Shared
from koordgen.lang.ir.expr import Const, SharedRead
from koordgen.lang.ir.stmt import Assign, SharedPlace
from koordgen.lang.ir.types import BOOL, INT, Sized
from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.source import Span

OUTER = "outer"  # name of the application; equal to that of squad.py (tested)
RECORD = "the record of the outer robot"  # as messages about sizes name the hidden variable
KEPT = 8  # rounds whose private variables a record has; equal to that of koordgen/runtime/agent/records.py (tested)
_HEAD = 64  # bytes of a record beside its parts
_SQUAD = "Squad"  # name of the import


def record_capacity(outer: Program, robots: int) -> int:
    """Return the largest number of bytes of the record of an outer robot. `robots`: number of outer robots."""
    actuators = [port for module in outer.modules for port in module.ports if port.direction == "actuator"]
    mission = 256 + sum([4 + most_bytes(v.type) for v in outer.shared])
    locals_ = 64 + sum([most_bytes(v.type) for v in outer.locals]) + sum([1 + most_bytes(p.type) for p in actuators])
    acceptor = 64 + 2 * (128 + 10 * robots)
    return _HEAD + mission + (KEPT + 1) * locals_ + acceptor


def with_outer(
    system: System, provider: int, outer: Program, robots: int, ports: Sequence[Provided], span: Span
) -> System:
    """Return an inner system with the application of the outer program, numbered last, as far as sizes depend on it.

    `provider`: number of the application that provides the modules. `robots`: number of outer robots. `ports`: what the
    inner program provides of the ports that the outer program uses. `span`: the squad's place in the outer fleet file.
    """
    commanded = [p.value.name for p in ports if p.port.direction == "actuator" and isinstance(p.value, SharedRead)]
    capacity = record_capacity(outer, robots) + 1  # a value of an extern type takes one byte more than a string
    record = Shared(RECORD, "allwrite", Sized("string", capacity), Const("", Sized("string", 0), span), span)
    return with_host(system, provider, commanded, record, outer.path, span)


def with_host(system: System, provider: int, commanded: Sequence[str], record: Shared, path: str, span: Span) -> System:
    """Return an inner system with an application that hosts an outer program, numbered last.

    `commanded`: variables of the providing program that the outer program writes. `record`: variable with the record of
    the outer robot. `path`: file of the outer program. Other parameters: see with_outer.
    """
    providing = system.applications[provider]
    taking = [replace(v, span=span) for v in providing.program.shared if v.name in commanded]
    written = [record, *taking]
    effect = tuple([Assign(SharedPlace(v.name), SharedRead(v.name, v.type, span), span) for v in written])
    names = tuple([v.name for v in taking])
    imported = Import(_SQUAD, names, (), names, (), span)
    program = Program(
        name=OUTER, path=path, records=(), extern_types=(), functions=(), externs=(), specs=(),
        params=(Param(imported.size, INT, Const(1, INT, span), span),), modules=(), shared=tuple(written),
        locals=(Local(imported.pid, INT, Const(0, INT, span), span),), locks=(), init=(),
        events=(Event("Write", Const(True, BOOL, span), effect, None, None, span),), properties=(), imports=(imported,),
    )  # fmt: skip
    added = Application(OUTER, program, tuple(range(system.robots)), ((_SQUAD, providing.name),))
    return replace(system, applications=(*system.applications, added))
