"""Checks of a trace's records: their form by the schema, and limits.

A trace comes from outside: whatever reads it calls `sound` first, and may then use the record's keys.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from koordgen.runtime.trace.schema import KINDS, misfit

MOST_JUMP = 100_000  # rounds from one record to the next; a larger number is none
_WRITES = ("locals", "shared", "actuators", "stopped")


class Unsound(ValueError):
    """A record that cannot be used; the message says what is wrong with it."""


def sound(record: Mapping[str, Any], line: bytes) -> dict[str, Any]:
    """Return what the schema knows of a record, which is the object in `line` and of a kind of the schema. Raises
    Unsound."""
    kind = record["kind"]
    if kind == "header":
        part = record.get("part", 0)
        if type(part) is not int or part < 0:
            raise Unsound("a broken record of kind header")
        return dict(record)
    if misfit(line) or not ("time" in record or "t" in record) or (kind == "round" and record["round"] < 1):
        raise Unsound(f"a broken record of kind {kind}")
    if kind == "round" and record.get("event") is None and any(record.get(name) for name in _WRITES):
        raise Unsound("a write in a round without an event")
    return {name: value for name, value in record.items() if name == "kind" or name in KINDS[kind].__struct_fields__}
