"""Checks of a trace's records: their form according to the schema, and limits of their values.

A trace is untrusted input. Each reader of a trace first calls `sound`. After that call, the reader may rely on the
record's keys.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from koordgen.runtime.trace.schema import KINDS, misfit

MOST_JUMP = 100_000  # largest number of rounds from one record to the next record
_WRITES = ("locals", "shared", "actuators", "stopped")


class Unsound(ValueError):
    """Raised if a record is unusable. The message describes the mistake."""


def sound(record: Mapping[str, Any], line: bytes) -> dict[str, Any]:
    """Return the fields of a record that the schema knows. Raises Unsound.

    `line`: the text of the record. The schema must contain the record's kind."""
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
