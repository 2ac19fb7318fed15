"""Shared store after each round, computed from the writes that robots recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from koordgen.lang.ir import decl
from koordgen.lang.semantics.step import initial
from koordgen.runtime.program.runner import NO_EVENT
from koordgen.verify.replay.values import plain

# Store in JSON: name of a shared variable -> value; for an allread variable, a list with one value per pid.
Shown = Mapping[str, Any]


class RecordedWrites:
    """Recorded writes of each round.

    The writes are applied in the same order as on robots: first commits, then plain events by ascending pid."""

    def __init__(self, program: decl.Program, n_sys: int) -> None:
        self.slots = {v.name for v in program.shared if v.kind == "allread"}
        self._locks = {event.name: event.lock is not None for event in program.events}
        self._recorded: dict[int, list[tuple[bool, int, dict[str, Any]]]] = {}
        self._initial = initial(program, n_sys).store

    def add_record(self, pid: int, record: Mapping[str, Any]) -> None:
        """Add the writes of one record (of a round, or of `init`) of a robot."""
        if record.get("shared"):
            plain_event = not self._locks.get(record.get("event") or "", False)
            self._recorded.setdefault(int(record.get("round", 0)), []).append((plain_event, pid, record["shared"]))

    def first(self) -> Shown:
        """Return the initial store, before any `init` has run."""
        return {
            **{n: [plain(v) for v in held] for n, held in self._initial.slots.items()},
            **{n: plain(v) for n, v in self._initial.cells.items()},
        }

    def after(self, store: Shown, round_: int) -> Shown:
        """Return the store after a round, computed from the store after the previous round.

        Round 0 is `init`."""
        writes = self._recorded.get(round_)
        if not writes:
            return store
        found = dict(store)
        for _, pid, shared in sorted(writes, key=lambda w: w[:2]):
            for name, value in shared.items():
                found[name] = (
                    [value if p == pid else own for p, own in enumerate(found[name])] if name in self.slots else value
                )
        return found


def had_frame(record: Mapping[str, Any]) -> bool:
    """Return whether a robot read its copy of the store in a round.

    A robot reads the store in a round with an event, a discarded event, or no enabled event. In all other cases, the
    robot skips the round before it reads the store."""
    looked = record.get("event") is not None or record.get("fault") is not None
    return looked or record.get("skipped") == NO_EVENT
