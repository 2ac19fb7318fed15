"""Records of a trace: checks of their form and of their limits.

A trace comes from outside: whatever reads it calls `flaw_of` first, and may then use the record's fields.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

MOST_ROBOTS = 1000
MOST_ROUND = 100_000_000
MOST_JUMP = 100_000  # rounds from one record to the next; a larger number is none


def flaw_of(record: Mapping[str, Any]) -> str:
    """Return what is wrong with a record; empty for one that is whole, and for one of another kind than these."""
    kind = record.get("kind")
    sound = _SOUND.get(kind) if isinstance(kind, str) else None
    if sound is None:
        return ""
    if not sound(record):
        return f"a broken record of kind {kind}"
    if kind == "round" and record.get("event") is None and any(record.get(name) for name in _WRITES):
        return "a write in a round without an event"
    return ""


_WRITES = ("locals", "shared", "actuators", "stopped")


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _int(value: Any, low: int = 0) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= MOST_ROUND


def _timed(record: Mapping[str, Any]) -> bool:
    return _number(record.get("time", record.get("t")))


def _groups(record: Mapping[str, Any], *names: str) -> bool:
    return all(isinstance(record.get(name, {}), dict) for name in names)


def _init(record: Mapping[str, Any]) -> bool:
    restored, fault = record.get("restored"), record.get("fault")
    return (
        _timed(record)
        and _groups(record, "sensors", "locals", "shared", "actuators", "copy")
        and _calls(record)
        and all(record.get(name) is None or isinstance(record[name], str) for name in ("event", "skipped"))
        and (fault is None or (isinstance(fault, dict) and isinstance(fault.get("reason"), str)))
        and (restored is None or _life(restored))
    )


def _life(restored: Any) -> bool:
    return isinstance(restored, dict) and _int(restored.get("round"), -1) and _groups(restored, "locals", "actuators")


def _round(record: Mapping[str, Any]) -> bool:
    numbers = all(_number(record.get(name, 0.0)) for name in ("late", "clock_bound"))
    return _init(record) and _int(record.get("round"), 1) and numbers


def _checkpoint(record: Mapping[str, Any]) -> bool:
    own = record.get("own")
    return _timed(record) and _int(record.get("round"), -1) and (own is None or _life(own))


def _calls(record: Mapping[str, Any]) -> bool:
    calls = record.get("calls", [])
    return isinstance(calls, list) and all(
        isinstance(c, list) and len(c) == 3 and isinstance(c[0], str) and isinstance(c[1], list) for c in calls
    )


def _phase(record: Mapping[str, Any]) -> bool:
    return _timed(record) and isinstance(record.get("phase"), str) and isinstance(record.get("detail", ""), str)


def _view(record: Mapping[str, Any]) -> bool:
    members = record.get("members")
    whole = _int(record.get("number")) and _int(record.get("since"), -MOST_ROUND)
    return whole and isinstance(members, list) and all(_int(m, -1) for m in members)


def _monitor(record: Mapping[str, Any]) -> bool:
    texts = all(isinstance(record.get(name, ""), str) for name in ("of", "name", "line", "outcome", "why"))
    return texts and _int(record.get("round")) and _int(record.get("age", 0))


def _stream(record: Mapping[str, Any]) -> bool:
    return _int(record.get("round")) and all(isinstance(record.get(name), str) for name in ("port", "text"))


# For each kind, a function that returns whether a record has all fields in the right form.
_SOUND: dict[str, Callable[[Mapping[str, Any]], bool]] = {
    "header": lambda record: _int(record.get("part", 0)),
    "checkpoint": _checkpoint,
    "init": _init,
    "round": _round,
    "phase": _phase,
    "view": _view,
    "monitor": _monitor,
    "stream": _stream,
}
