"""A gate with a ledger, and a model of the ledger in plain Python beside it: both are told the same."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec

from benchmarks.fixtures.fleet import KEY
from koordgen.runtime.net import gate, wire
from koordgen.runtime.net.gate import NOTED, OTHER, USUAL, Gate
from koordgen.runtime.net.ledger import (
    APPLIED,
    DEPTH,
    LACKING,
    LAST,
    LEAST,
    NEXT,
    OPEN,
    PRESENT,
    REACHED,
    ROW,
    SETTLED,
    TICK,
    TOLD,
    WANTING,
    WATCHED,
    Collected,
    Ledger,
)
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.seal import MEMORY, seal
from koordgen.runtime.net.sessions import Sessions
from koordgen.runtime.net.wire import Closing, Echo, Write, encoder

BEGINS = b"words of this mission begin so"
COLUMNS = ("held", "floor", "view", "incarnation", "applied", "through", "heard", "wanting", "gap", "number", "lacks")
encode = encoder.encode
_closings = msgspec.msgpack.Decoder(tuple[Closing, ...])
_held = msgspec.msgpack.Decoder(wire.MaybePerRobot)
_each = msgspec.msgpack.Decoder(list[msgspec.Raw])
_parts = msgspec.msgpack.Decoder(list[list[msgspec.Raw]])


def write(index: int, value: Any, patch: bool = False) -> Write:
    return Write(index, msgspec.Raw(encode(value)), patch)


def single(pid: int, round_: int, *writes: Write, incarnation: int = 0, acted: bool = True, **more: Any) -> Closing:
    return Closing(pid, incarnation, round_, round_, False, acted, writes=writes, **more)


class Said(NamedTuple):
    """A word, by what the ledger looks at."""

    pid: int
    round: int
    applied: int
    settled: int = 0
    closings: bytes = b"\x90"
    held: bytes = b"\x90"
    echoes: tuple[Echo, ...] = ()

    @staticmethod
    def of(closing: Closing, applied: int | None = None, **more: Any) -> Said:
        """The closing's author says it in the round after."""
        word = Said(closing.author, closing.round + 1, closing.round if applied is None else applied, **more)
        return word._replace(closings=encode([closing]))


def is_whole(encoded: bytes) -> bool:
    """Whether it is one thing, with nothing behind it."""
    try:
        return len(_parts.decode(b"\x91\x91" + encoded)) == 1
    except (ValueError, RecursionError):
        return False


def strict(closings: bytes) -> list[tuple[Closing, bytes]] | None:
    """Of an encoded array its closings, each with its encoding; None: they are not written as our robots write them."""
    try:
        decoded = _closings.decode(closings)
        each = [bytes(encoded) for encoded in _each.decode(closings)]
        ours = closings[0] != 0xDD and all(map(is_ours, each))
    except (ValueError, RecursionError):
        return None
    return list(zip(decoded, each, strict=True)) if ours else None


def is_ours(closing: bytes) -> bool:
    """Whether a closing is written as our robots write it."""
    ((*fields, writes),) = _parts.decode(b"\x91" + closing)
    ours = closing[0] == 0x99 and len(fields) == 8 and bytes(writes)[0] != 0xDD
    return ours and all(len(parts) == 3 for parts in _parts.decode(writes)) and heads_are_short(bytes(writes))


def heads_are_short(writes: bytes) -> bool:
    """Whether the heads of all writes are one byte."""
    decoded = msgspec.msgpack.decode(writes, type=list[msgspec.Raw])
    return all(bytes(each)[0] == 0x93 for each in decoded)


