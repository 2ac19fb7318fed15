"""What a robot in lockstep finds again after a crash: as much as the file of a real one holds
(runtime/agent/store.py)."""

from __future__ import annotations

from collections import deque

from koordgen.runtime.agent.store import KEPT, Acceptor, Kept, Loaded, Locals, Mission


class MemoryStore:
    """Implements `koordgen.runtime.agent.store.Keeper`; it outlives its agent."""

    def __init__(self) -> None:
        self._mission: Mission | None = None
        self._acceptor: Acceptor | None = None
        self._locals: deque[Locals] = deque(maxlen=KEPT + 1)

    def write(self, record: Kept) -> bool:
        match record:
            case Mission():
                self._mission = record
            case Acceptor():
                self._acceptor = record
            case Locals():
                self._locals.append(record)
        return True

    def load(self) -> Loaded:
        newest = {record.round: record for record in self._locals}
        return Loaded(self._mission, tuple(newest[r] for r in sorted(newest)[-KEPT:]), self._acceptor)

    def clear(self) -> None:
        self._mission = self._acceptor = None
        self._locals.clear()
