"""Checkpoint file: records that survive a crash of a robot's process, in a file of fixed length.

The whole file is allocated when it is opened, so a full disk is reported before the robot moves. A record is one
`pwrite` into a slot of its kind. A slot is valid only if its digest is right, so an interrupted write has no effect,
and earlier records remain. Nothing is synced to the disk: the file survives a crash of the process, not a loss of
power.

An acceptor record lies within one page of memory, so a crash of the process cannot interrupt its write. An acceptor
record with a wrong digest therefore means that the file is damaged, and that this robot's promises may be lost. Then
all records are erased, because a robot that has forgotten a vote must not continue its mission."""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from hashlib import blake2s
from hmac import compare_digest
from pathlib import Path
from typing import Any, Protocol

import msgspec

from koordgen.runtime.agent.records import KEPT, Acceptor, Identity, Kept, Loaded, Locals, Mission
from koordgen.runtime.net.transport import CannotOpen
from koordgen.runtime.program.program import Life, Port, Program, Variable
from koordgen.runtime.values.points import transmissible

STORE_FORMAT = 2
_MAGIC = b"koord-state\n"
_HEADER = 512  # size of the header in bytes; less than a page, so a crash cannot interrupt its write
_DIGEST = 16  # size of a digest in bytes
_PAGE = 4096  # bytes; the page size of every supported system is a multiple of this number
_INSTANCE = 32  # most bytes of an instance's state in a record of several, without its values
_HEAD = struct.Struct("!BQI")  # kind, sequence number, length of the payload

_encode = msgspec.msgpack.Encoder().encode


_KINDS: tuple[type[Mission] | type[Locals] | type[Acceptor], ...] = (Mission, Locals, Acceptor)
_NUMBERS = {kind: number for number, kind in enumerate(_KINDS)}
_SLOTS = (2, KEPT + 1, 2)  # number of slots for each kind: one more than needed, because a crash may damage a record
_DECODERS: tuple[msgspec.msgpack.Decoder[Kept], ...] = tuple(msgspec.msgpack.Decoder(kind) for kind in _KINDS)


_states = msgspec.msgpack.Decoder(list[tuple[int, bool, bytes, bytes]])
_identity_decoder = msgspec.msgpack.Decoder(Identity)


class CheckpointStore(Protocol):
    """Store of the records that survive a crash of a robot's process."""

    def write(self, record: Kept) -> bool: ...

    def load(self) -> Loaded: ...

    def clear(self) -> None: ...