class Model:
    """What ledger.h does, in other words."""

    def __init__(self, pid: int, n_sys: int) -> None:
        self.plain = Ledger(pid, n_sys)
        self.kept: dict[tuple[int, int], tuple[int, bytes]] = {}  # by pid and slot: of which round

    def row(self, pid: int, round_: int) -> bytes | None:
        """The row of a round, if it is there."""
        found = self.kept.get((pid, round_ % DEPTH))
        if not self.plain.floor[pid] < round_ <= self.plain.held[pid] or found is None or found[0] != round_:
            return None
        return found[1]

    def note(self, word: Said, view: int) -> bool:
        plain, number, pid = self.plain, self.plain.number, word.pid
        through = max(0, word.round - 1)
        closings = strict(word.closings)
        try:
            held = msgspec.msgpack.decode(word.held)
        except ValueError:
            return False
        ours = isinstance(held, list) and all(type(each) is int for each in held) and len(held) in (0, plain.n_sys)
        if not number[OPEN] or closings is None or not ours or word.held[0] == 0xDD or min(held, default=0) < 0:
            return False
        if max(word.applied, word.settled, through, *held) > number[LAST]:
            return False
        if any(closing.author >= plain.n_sys for closing, _ in closings):
            return False
        for closing, row in closings:
            if closing.round <= plain.held[closing.author]:
                continue
            if closing.author == plain.pid or closing.round > number[LAST] or not self.keep(closing, row):
                return False
        self.hear(word, view, through, held)
        plain.heard[pid] = number[TICK]
        number[TOLD] = max(number[TOLD], word.settled)
        return True

    def hear(self, word: Said, view: int, through: int, held: Sequence[int]) -> None:
        plain, number, pid = self.plain, self.plain.number, word.pid
        known = plain.applied[pid] if plain.view[pid] == view else -1
        if (plain.view[pid], plain.applied[pid]) <= (view, plain.applied[pid]) and plain.applied[pid] <= word.applied:
            number[REACHED] += known < number[WATCHED] <= word.applied
            plain.view[pid], plain.applied[pid] = view, word.applied
        if through > plain.through[pid]:
            plain.through[pid] = through
            holds = held or [word.applied] * plain.n_sys
            plain.wanting[pid] = min(holds) < through
            if plain.wanting[pid]:
                plain.lacks[pid * plain.n_sys : (pid + 1) * plain.n_sys] = array("q", holds)
        number[WANTING] = sum(plain.wanting)

    def keep(self, closing: Closing, row: bytes) -> bool:
        plain, number, pid = self.plain, self.plain.number, closing.author
        next_ = plain.held[pid] + 1
        if closing.stopped or not 0 <= closing.incarnation == plain.incarnation[pid] or plain.gap[pid]:
            return False
        if closing.acted or closing.prompt or closing.lock >= 0 or closing.writes:
            if (closing.first, closing.round) != (next_, next_):
                return False
        elif not 1 <= closing.first <= next_ <= closing.round:
            return False
        if closing.round - DEPTH > max(plain.floor[pid], min(number[SETTLED], number[APPLIED])) or len(row) > ROW:
            return False
        for round_ in range(next_, closing.round + 1):
            self.kept[pid, round_ % DEPTH] = round_, row
            number[LACKING] -= round_ == number[APPLIED] + 1
        plain.held[pid] = closing.round
        return True

    def close(self, first: int, round_: int, acted: bool, prompt: bool, lock: int, writes: Sequence[Write]) -> bool:
        pid = self.plain.pid
        closing = Closing(pid, self.plain.incarnation[pid], first, round_, False, acted, prompt, lock, tuple(writes))
        return self.plain.number[OPEN] != 0 and self.keep(closing, encode(closing))

    def collect(self, round_: int) -> Collected | None:
        plain, number = self.plain, self.plain.number
        members = [p for p in range(plain.n_sys) if plain.incarnation[p] >= 0]
        acted, prompt, changed = list[int](), list[int](), dict[int, list[tuple[int, bytes]]]()
        for pid in members:
            row = self.row(pid, round_)
            if row is None:
                return None
            closing = msgspec.msgpack.decode(row, type=Closing)
            indices = [w.index for w in closing.writes]
            if closing.lock >= 0 or any(w.patch for w in closing.writes) or indices != sorted(set(indices)):
                return None
            acted += [pid] * closing.acted
            prompt += [pid] * closing.prompt
            for each in closing.writes:
                changed.setdefault(each.index, []).append((pid, bytes(each.value)))
        number[NEXT] = sum(plain.held[p] <= round_ for p in members)
        said = [plain.applied[p] if plain.view[p] == number[PRESENT] else -1 for p in members if p != plain.pid]
        number[LEAST] = min(said, default=round_)
        writes = [
            (index, [p for p, _ in each], msgspec.Raw(encode([msgspec.Raw(value) for _, value in each])))
            for index, each in sorted(changed.items())
        ]
        return Collected(acted, tuple(prompt), writes)

    def rows(self, pid: int) -> list[bytes]:
        plain = self.plain
        first, plain.floor[pid] = max(plain.floor[pid], plain.held[pid] - DEPTH) + 1, plain.held[pid]
        return [self.kept[pid, round_ % DEPTH][1] for round_ in range(first, plain.held[pid] + 1)]


