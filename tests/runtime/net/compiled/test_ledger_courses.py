"""The ledger in C and the model of it in plain Python go through the same, whatever happens."""

from __future__ import annotations

from random import Random

import msgspec
import pytest

from koordgen.runtime.net.ledger import APPLIED, DEPTH, LACKING, LAST, OPEN, REACHED, SETTLED, TICK, WATCHED
from koordgen.runtime.net.wire import Closing, Echo, Write, encoder
from tests.runtime.net.compiled.gates import needs_gate
from tests.runtime.net.compiled.ledgers import Said, Table, single

pytestmark = needs_gate
MALFORMED: list[bytes] = [
    b"\xc0", b"\x80", b"\x05", b"\x91\xc0", b"\x91\x90", b"\xdc\x00\x00", b"\xdd\x00\x00\x00\x00",
    b"\x91\x93\x01\x00\x01", b"\x91\x98\x01\x00\x01\x01\xc2\xc3\xc2\xff",
    b"\x91\x9a\x01\x00\x01\x01\xc2\xc3\xc2\xff\x90\xc0",
]  # fmt: skip


class Course:
    """Whatever may happen, by chance."""

    def __init__(self, seed: int, n_sys: int) -> None:
        self.chance = Random(seed)
        self.table = Table(n_sys, self.chance.randrange(n_sys), self.chance.choice((0, 3, 300)))
        self.noted = self.refused = self.collected = 0
        self.others = [p for p in range(n_sys) if p != self.table.pid]

    def one_in(self, count: int) -> bool:
        return self.chance.randrange(count) == 0

    def value(self) -> bytes:
        chance = self.chance
        size = chance.choice((1, 5, 40)) if chance.randrange(12) else chance.choice((1000, 1105, 1200))
        return encoder.encode(chance.choice((chance.randrange(1000), "a" * size, [1] * size, {"a": [None, True]})))

    def writes(self) -> tuple[Write, ...]:
        """Mostly ascending, and no patches."""
        chance = self.chance
        indices = sorted(chance.sample((*range(6), 127, 128, 255, 256, 65535), chance.choice((0, 1, 1, 2, 5, 11))))
        if self.one_in(20):
            chance.shuffle(indices)
        if self.one_in(30) and indices:
            indices.append(indices[-1])
        return tuple([Write(index, msgspec.Raw(self.value()), self.one_in(60)) for index in indices])

    def closing(self, pid: int) -> Closing:
        """Mostly the next one."""
        chance, plain = self.chance, self.table.ledger
        round_, acted, prompt, lock = plain.held[pid] + 1, not self.one_in(4), self.one_in(5), -1
        if self.one_in(10):
            round_ = max(0, round_ + chance.choice((-2, -1, -1, 1, 2, 3)))
        made = Closing(pid, max(0, plain.incarnation[pid]), round_, round_, False, acted, prompt, lock, self.writes())
        if self.one_in(8):  # silence
            first, round_ = max(0, round_ - chance.choice((0, 0, 1, 2))), round_ + chance.choice((0, 1, 1, 2, 5, DEPTH))
            made = Closing(pid, made.incarnation, first, round_)
        if self.one_in(4):
            other = {"author": chance.choice((0, 1, 127)), "incarnation": chance.randrange(4), "stopped": True}
            other |= {"first": max(0, round_ + chance.choice((-1, 1))), "lock": chance.choice((0, 128, 65535))}
            name = chance.choice(list(other))
            made = msgspec.structs.replace(made, **{name: other[name]})
        return made

    def closings(self, pid: int) -> bytes:
        chance = self.chance
        if self.one_in(8):
            return chance.choice((b"\x90", b"\x90", *MALFORMED))
        authors = [pid, *(chance.randrange(self.table.n) for _ in range(0 if chance.randrange(9) else 3))]
        made = encoder.encode([self.closing(author) for author in authors])
        if self.one_in(10):
            at = chance.randrange(min(len(made), 30))
            made = made[:at] + bytes([chance.randrange(256)]) + made[at + 1 :]
        if self.one_in(30):
            made = made[: -1 - chance.randrange(4)]
        return made if len(made) < 1060 else encoder.encode([single(pid, self.table.ledger.held[pid] + 1)])

    def word(self) -> Said:
        chance, plain = self.chance, self.table.ledger
        pid, number = chance.choice(self.others), plain.number
        applied = max(plain.applied[pid], number[APPLIED] + chance.choice((-1, 0, 0, 0, 1, 2)))
        round_ = applied + chance.choice((1, 1, 1, 1, 1, 0, -1, 2))
        if self.one_in(15):
            applied = number[LAST] + chance.choice((-1, 0, 1))
        if self.one_in(20):
            applied = plain.applied[pid] - 1
        settled = applied - chance.randrange(9)
        if self.one_in(15):
            settled = number[LAST] + chance.choice((-1, 0, 1))
        held = chance.choice((b"\x91\x01", b"\xdc\x00\x00", b"\xc0", b"\x90\x90")) if self.one_in(20) else b"\x90"
        if self.one_in(4):  # nearly all is held; now and then more than may be
            ahead = 1 if self.one_in(20) else 0
            held = encoder.encode([max(0, applied + chance.randrange(-2, 3)) for _ in range(self.table.n - 1)])
            held = encoder.encode([*msgspec.msgpack.decode(held), number[LAST] + ahead])
        echoes = tuple([Echo(p, 1, 2) for p in chance.sample(range(self.table.n), chance.choice((0, 0, 1)))])
        closings = self.closings(pid)
        if len(closings) + len(held) > 1060:
            closings = b"\x90"
        said = Said(pid, max(0, round_), max(0, applied), max(0, settled), closings, held, echoes)
        return said if chance.randrange(12) else said._replace(round=0)

    def hear(self, most: int) -> None:
        """The rows of one datagram depend on those before it, so each is made when those were heard, or all at once."""
        for _ in range(self.chance.randrange(3)):
            noted = self.table.hear(*[self.word() for _ in range(self.chance.choice((1, 1, 4, most)))])
            self.noted += sum(noted)
            self.refused += len(noted) - sum(noted)

    def apply(self) -> None:
        """On to the next round, also where not all is here, as with closings that are in the log."""
        chance, table = self.chance, self.table
        number, round_ = table.ledger.number, table.ledger.number[APPLIED] + 1
        self.collected += table.collect(round_) is not None
        if self.one_in(3):
            table.collect(round_ + chance.choice((-DEPTH - 1, -DEPTH, 1 - DEPTH, -1, 1, 2)))
        settled = max(number[SETTLED], round_ - chance.choice((1, 2, 3, 12)))
        watched = (
            {WATCHED: chance.choice((-1, round_, round_ + 1)), REACHED: chance.randrange(3)} if self.one_in(2) else {}
        )
        table.number({APPLIED: round_, SETTLED: settled, LAST: round_ + 9, TICK: round_ * 8, **watched})
        for pid in range(table.n):
            if table.ledger.held[pid] < round_ and not self.one_in(5):  # it came some other way
                table.rows(pid)
                table.put("held", pid, round_)
                table.put("floor", pid, round_)
        held, incarnation = table.ledger.held, table.ledger.incarnation
        table.number({LACKING: sum(held[p] <= round_ and incarnation[p] >= 0 for p in range(table.n))})

    def move(self) -> None:
        """What else Python does to the columns."""
        chance, table = self.chance, self.table
        kind, pid = chance.randrange(14), chance.randrange(table.n)
        if kind == 0:
            table.put("gap", pid, int(self.one_in(2)))
        elif kind == 1:
            table.want(pid, self.one_in(3))
        elif kind == 2:
            table.put("incarnation", pid, chance.choice((-1, 0, 1, 2, 2**53)))
        elif kind == 3:
            table.put("view", pid, chance.choice((-1, table.view, table.view, table.view + 1)))
        elif kind == 4:
            table.number({OPEN: int(chance.randrange(4) > 0)})
        elif kind == 5:
            table.rows(pid)
        elif kind == 6:
            table.rows(pid)
            for column in ("held", "floor"):
                table.put(column, pid, max(0, table.ledger.number[APPLIED] - 1))
        elif kind == 7 and self.one_in(5):
            table.follow(table.view + 1)
        elif kind == 8:
            table.put("applied", pid, table.ledger.number[APPLIED])
        elif kind == 9:  # all is well again
            table.set("gap", *bytes(table.n))
            for other in range(table.n):
                table.want(other, False)
            table.set("view", *[table.view] * table.n)
            table.set("incarnation", *[chance.choice((0, 0, -1)) for _ in range(table.n)])
            table.number({OPEN: 1})

    def own(self) -> None:
        chance, pid = self.chance, self.table.pid
        round_ = self.table.ledger.held[pid] + (1 if chance.randrange(6) else chance.choice((0, 2)))
        lock = chance.choice((-1, -1, -1, -1, -1, 0, 300))
        if self.one_in(4):
            self.table.close(round_ + chance.choice((0, 1, 1, 3, DEPTH)), acted=self.one_in(6), first=round_)
        else:
            self.table.close(round_, *self.writes(), acted=self.one_in(2), prompt=self.one_in(2), lock=lock)


@pytest.mark.parametrize(("n_sys", "steps"), [(2, 400), (3, 400), (5, 300), (16, 100), (128, 25)])
@pytest.mark.parametrize("seed", range(8))
def test_any_course_is_the_models(n_sys: int, steps: int, seed: int) -> None:
    course = Course(seed, n_sys)
    for _ in range(steps):
        for _ in range(course.chance.randrange(4)):
            course.hear(3 * n_sys)
        course.own()
        if course.one_in(2):
            course.apply()
        if course.one_in(2):
            course.move()
    assert course.noted > steps / 4 and course.refused > steps / 4
    assert n_sys > 5 or course.collected > steps / 100
