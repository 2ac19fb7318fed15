"""Rejoin: how a robot is admitted again and fetches a snapshot, fragment by fragment, from one member at a time."""

from __future__ import annotations

from random import Random

import msgspec

from koordgen.runtime.net.fragments import cut
from koordgen.runtime.net.wire import Entry, RejoinRequest, Snapshot, SnapshotFragment, View
from koordgen.runtime.replication.messages import Send
from koordgen.runtime.replication.rejoin import MOST_AT_ONCE, SNAPSHOTS, TIMEOUT, Rejoin, Snapshots
from tests.runtime.replication.states import head

VIEW = View(4, 30, (0, 2, 4))
CLEO = 2
ROOM = 100


def answer(snapshots: Snapshots, sender: int, want: RejoinRequest, present: Snapshot) -> list[Send]:
    return snapshots.answer(sender, want, present.applied, lambda: present)


def snapshot(applied: int, size: int = 2000) -> Snapshot:
    data = Random(applied).randbytes(size)
    return Snapshot(VIEW, applied, (msgspec.Raw(msgspec.msgpack.encode(data)),), (-1,) * 3, (0,) * 3)


def wanted(sends: list[Send]) -> tuple[list[int], RejoinRequest]:
    """Return the receivers of a request, and the request."""
    [send] = sends
    assert send.kind is RejoinRequest
    return list(send.to), RejoinRequest(head(CLEO), *send.fields)


def fragments(sends: list[Send], sender: int = 0) -> list[SnapshotFragment]:
    return [SnapshotFragment(head(sender), *s.fields) for s in sends if s.kind is SnapshotFragment and s.to == (CLEO,)]


def test_a_robot_that_is_no_member_asks_all_robots_to_admit_it() -> None:
    rejoin = Rejoin(CLEO, 3)
    out = View(3, 20, (0, 2, -1))
    assert rejoin.incarnation(out) == -1
    to, want = wanted(rejoin.poll(1, out))
    assert to == [0, 1] and (want.view, want.incarnation) == (3, -1)
    assert rejoin.incarnation(VIEW) == 4
    assert rejoin.incarnation(View(3, 20, (0, 2, 3))) == -1, "an incarnation from before it fell out does not count"


def fetch(rejoin: Rejoin, sources: dict[int, Snapshots], now: dict[int, Snapshot], rng: Random, loss: float) -> int:
    """Let the robot fetch a snapshot. Return how many ticks that took."""
    for tick in range(1, 500):
        to, want = wanted(rejoin.poll(tick, VIEW))
        for pid in to:
            if rng.random() < loss or pid not in sources:
                continue
            answers = fragments(answer(sources[pid], CLEO, want, now[pid]), pid)
            assert len(answers) <= MOST_AT_ONCE
            rng.shuffle(answers)
            for fragment in answers:
                found = rejoin.step(fragment, tick) if rng.random() >= loss else None
                assert not isinstance(found, str)
                if found is not None:
                    assert found in (snapshot(s.applied) for s in now.values()) or found.applied < now[pid].applied
                    assert found == snapshot(found.applied)
                    return tick
        for pid, held in now.items():
            if rng.random() < 0.5:
                now[pid] = snapshot(held.applied + 1)  # a round is applied meanwhile
    raise AssertionError("the snapshot never arrived")


def test_a_snapshot_in_many_fragments_arrives_though_the_store_changes_meanwhile() -> None:
    for seed in range(10):
        for loss, most in ((0.0, 3), (0.3, 40)):
            sources, now = {0: Snapshots(ROOM), 1: Snapshots(ROOM)}, {0: snapshot(40), 1: snapshot(41)}
            assert fetch(Rejoin(CLEO, 3), sources, now, Random(seed), loss) <= most


