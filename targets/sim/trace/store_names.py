"""Names of several applications in the records of a run, as the store and the pages have them.

In a trace, a record has the names of its program and the key `application`. Two programs may have equal names, and one
variable has a name in each program that imports it. Here events, local variables and properties become
`application.name`, and shared variables get their names in the store. Slots of allread variables are those of robots,
by the pids of the fleet. With one application, records stay as they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec
from msgspec import UNSET

from koordgen.runtime.trace.schema import (
    ApplicationRecord,
    Header,
    InitRecord,
    Monitor,
    Restored,
    Round,
    TraceRecord,
    Values,
    Verdict,
    Violation,
)

_by_pid = msgspec.json.Decoder(dict[str, msgspec.Raw])
_by_index = msgspec.json.Decoder(list[msgspec.Raw])
R = TypeVar("R", Monitor, Verdict, Violation)


class StoreNames:
    """Converter of records to the names of the store. `header`: that of the run's trace."""

    def __init__(self, header: Header) -> None:
        given = () if header.composition is UNSET else header.composition
        self._applications = {each.name: each for each in given}
        self._members: dict[str, tuple[int, ...]] = {}  # allread variable of the store -> robots with a slot
        slots = {v.name for v in header.shared if v.kind == "allread"}
        for each in given:
            own = [stored for stored in each.variables.values() if stored.startswith(f"{each.name}.")]
            self._members |= {stored: each.members for stored in own if stored in slots}

    def of(self, record: TraceRecord) -> TraceRecord:
        """Return the record with the names of the store."""
        application = self._applications.get(getattr(record, "application", ""))
        if application is None:
            return record
        match record:
            case InitRecord():
                return msgspec.structs.replace(
                    record,
                    locals=_qualified(application.name, record.locals),
                    shared=self._shared(application, record.shared),
                )
            case Round():
                return msgspec.structs.replace(
                    record,
                    event=None if record.event is None else f"{application.name}.{record.event}",
                    locals=_qualified(application.name, record.locals),
                    shared=self._shared(application, record.shared),
                    copy=self._copy(application, record.copy),
                    restored=None if record.restored is None else _restored(application.name, record.restored),
                )
            case Monitor():
                return _named(record)
            case Verdict():
                return _named(record)
            case Violation():
                return _named(record)
            case _:
                return record

    def _shared(self, application: ApplicationRecord, values: Values) -> Values:
        return {application.variables[name]: value for name, value in values.items() if name in application.variables}

    def _copy(self, application: ApplicationRecord, values: Values) -> Values:
        """Return the changes of a robot's copy. An allread variable has them by the pids of robots."""
        found: dict[str, Any] = {}
        for name, value in self._shared(application, values).items():
            members = self._members.get(name)
            found[name] = value if members is None else _by_robot(value, members)
        return found


def _by_robot(value: msgspec.Raw, members: tuple[int, ...]) -> msgspec.Raw:
    """Return slots by the pids of robots. An importer of a variable has a list of all slots."""
    if bytes(value).lstrip().startswith(b"["):
        slots: Mapping[int, msgspec.Raw] = dict(enumerate(_by_index.decode(value)))
    else:
        slots = {int(pid): each for pid, each in _by_pid.decode(value).items()}
    known = {str(members[pid]): each for pid, each in slots.items() if pid < len(members)}
    return msgspec.Raw(msgspec.json.encode(known))


def _qualified(application: str, values: Values) -> Values:
    return {f"{application}.{name}": value for name, value in values.items()}


def _restored(application: str, restored: Restored) -> Restored:
    return msgspec.structs.replace(restored, locals=_qualified(application, restored.locals))


def _named(record: R) -> R:
    """Return a record about a property, or a fault, with the application in its name."""
    return msgspec.structs.replace(record, name=qualified_name(record.application, record.name))


def qualified_name(application: str, name: str) -> str:
    """Return the name of a property with that of its application; "" for the only application."""
    return ".".join(filter(None, (application, name)))
