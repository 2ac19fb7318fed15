"""Record of an outer robot: what a host writes is what the next host has."""

from __future__ import annotations

from koordgen.runtime.agent.records import Acceptor, Kept, Locals, Mission
from koordgen.runtime.agent.squad_record import HostRecord, RecordStore, claimed, read_record
from koordgen.runtime.values.points import Opaque

MISSION = Mission(b"epoch", 7_000_000, b"init")
PRIVATE = [Locals(round_, 0, b"locals", b"actuators", False) for round_ in (3, 4)]
ACCEPTOR = Acceptor(b"view", 4, 2, 1, 1, b"accepted")


def written() -> RecordStore:
    """Return the store of a host that has written a whole checkpoint."""
    store = RecordStore(HostRecord(term=2, pid=1, boot=b"boot", version=10))
    kept: list[Kept] = [MISSION, *PRIVATE, ACCEPTOR]
    for record in kept:
        assert store.write(record)
    return store


def test_the_next_host_has_all_that_the_last_one_wrote() -> None:
    before = written()
    record = read_record(claimed(read_record(before.value()), 0, b"next"))
    assert (record.term, record.pid, record.boot, record.version) == (3, 0, b"next", before.version)
    after = RecordStore(record).load()
    assert (after.mission, after.locals, after.acceptor) == (MISSION, tuple(PRIVATE), ACCEPTOR)


def test_every_change_is_a_new_version() -> None:
    store = written()
    assert store.version == 10 + 4
    store.clear()
    assert store.version == 10 + 5
    empty = read_record(store.value())
    assert (empty.mission, empty.locals, empty.acceptor) == (None, (), None)


def test_a_host_knows_whether_the_record_is_still_its_own() -> None:
    store = written()
    own = read_record(store.value())
    assert store.is_of(own)
    assert not store.is_of(read_record(claimed(own, 1, b"boot"))), "of another term"
    assert not store.is_of(HostRecord(term=2, pid=1, boot=b"other")), "of another start of its process"


def test_before_the_first_claim_there_is_no_host() -> None:
    assert read_record(Opaque(b"")).pid == -1