class CheckpointFile:
    """Checkpoint file of one robot.

    `write` never raises. After a failed write, all records are erased, so that a restarted process finds no outdated
    state."""

    def __init__(self, identity: Identity, path: Path | None, file: int, warn: Callable[[str], None]) -> None:
        self._identity = identity
        self._path = path
        self._file = file  # file descriptor; -1: no record is stored
        self._warn = warn
        self._sequence = 0
        self._keyed = blake2s(digest_size=_DIGEST, key=identity.token)
        self._next = [0] * len(_KINDS)  # for each kind of record, the next slot to write
        mission, locals_, acceptor = [_length(room) for room in identity.rooms]
        assert acceptor <= _PAGE
        self._lengths = [mission, locals_, _PAGE]
        second = _HEADER + _SLOTS[0] * mission
        third = -(-(second + _SLOTS[1] * locals_) // _PAGE) * _PAGE
        self._begins = [_HEADER, second, third, third + _SLOTS[2] * _PAGE]

    @classmethod
    def open(cls, path: Path | None, program: Program, robot: str, pid: int, n_sys: int,
             warn: Callable[[str], None], instances: int = 1) -> CheckpointFile:  # fmt: skip
        """Open the file at `path`, and create and allocate it if needed. Without a path, no record is stored.

        program: the program of the robot; see FleetProgram.of.
        instances: number of the robot's instances.
        A file of another program, robot or format is reported by `warn` and erased. Raises CannotOpen."""
        identity = Identity(
            STORE_FORMAT, program.name, program.program_hash, robot, pid, n_sys, rooms(program, n_sys, instances)
        )
        if path is None:
            return cls(identity, None, -1, warn)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise _cannot(path, error) from None
        store = cls(identity, path, file, warn)
        try:
            store._prepare(path)
        except OSError as error:
            store.close()
            raise _cannot(path, error) from None
        except CannotOpen:
            store.close()
            raise
        loaded = store.load()  # also sets the sequence number, so that new records count as newer
        if store._is_damaged(_NUMBERS[Acceptor]):
            if loaded.mission is not None:
                warn(
                    f"state: {path} is damaged: this robot's promises to the other robots cannot be read, so the robot "
                    "cannot rejoin its mission. End the programs of all robots and start them again"
                )
            store.clear()
        return store

    @property
    def keeps(self) -> bool:
        """True if records are stored, so that a restarted process can find them."""
        return self._file >= 0

    def write(self, record: Kept) -> bool:
        """Store a record. Return False after a failure, which is reported once by `warn`.

        This method must be fast: the robot's entry is sent after this write, and all other robots wait for the
        entry."""
        if self._file < 0:
            return False
        kind, payload = _NUMBERS[type(record)], _encode(record)
        length, slot = len(payload), self._next[kind]
        self._sequence += 1
        body, digest = _HEAD.pack(kind, self._sequence, length) + payload, self._keyed.copy()
        digest.update(body)
        body += digest.digest()
        try:
            if length > self._identity.rooms[kind]:
                raise OSError(
                    errno.EFBIG, f"a record has {length} bytes, but its slot has {self._identity.rooms[kind]} bytes"
                )
            if os.pwrite(self._file, body, self._begins[kind] + slot * self._lengths[kind]) != len(body):
                raise _full()
        except OSError as error:
            self._give_up(error)
            return False
        self._next[kind] = slot + 1 if slot + 1 < _SLOTS[kind] else 0
        return True

    def load(self) -> Loaded:
        """Return the stored records. Never raises; damaged records are ignored."""
        newest: dict[int, tuple[int, int, Kept]] = {}  # kind -> sequence, slot, record
        rounds: dict[int, tuple[int, Locals]] = {}
        for kind, slots in enumerate(_SLOTS):
            for slot in range(slots):
                found = self._read(kind, slot)
                if found is None:
                    continue
                sequence, record = found
                if kind not in newest or sequence > newest[kind][0]:
                    newest[kind] = (sequence, slot, record)
                if isinstance(record, Locals) and sequence > rounds.get(record.round, (0, None))[0]:
                    rounds[record.round] = (sequence, record)
        for kind, (sequence, slot, _) in newest.items():
            self._sequence = max(self._sequence, sequence)
            self._next[kind] = (slot + 1) % _SLOTS[kind]
        by_type = {type(record): record for _, _, record in newest.values()}
        mission, acceptor = by_type.get(Mission), by_type.get(Acceptor)
        return Loaded(
            mission if isinstance(mission, Mission) else None,
            tuple(rounds[r][1] for r in sorted(rounds)[-KEPT:]),
            acceptor if isinstance(acceptor, Acceptor) else None,
        )

    def clear(self) -> None:
        """Erase all records, because a new mission begins."""
        if self._file >= 0:
            try:
                self._begin_anew()
            except OSError as error:
                self._give_up(error)

    def close(self) -> None:
        if self._file >= 0:
            with suppress(OSError):
                os.close(self._file)
            self._file = -1

    def _prepare(self, path: Path) -> None:
        """Lock the file and allocate its full length. Erase the file if it has another identity."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise CannotOpen(f"state: {path} is in use; check whether the robot's program is already running") from None
        os.fchmod(self._file, 0o600)
        old = os.pread(self._file, _HEADER, 0)
        if any(old) and not old.startswith(_MAGIC):
            raise CannotOpen(f"state: {path} is not a file of koordgen; move it away, or set another `state` folder")
        size = self._offset(len(_KINDS), 0)
        try:
            os.ftruncate(self._file, size)
            os.posix_fallocate(self._file, 0, size)
        except OSError as error:
            if not any(old):
                path.unlink(missing_ok=True)  # the file was new or empty
            raise _cannot(path, error, f"; the file needs {-(-size // 1024)} KiB") from None
        found = _identity(old)
        ours = found is not None and msgspec.structs.replace(found, token=b"") == self._identity
        if found is not None and ours:
            self._identify(found)
            return
        if any(old):
            self._warn(f"state: {path} is {_difference(found, self._identity)}; the file is erased")
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Erase all records and write a header with a new token. Mission records are erased first.

        Other records are not used without a mission record, so an interrupted erasure does no harm.
        """
        size = self._offset(len(_KINDS), 0)
        _put(self._file, bytes(size - _HEADER), _HEADER)
        self._identify(msgspec.structs.replace(self._identity, token=os.urandom(16)))
        text = _encode(self._identity)
        body = (_MAGIC + len(text).to_bytes(2, "big") + text).ljust(_HEADER - _DIGEST, b"\0")
        _put(self._file, body + blake2s(body, digest_size=_DIGEST).digest(), 0)

    def _identify(self, identity: Identity) -> None:
        self._identity = identity
        self._keyed = blake2s(digest_size=_DIGEST, key=identity.token)

    def _give_up(self, error: OSError) -> None:
        with suppress(OSError):
            os.ftruncate(self._file, 0)
        self.close()
        if self._path is not None:
            with suppress(OSError):
                self._path.unlink()
        self._warn(
            f"state: {self._path}: {error.strerror or error}; no state is stored from now on. If this robot's program "
            "dies, the robot cannot rejoin this mission"
        )

    def _offset(self, kind: int, slot: int) -> int:
        """Return the offset of a slot in the file. For `kind` = len(_KINDS), return the length of the file."""
        return self._begins[kind] + (slot * self._lengths[kind] if slot else 0)

    def _digest(self, body: bytes) -> bytes:
        state = self._keyed.copy()
        state.update(body)
        return state.digest()

    def _is_damaged(self, kind: int) -> bool:
        """Return whether a slot of this kind contains data but no valid record."""
        slots = [slot for slot in range(_SLOTS[kind]) if self._read(kind, slot) is None]
        return any(any(os.pread(self._file, self._lengths[kind], self._offset(kind, slot))) for slot in slots)

    def _read(self, kind: int, slot: int) -> tuple[int, Kept] | None:
        if self._file < 0:
            return None
        try:
            raw = os.pread(self._file, _length(self._identity.rooms[kind]), self._offset(kind, slot))
        except OSError:
            return None
        if len(raw) < _HEAD.size:
            return None
        written, sequence, length = _HEAD.unpack_from(raw)
        end = _HEAD.size + length
        if written != kind or not compare_digest(raw[end : end + _DIGEST], self._digest(raw[:end])):
            return None
        try:
            return sequence, _DECODERS[kind].decode(raw[_HEAD.size : end])
        except ValueError:
            return None


def rooms(program: Program, n_sys: int, instances: int) -> tuple[int, ...]:
    """Return the largest size in bytes of each kind of record: Mission, Locals, Acceptor."""
    shared = sum(4 + v.bound.bytes for v in program.shared)
    own = sum(v.bound.bytes for v in program.locals)
    ports = sum(1 + p.bound.bytes for p in _actuators(program) if p.bound is not None)
    view = 128 + 10 * n_sys  # most bytes of an encoded view, which has one number for each robot
    heads = _INSTANCE * instances if instances > 1 else 0
    return (256 + shared, 64 + own + ports + heads, 64 + 2 * view)


def _length(room: int) -> int:
    return _HEAD.size + room + _DIGEST


def _put(file: int, data: bytes, offset: int) -> None:
    if os.pwrite(file, data, offset) != len(data):
        raise _full()


def _full() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _identity(header: bytes) -> Identity | None:
    body, digest = header[:-_DIGEST], header[-_DIGEST:]
    if len(header) != _HEADER or not compare_digest(blake2s(body, digest_size=_DIGEST).digest(), digest):
        return None
    at = len(_MAGIC) + 2
    length = int.from_bytes(body[at - 2 : at], "big")
    try:
        return _identity_decoder.decode(body[at : at + length])
    except ValueError:
        return None


def _difference(found: Identity | None, own: Identity) -> str:
    if found is None:
        return "damaged, or of another version"
    if (found.app, found.program) != (own.app, own.program):
        return f"of another program ({found.app} {found.program}, here {own.app} {own.program})"
    if (found.robot, found.pid, found.n_sys) != (own.robot, own.pid, own.n_sys):
        return f"of robot {found.robot}, pid {found.pid} of {found.n_sys} (here {own.robot}, {own.pid} of {own.n_sys})"
    return "of another version"


def _cannot(path: Path, error: OSError, more: str = "") -> CannotOpen:
    return CannotOpen(
        f"state: {path}: {error.strerror or error}{more}. Free disk space, allow this user to write the file, or set "
        "`state` to another folder (null: no state is stored, and this robot cannot rejoin a mission)"
    )


def _actuators(program: Program) -> tuple[Port, ...]:
    return tuple(p for p in program.ports if p.direction == "actuator")


class LocalsCodec:
    """Codec of the private states of a robot's instances: records `Locals`.

    The values of local variables and actuators are MessagePack arrays in the order of the instance's program. An
    actuator without a value is encoded as nil. With several instances, `Locals.locals` is an array that has round,
    `stopped`, local variables and actuators of each, and `Locals.actuators` is empty."""

    def __init__(self, programs: Sequence[Program]) -> None:
        self._places: list[tuple[tuple[Variable | Port, ...], tuple[Variable | Port, ...]]] = [
            (program.locals, _actuators(program)) for program in programs
        ]

    def encode(self, lives: Sequence[Life], incarnation: int) -> Locals:
        if len(lives) == 1:
            return Locals(lives[0].round, incarnation, *self._parts(0, lives[0]), lives[0].stopped)
        states = [(life.round, life.stopped, *self._parts(place, life)) for place, life in enumerate(lives)]
        round_ = max([life.round for life in lives], default=0)
        return Locals(round_, incarnation, _encode(states), b"", all(life.stopped for life in lives))

    def _parts(self, place: int, life: Life) -> tuple[bytes, bytes]:
        own, ports = self._places[place]
        return _encode([life.locals[v.name] for v in own]), _encode([life.actuators.get(p.name) for p in ports])

    def decode(self, record: Locals) -> list[Life] | None:
        """Return the private state of each instance, or None if a value does not fit its program. Never raises."""
        if len(self._places) == 1:
            states = [(record.round, record.stopped, record.locals, record.actuators)]
        else:
            try:
                states = _states.decode(record.locals)
            except (ValueError, RecursionError):
                return None
        if len(states) != len(self._places):
            return None
        found = []
        for (round_, stopped, locals_, actuators), (own, ports) in zip(states, self._places, strict=True):
            values, commanded = _values(own, locals_, False), _values(ports, actuators, True)
            if values is None or commanded is None:
                return None
            found.append(Life(round_, values, commanded, stopped))
        return found


def _values(places: tuple[Variable | Port, ...], data: bytes, may_lack: bool) -> dict[str, Any] | None:
    try:
        raw = msgspec.msgpack.decode(data, type=list[msgspec.Raw])
        if len(raw) != len(places):
            return None
        found = {}
        for place, text in zip(places, raw, strict=True):
            if may_lack and bytes(text) == b"\xc0":
                continue
            value = msgspec.msgpack.decode(text, type=place.type)
            if not transmissible(value) or (place.bound is not None and place.bound.flaw(value)):
                return None
            found[place.name] = value
    except (ValueError, RecursionError):  # a text with invalid UTF-8 raises ValueError, not DecodeError
        return None
    return found