def test_a_member_that_does_not_answer_is_not_asked_for_long() -> None:
    took = fetch(Rejoin(CLEO, 3), {1: Snapshots(ROOM)}, {1: snapshot(41)}, Random(1), 0.0)
    assert TIMEOUT < took <= 3 * TIMEOUT


def test_a_robot_that_has_begun_gets_the_rest_of_the_same_snapshot() -> None:
    snapshots, rejoin = Snapshots(ROOM), Rejoin(CLEO, 3)
    _, want = wanted(rejoin.poll(1, VIEW))
    first = fragments(answer(snapshots, CLEO, want, snapshot(40)))
    for fragment in first[:10]:
        assert rejoin.step(fragment, 1) is None
    _, want = wanted(rejoin.poll(2, VIEW))
    rest = fragments(answer(snapshots, CLEO, want, snapshot(45)))
    assert {p.round for p in rest} == {40} and len(rest) == first[0].count - 10
    assert not {p.index for p in rest} & {p.index for p in first[:10]}


def test_only_the_last_snapshots_are_kept_and_a_robot_that_fetches_an_older_one_begins_anew() -> None:
    snapshots, rejoin = Snapshots(ROOM), Rejoin(CLEO, 3)
    _, want = wanted(rejoin.poll(1, VIEW))
    rejoin.step(fragments(answer(snapshots, CLEO, want, snapshot(40)))[0], 1)
    other = RejoinRequest(head(1), 4, 2, 0, b"", b"")
    for applied in range(41, 41 + SNAPSHOTS):
        answer(snapshots, 1, other, snapshot(applied))
    _, want = wanted(rejoin.poll(2, VIEW))
    newer = fragments(answer(snapshots, CLEO, want, snapshot(50)))
    assert {p.round for p in newer} == {50}
    assert rejoin.step(newer[0], 2) == "fragment of another blob"
    ticks = range(3, 4 + 2 * TIMEOUT)
    assert any(wanted(rejoin.poll(t, VIEW))[1].digest == b"" for t in ticks), (
        "after a while without a new fragment it begins anew"
    )


def test_a_blob_that_is_no_snapshot_is_refused_and_fetched_anew() -> None:
    rejoin = Rejoin(CLEO, 3)
    for blob in (b"no store", b"\xa2\xff\xfe", msgspec.msgpack.encode([1, 2, 3])):
        [fragment] = cut(blob, ROOM)
        assert rejoin.step(SnapshotFragment(head(0), 40, *fragment), 1) == "store does not fit"
        assert rejoin.fragments is None
    [good] = cut(msgspec.msgpack.encode(snapshot(40, 10)), ROOM)
    assert rejoin.step(SnapshotFragment(head(0), 40, *good), 2) == snapshot(40, 10)


def test_a_robot_alone_in_a_view_asks_no_robot() -> None:
    assert Rejoin(0, 0).poll(1, View(1, 5, (1,))) == []


def test_a_snapshot_is_made_once_for_a_round() -> None:
    """To pack all of a large store again for each of its many fragments would take longer than to send them."""
    snapshots, want, made = Snapshots(ROOM), RejoinRequest(head(1), 4, 2, 0, b"", b""), list[Snapshot]()

    def make() -> Snapshot:
        made.append(snapshot(40))
        return made[-1]

    first = snapshots.answer(1, want, 40, make)
    assert snapshots.answer(2, want, 40, make)[0].fields == first[0].fields and len(made) == 1


def test_a_robot_that_fetches_a_snapshot_closes_its_rounds_without_events() -> None:
    """So no other robot waits for it."""
    rejoin = Rejoin(CLEO, 3)
    assert rejoin.silence(25, View(3, 20, (0, 2, -1))) is None, "it is no member yet"
    assert rejoin.silence(VIEW.since - 1, VIEW) is None
    assert rejoin.silence(31, VIEW) == Entry(CLEO, 4, 30, 31)
    assert rejoin.silence(33, VIEW) == rejoin.silent == Entry(CLEO, 4, 30, 33)
