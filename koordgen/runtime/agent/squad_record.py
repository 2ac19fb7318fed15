"""Record of an outer robot in the inner store: its checkpoint, and the host that wrote it.

A host writes the whole record. A robot that becomes the host first *claims* it: it writes the record that it has read,
with the next term and its own boot id. A host whose term is no longer in the record has been replaced."""

from __future__ import annotations

import msgspec

from koordgen.runtime.agent.records import Acceptor, Kept, Loaded, Locals, MemoryStore, Mission
from koordgen.runtime.values.points import Opaque


class HostRecord(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Record of an outer robot.

    term: number of claims so far.
    pid: inner pid of the host, which has made the last claim; -1 before the first claim.
    boot: boot id of the host's inner agent.
    version: number of writes of checkpoint records and commands so far.
    mission, locals, acceptor: the checkpoint, see Loaded.
    """

    term: int = 0
    pid: int = -1
    boot: bytes = b""
    version: int = 0
    mission: Mission | None = None
    locals: tuple[Locals, ...] = ()
    acceptor: Acceptor | None = None


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(HostRecord)
_FIRST = HostRecord()


def read_record(value: Opaque) -> HostRecord:
    """Return the record in the value of the store's variable. Raises ValueError for a value that no host wrote."""
    return _decoder.decode(value.data) if value.data else _FIRST


def claimed(record: HostRecord, pid: int, boot: bytes) -> Opaque:
    """Return the value by which the inner robot `pid`, whose agent has the boot id `boot`, claims a record."""
    return Opaque(_encoder.encode(msgspec.structs.replace(record, term=record.term + 1, pid=pid, boot=boot)))


class RecordStore(MemoryStore):
    """Checkpoint of an outer robot on its present host, which writes it to the inner store. Implements CheckpointStore.

    version: number of writes so far. A datagram that depends on them may leave once this version is committed.
    """

    def __init__(self, record: HostRecord) -> None:
        super().__init__(Loaded(record.mission, record.locals, record.acceptor))
        self.term, self.version = record.term, record.version
        self._pid, self._boot = record.pid, record.boot

    def write(self, record: Kept) -> bool:
        self.touch()
        return super().write(record)

    def clear(self) -> None:
        self.touch()
        super().clear()

    def touch(self) -> None:
        """Note that there is something new to write."""
        self.version += 1

    def value(self) -> Opaque:
        """Return the value to write into the inner store."""
        kept = self.load()
        own = self.term, self._pid, self._boot, self.version
        return Opaque(_encoder.encode(HostRecord(*own, kept.mission, kept.locals, kept.acceptor)))

    def is_of(self, record: HostRecord) -> bool:
        """Return whether the record is still that of this host and its claim."""
        return (record.term, record.boot) == (self.term, self._boot)
