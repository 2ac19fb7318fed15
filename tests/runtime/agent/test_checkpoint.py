"""What a robot finds again after kill -9: the newest whole records, nothing damaged, nothing of others."""

from __future__ import annotations

import errno
import os
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.agent.checkpoint import CheckpointFile, LocalsCodec
from koordgen.runtime.agent.records import KEPT, Acceptor, Loaded, Locals, Mission
from koordgen.runtime.net.transport import CannotOpen
from koordgen.runtime.program.program import Life, Program, Variable
from koordgen.runtime.values.bounds import Blob, Fixed, Many, Text
from koordgen.runtime.values.points import Opaque, Point
from tests.disk import small_disk

MISSION = Mission(b"epoch---", 123_456_789, b"entry of round 0")
ACCEPTOR = Acceptor(b"view", 7, 2, 3, -1, b"")


def locals_of(round_: int, text: bytes = b"\x91\x05") -> Locals:
    return Locals(round_, 0, text, b"\x91\xc0", False)


class Kept:
    """A store's path, and what it warned of."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warned: list[str] = []

    def open(self, program: Program = PROGRAM, robot: str = "alice", pid: int = 0, n: int = 3) -> CheckpointFile:
        return CheckpointFile.open(self.path, program, robot, pid, n, self.warned.append)

    def found(self) -> Loaded:
        store = self.open()
        try:
            return store.load()
        finally:
            store.close()


@pytest.fixture
def kept(tmp_path: Path) -> Kept:
    return Kept(tmp_path / "state" / "alice.state")


def filled(kept: Kept) -> CheckpointFile:
    store = kept.open()
    assert store.write(MISSION) and store.write(ACCEPTOR)
    for round_ in range(1, 21):
        assert store.write(locals_of(round_))
    return store


def test_the_newest_of_each_kind_are_found_again(kept: Kept) -> None:
    store = filled(kept)
    expected = Loaded(MISSION, tuple(locals_of(r) for r in range(21 - KEPT, 21)), ACCEPTOR)
    assert store.load() == expected
    store.close()
    assert kept.found() == expected
    assert kept.path.stat().st_mode & 0o777 == 0o600
    assert kept.warned == []


def test_what_is_written_after_a_restart_is_newer(kept: Kept) -> None:
    filled(kept).close()
    store = kept.open()
    assert store.write(locals_of(20, b"\x91\x06")) and store.write(Acceptor(b"", 8, 2, 3, -1, b""))
    store.close()
    found = kept.found()
    assert found.locals[-1] == locals_of(20, b"\x91\x06")
    assert found.acceptor is not None and found.acceptor.applied == 8
    assert len(found.locals) == KEPT


def test_a_new_mission_forgets_all(kept: Kept) -> None:
    store = filled(kept)
    store.clear()
    assert store.load() == Loaded()
    assert store.write(MISSION)
    store.close()
    assert kept.found() == Loaded(MISSION)


def test_a_vote_lies_within_one_page_of_the_file(kept: Kept) -> None:
    """So that the death of the process cannot cut its write short."""
    big = replace(PROGRAM, locals=(Variable("data", "local", Opaque, Blob(5_000, "Data"), Opaque),))
    for program, n in ((PROGRAM, 3), (big, 3), (PROGRAM, 128)):
        kept.path.unlink(missing_ok=True)
        store = kept.open(program, n=n)
        for number in range(4):
            assert store.write(Acceptor(bytes([number]) * (8 * n), number, 2, 3, -1, b"\xaa" * (8 * n)))
        store.close()
        data = kept.path.read_bytes()
        for number in (2, 3):
            first = data.index(bytes([number]) * (8 * n))
            last = data.index(b"\xaa" * (8 * n), first) + 8 * n + 16
            assert (first - 15) // 4096 == last // 4096
    kept.path.unlink()


def test_the_file_never_grows(kept: Kept) -> None:
    store = kept.open()
    size, blocks = kept.path.stat().st_size, kept.path.stat().st_blocks
    assert blocks * 512 >= size, "allocated in full before anything is written"
    store.close()
    filled(kept).close()
    assert kept.path.stat().st_size == size


@pytest.mark.parametrize(
    ("program", "robot", "pid", "n", "words"),
    [
        (replace(PROGRAM, program_hash="ffffffffffffffff"), "alice", 0, 3, "of another program (lineform 0011"),
        (PROGRAM, "bert", 0, 3, "of robot alice, pid 0 of 3 (here bert"),
        (PROGRAM, "alice", 1, 3, "here alice, 1 of 3"),
        (PROGRAM, "alice", 0, 4, "here alice, 0 of 4"),
    ],
)
def test_a_file_of_others_is_begun_anew(kept: Kept, program: Program, robot: str, pid: int, n: int, words: str) -> None:
    filled(kept).close()
    store = kept.open(program, robot, pid, n)
    assert store.load() == Loaded()
    store.close()
    assert len(kept.warned) == 1
    assert words in kept.warned[0] and "is erased" in kept.warned[0] and str(kept.path) in kept.warned[0]
    assert kept.found() == Loaded(), "and the old records do not come back with their owner"


def test_a_file_that_is_not_ours_is_not_touched(kept: Kept) -> None:
    kept.path.parent.mkdir()
    kept.path.write_text("years of work")
    with pytest.raises(CannotOpen, match="not a file of koordgen"):
        kept.open()
    assert kept.path.read_text() == "years of work"


def test_without_a_folder_nothing_is_kept() -> None:
    store = CheckpointFile.open(None, PROGRAM, "alice", 0, 3, pytest.fail)
    assert not store.keeps and not store.write(MISSION)
    store.clear()
    assert store.load() == Loaded()
    store.close()


def test_two_processes_do_not_share_it(kept: Kept) -> None:
    store = kept.open()
    with pytest.raises(CannotOpen, match="is in use"):
        kept.open()
    store.close()
    kept.open().close()


# --- damage


def test_no_damage_yields_what_was_never_written(kept: Kept) -> None:
    filled(kept).close()
    whole = kept.path.read_bytes()
    written = {MISSION, ACCEPTOR, *map(locals_of, range(1, 21))}
    rng = random.Random(4)
    for _ in range(600):
        data = bytearray(whole)
        match rng.randrange(3):
            case 0:
                for _ in range(rng.randint(1, 40)):
                    data[rng.randrange(12, len(data))] ^= 1 << rng.randrange(8)
            case 1:
                del data[rng.randrange(len(data)) :]
            case _:
                at, length = rng.randrange(12, len(data)), rng.randint(1, 600)
                data[at : at + length] = rng.randbytes(len(data[at : at + length]))
        kept.path.write_bytes(data)
        try:
            found = kept.found()
        except CannotOpen:
            assert len(data) < 12, "cut short within the name of the format"
            continue
        assert {found.mission, found.acceptor, *found.locals} - {None} <= written
        rounds = [record.round for record in found.locals]
        assert rounds == sorted(set(rounds))


def test_a_write_cut_short_leaves_the_one_before(kept: Kept, monkeypatch: pytest.MonkeyPatch) -> None:
    """As by kill -9 amid a large write: only its first bytes reach the file; an acceptor's write lies within a page,
    and is never cut short so. The digests are the same in each call: one whose last byte stood there already would be
    whole without it, once in 256."""
    rng = random.Random(5)
    for attempt in range(60):
        monkeypatch.setattr(os, "urandom", rng.randbytes)
        kept.path.unlink(missing_ok=True)
        store = filled(kept)
        real = os.pwrite

        def torn(file: int, data: bytes, offset: int, real: Any = real) -> int:
            real(file, data[: rng.randrange(len(data))], offset)
            raise SystemExit

        monkeypatch.setattr(os, "pwrite", torn)
        with pytest.raises(SystemExit):
            store.write((Mission(b"other", 1, b""), locals_of(21))[attempt % 2])
        monkeypatch.undo()
        store.close()
        found = kept.found()
        assert (found.mission, found.acceptor) == (MISSION, ACCEPTOR)
        assert [r.round for r in found.locals] == list(range(21 - KEPT, 21))
        assert kept.warned == []


@pytest.mark.parametrize("which", ["the newer", "the older", "both", "a digest", "a length"])
def test_a_robot_whose_votes_are_damaged_does_not_come_back(kept: Kept, which: str) -> None:
    """Its mission can be read, and is forgotten all the same: a vote that is forgotten may be cast twice."""
    store = filled(kept)
    older, newer = Acceptor(b"older view", 8, 2, 3, -1, b""), Acceptor(b"newer view", 9, 3, 5, 5, b"a value")
    assert store.write(older) and store.write(newer)
    store.close()
    data = bytearray(kept.path.read_bytes())
    for text in {"the newer": [b"newer view"], "both": [b"older view", b"newer view"]}.get(which, [b"older view"]):
        place = data.index(text)
        data[place + {"a digest": 20, "a length": -6}.get(which, 0)] ^= 1
    kept.path.write_bytes(data)
    assert kept.found() == Loaded()
    (warning,) = kept.warned
    assert "is damaged" in warning and "cannot rejoin its mission" in warning and str(kept.path) in warning
    assert kept.found() == Loaded() and len(kept.warned) == 1, "it is said once"


def test_damaged_votes_of_no_mission_are_not_worth_a_word(kept: Kept) -> None:
    store = kept.open()
    assert store.write(ACCEPTOR)
    store.close()
    data = kept.path.read_bytes()
    kept.path.write_bytes(data.replace(b"view", b"veiw"))
    assert kept.found() == Loaded()
    assert kept.warned == []


def test_kill_9_loses_nothing_that_was_written(kept: Kept) -> None:
    code = (
        "import sys; from pathlib import Path; from koordgen.runtime.agent.checkpoint import *; "
        "from benchmarks.fixtures.lineform import PROGRAM\n"
        "store = CheckpointFile.open(Path(sys.argv[1]), PROGRAM, 'alice', 0, 3, print)\n"
        "for r in range(1, 10**9):\n"
        "    store.write(Locals(r, 0, b'\\x91\\x05', b'\\x91\\xc0', False))\n"
        "    sys.stdout.write(f'{r}\\n'); sys.stdout.flush()\n"
    )
    root = Path(__file__).parents[3]
    for _ in range(3):
        kept.path.unlink(missing_ok=True)
        with subprocess.Popen([sys.executable, "-c", code, str(kept.path)], stdout=subprocess.PIPE, cwd=root) as writer:
            assert writer.stdout is not None
            lines = [writer.stdout.readline() for _ in range(200)]
            writer.send_signal(signal.SIGKILL)
            said = int([*lines, *writer.stdout][-1])
        rounds = [r.round for r in kept.found().locals]
        assert rounds[-1] in (said, said + 1)
        assert rounds == list(range(rounds[-1] - KEPT + 1, rounds[-1] + 1))


# --- disks


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    with small_disk(tmp_path / "small", "16k") as disk:
        yield disk


BIG = replace(PROGRAM, locals=(Variable("data", "local", Opaque, Blob(10_000, "Data"), Opaque),))


def test_a_full_disk_is_told_before_anything_moves(full_disk: Path) -> None:
    path = full_disk / "alice.state"
    with pytest.raises(CannotOpen, match=r"No space left on device; the file needs 100 KiB. Free disk space"):
        CheckpointFile.open(path, BIG, "alice", 0, 3, pytest.fail)
    assert not path.exists(), "nor is room taken for nothing"
    store = CheckpointFile.open(path, PROGRAM, "alice", 0, 3, pytest.fail)
    assert store.keeps
    store.close()


def test_a_disk_that_cannot_allocate(kept: Kept, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(CannotOpen, match=r"alice.state: No space left on device.*`state`"):
        kept.open()
    monkeypatch.undo()
    kept.open().close()


def test_a_folder_that_cannot_be_made(kept: Kept) -> None:
    kept.path.parent.write_text("")
    with pytest.raises(CannotOpen, match=r"state/alice.state: .*`state` to another folder"):
        kept.open()


def test_a_disk_that_goes_away_leaves_no_old_state(kept: Kept, monkeypatch: pytest.MonkeyPatch) -> None:
    store = filled(kept)

    def gone(*_: Any) -> int:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "pwrite", gone)
    assert not store.write(locals_of(21))
    assert not store.write(locals_of(22))
    monkeypatch.undo()
    assert not store.write(locals_of(23)) and not store.keeps
    assert len(kept.warned) == 1 and "Input/output error" in kept.warned[0] and "cannot rejoin" in kept.warned[0]
    assert kept.found() == Loaded()


def test_a_record_that_is_too_long_is_no_record(kept: Kept) -> None:
    store = kept.open()
    assert not store.write(locals_of(1, bytes(100_000)))
    assert "100" in kept.warned[0]


# --- the codec

CODED = replace(
    PROGRAM,
    locals=(
        Variable("count", "local", int, Fixed(9), lambda: 0),
        Variable("names", "local", tuple[str, ...], Many(3, Text(8)), lambda: ()),
        Variable("data", "local", Opaque, Blob(30, "Data"), Opaque),
    ),
)
VALUES = {"count": -3, "names": ("a", "ü"), "data": Opaque(b"\xc0")}


def test_locals_and_actuators_come_back_typed() -> None:
    codec = LocalsCodec([CODED])
    for actuators in ({"Motion.target": Point(1.0, 2.0, 3.0)}, {}):
        life = Life(4, VALUES, actuators, False)
        assert codec.decode(codec.encode([life], 2)) == [life]


def test_the_states_of_several_instances_come_back_each_with_its_round() -> None:
    codec = LocalsCodec([CODED, CODED])
    lives = [Life(4, VALUES, {"Motion.target": Point(1.0, 2.0, 3.0)}, True), Life(9, {**VALUES, "count": 7}, {}, False)]
    record = codec.encode(lives, 2)
    assert codec.decode(record) == lives and (record.round, record.stopped) == (9, False)
    assert LocalsCodec([CODED]).decode(record) is None and LocalsCodec([CODED] * 3).decode(record) is None
    assert codec.decode(msgspec.structs.replace(record, locals=record.locals[:-1])) is None


def test_the_longest_values_have_room(kept: Kept) -> None:
    values = {"count": -(2**63), "names": ("ü" * 4,) * 3, "data": Opaque(bytes(30))}
    store = kept.open(CODED, n=128)
    top = 2**53
    life = Life(top, values, {"Motion.target": Point(1e300, 2.5, -1e-300)}, True)
    assert store.write(LocalsCodec([CODED]).encode([life], top))
    view = bytes(3 * 9 + 5 + 9 * 128)
    assert store.write(Acceptor(view, top, top, top, top, view))


@pytest.mark.parametrize(
    "values",
    [
        {**VALUES, "count": 1.5},
        {**VALUES, "names": ("a",) * 4},
        {**VALUES, "names": ("a" * 9,)},
        {**VALUES, "data": Opaque(bytes(31))},
        {**VALUES, "count": None},
    ],
)
def test_what_no_program_may_hold_is_refused(values: dict[str, Any]) -> None:
    codec = LocalsCodec([CODED])
    assert codec.decode(codec.encode([Life(1, values, {}, False)], 0)) is None


def test_the_codec_never_raises() -> None:
    codec, rng = LocalsCodec([CODED]), random.Random(6)
    record = codec.encode([Life(1, VALUES, {"Motion.target": Point(1.0, 2.0, 3.0)}, False)], 0)
    locals_, actuators = record.locals, record.actuators

    def decoded(locals_: bytes, actuators: bytes) -> list[Life] | None:
        several = LocalsCodec([CODED, CODED]).decode(msgspec.structs.replace(record, locals=locals_))
        return codec.decode(msgspec.structs.replace(record, locals=locals_, actuators=actuators)) or several

    assert decoded(locals_, b"") is None and decoded(b"\x91\x05", actuators) is None
    nowhere = codec.encode([Life(1, VALUES, {"Motion.target": Point(float("nan"))}, False)], 0)
    assert codec.decode(nowhere) is None
    for _ in range(3000):
        data = bytearray(locals_ if rng.random() < 0.5 else rng.randbytes(rng.randrange(40)))
        for _ in range(rng.randrange(4)):
            if data:
                data[rng.randrange(len(data))] = rng.randrange(256)
        decoded(bytes(data), bytes(data[: rng.randrange(len(data) + 1)]))
        decoded(locals_, bytes(data))