class Table:
    """The gate of robot `pid` of `n_sys`, in view `view`, its ledger, and the model."""

    def __init__(self, n_sys: int, pid: int = 0, view: int = 0, **numbers: int) -> None:
        found = gate.COMPILED.library()
        assert found is not None
        self.n, self.pid, self.view, self.sequence = n_sys, pid, view, 0
        sessions = Sessions(n_sys)
        columns: dict[str, array[int] | array[float]] = {**sessions.columns(), **Metrics(pid, n_sys).columns()}
        self.due = sessions.due
        self.gate = Gate(found, n_sys, pid, columns, KEY, MEMORY)
        self.gate.begin(BEGINS)
        self.ledger, self.model = Ledger(pid, n_sys), Model(pid, n_sys)
        for peer in range(n_sys):
            if peer != pid:
                self.gate.adopt(peer, bytes([peer]) * 20)
        self.gate.follow(view)
        self.gate.attach(self.ledger)
        self.set("view", *[view] * n_sys)
        self.set("incarnation", *[0] * n_sys)
        self.number({OPEN: 1, LAST: 20, PRESENT: view, WATCHED: -1, LACKING: n_sys})

    def follow(self, view: int) -> None:
        self.view = view
        self.gate.follow(view)
        self.model.plain.number[PRESENT] = view
        self.same()

    def both(self) -> tuple[Ledger, Ledger]:
        return self.ledger, self.model.plain

    def set(self, column: str, *values: int) -> None:
        for each in self.both():
            getattr(each, column)[: len(values)] = array(getattr(each, column).typecode, values)

    def put(self, column: str, pid: int, value: int) -> None:
        for each in self.both():
            getattr(each, column)[pid] = value

    def want(self, pid: int, wanting: bool) -> None:
        self.put("wanting", pid, wanting)
        self.number({WANTING: sum(self.ledger.wanting)})

    def number(self, values: dict[int, int]) -> None:
        for each in self.both():
            for index, value in values.items():
                each.number[index] = value

    def datagram(self, word: Said) -> bytes:
        self.sequence += 1
        stamps = encode(self.sequence) + encode(5) + b"\xc0" + encode(word.echoes)
        counts = b"".join(map(encode, (self.view, word.round, word.applied, word.settled)))
        payload = BEGINS + bytes([word.pid]) * 21 + stamps + counts + b"\xc2" + word.held + word.closings
        return seal(KEY, MEMORY, payload)

    def hear(self, *words: Said) -> list[bool]:
        """Which were noted; all is as the model says."""
        judged = self.gate.take([self.datagram(word) for word in words], 1.0, None)
        noted, told, verdicts = list[bool](), list[bytes | None](), list[int]()
        for word in words:
            usual = is_whole(word.held) and is_whole(word.closings)
            noted.append(usual and self.model.note(word, self.view))
            verdicts.append(NOTED if noted[-1] else USUAL if usual else OTHER)
            if verdicts[-1] == USUAL:
                told.append(self.told(word))
        assert list(judged.verdicts) == ([] if OTHER not in verdicts and judged.usual is not None else verdicts)
        assert (judged.usual is None) == (None in told)
        if judged.usual is not None:
            rows = [(r.sender, r.round, r.applied, r.settled, r.held, r.closings) for r in judged.usual]
            assert [*map(encode, rows)] == told
        self.same()
        return noted

    def told(self, word: Said) -> bytes | None:
        """How the gate hands it on; None: what it says is malformed."""
        try:
            decoded = (_held.decode(word.held), _closings.decode(word.closings))
        except (ValueError, RecursionError):
            return None
        return encode((word.pid, word.round, word.applied, word.settled, *decoded))

    def same(self) -> None:
        """All columns, byte for byte, and all rows that are there."""
        ours, theirs = self.both()
        for name in COLUMNS:
            assert getattr(ours, name) == getattr(theirs, name), name
        for (pid, _), (round_, row) in self.model.kept.items():
            if self.model.row(pid, round_) is not None:
                assert ours.row(pid, round_) == row
        pid, held = ours.pid, ours.held[ours.pid]
        for round_ in range(held - DEPTH, held + 2):
            assert ours.own(round_) == (self.model.row(pid, round_) is not None)

    def close(self, round_: int, *writes: Write, acted: bool = True, prompt: bool = False, lock: int = -1,
              first: int | None = None) -> bool:  # fmt: skip
        first = round_ if first is None else first
        pid = self.ledger.pid
        mine = Closing(pid, self.ledger.incarnation[pid], first, round_, False, acted, prompt, lock, writes)
        kept = self.ledger.close(encode(mine))
        assert kept == self.model.close(first, round_, acted, prompt, lock, writes)
        self.same()
        return kept

    def collect(self, round_: int) -> Collected | None:
        found, expected = self.ledger.collect(round_), self.model.collect(round_)
        assert (found is None) == (expected is None)
        if found is not None:
            assert encode(found) == encode(expected)
            self.same()
        return found

    def rows(self, pid: int) -> list[bytes]:
        found = self.ledger.rows(pid)
        assert found == self.model.rows(pid)
        self.same()
        return found
