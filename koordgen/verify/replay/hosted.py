"""Application that hosts an outer robot, in the traces of a fleet that is a robot of another fleet (a squad).

The application is built at run time (koordgen/runtime/agent/squad.py) and has no Koord program. A replay takes the
writes of its events as given, and checks what they write and what they read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from koordgen.build.bundle.squad_budget import with_host
from koordgen.lang.ir.decl import Program, Shared
from koordgen.lang.ir.expr import Make, SharedRead
from koordgen.lang.ir.types import ExternType, Type
from koordgen.lang.semantics.composition import Instance, System
from koordgen.lang.semantics.values import Value
from koordgen.runtime.agent.squad import RECORD, joined_hash
from koordgen.verify.replay.robot import Difference, Unreplayable
from koordgen.verify.replay.store import had_frame
from koordgen.verify.replay.trace import TraceLine
from koordgen.verify.replay.values import BadValue, from_trace

__all__ = ["CLAIM", "RECORD", "WRITE", "HostReplay", "commanded", "hosting", "joined_hash", "provider_of"]

CLAIM, WRITE = "Claim", "Write"  # events of the application


def provider_of(system: System) -> int:
    """Return the index of the application that provides modules. Raises StopIteration if there is none."""
    return next(index for index, each in enumerate(system.applications) if each.program.provides)


def commanded(program: Program) -> dict[str, str]:
    """Return actuator, "Module.port" -> variable that takes its commands, of the modules that a program provides."""
    ports = [(module.name, provided) for module in program.provides for provided in module.ports]
    return {
        f"{module}.{p.port.name}": p.value.name
        for module, p in ports
        if p.port.direction == "actuator" and isinstance(p.value, SharedRead)
    }


def hosting(system: System, variables: Iterable[str] | None) -> System:
    """Return the system of a squad with the application that hosts the outer robot, numbered last.

    `variables`: those that the outer program commands; None: all that take commands. Raises StopIteration and
    ValueError if the system provides no such variables."""
    provider = provider_of(system)
    program = system.applications[provider].program
    taking = set(commanded(program).values())
    wanted = taking if variables is None else set(variables)
    if not wanted <= taking:
        raise ValueError(f"{program.name} takes no commands by {', '.join(sorted(wanted - taking))}")
    span = program.provides[0].span
    kind = ExternType("record")
    record = Shared(RECORD, "allwrite", kind, Make((), kind, span), span)
    return with_host(system, provider, sorted(wanted), record, "", span)


@dataclass
class HostReplay:
    """Replay of one instance of the application: see Replay, whose methods it has.

    Its events are not run again. A write of any other variable than the record and the commanded variables is a
    difference."""

    system: System
    instance: Instance

    def __post_init__(self) -> None:
        program = self.system.applications[self.instance.application].program
        self._types: dict[str, Type] = {variable.name: variable.type for variable in program.shared}
        self._copy: dict[str, Value] = {}
        self.saw: Mapping[str, Any] | None = None  # copy of the shared store that the robot read

    def line(self, line: TraceLine) -> Iterator[Difference]:
        """Check one record. Raises Unreplayable."""
        self.saw = None
        record = line.record
        try:
            if record["kind"] == "round":
                yield from self._round(line, record)
            elif record["kind"] in ("init", "checkpoint"):
                self._copy = {}
                yield from self._writes(line, record, ())
        except BadValue as error:
            raise Unreplayable(line.number, str(error)) from None
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
            raise Unreplayable(line.number, f"a broken record: {error!r}") from None

    def end(self, number: int) -> Iterator[Difference]:
        """Yield nothing: no event is waited for."""
        yield from ()

    def skip(self) -> None:
        """Do nothing: the application has no variables of one robot alone."""

    def _round(self, line: TraceLine, record: dict[str, Any]) -> Iterator[Difference]:
        if not had_frame(record):
            return
        self._copy |= {name: from_trace(value, self._types[name]) for name, value in record.get("copy", {}).items()}
        if len(self._copy) < len(self._types):
            raise Unreplayable(line.number, "the copy of the record of the outer robot is not recorded")
        self.saw = dict(self._copy)
        event = record.get("event")
        if event in (None, CLAIM, WRITE):
            yield from self._writes(line, record, (RECORD,) if event == CLAIM else tuple(self._types))
        else:
            yield Difference(line.number, record["round"], line.pid, "the event", event, f"{CLAIM} or {WRITE}")

    def _writes(self, line: TraceLine, record: dict[str, Any], allowed: tuple[str, ...]) -> Iterator[Difference]:
        for name, value in record.get("shared", {}).items():
            if name in allowed:
                from_trace(value, self._types[name])
            else:
                yield Difference(line.number, record.get("round", 0), line.pid, name, value, None)
