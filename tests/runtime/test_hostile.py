"""The network is hostile: what is forged, damaged, foreign, replayed or out of range raises and changes nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from koordgen.runtime import wire
from koordgen.runtime.link import Session
from koordgen.runtime.seal import MEMORY, POSITION, seal, unseal
from koordgen.runtime.values import Point
from koordgen.runtime.wire import LIMIT, WIRE_FORMAT, Closing, Hello, Message, Need, Round, Write
from tests.runtime.fleet import KEY, Fleet, Robot
from tests.runtime.lineform import PROGRAM

TOP = 2**53
CLEO = 2


def snapshot(robot: Robot) -> Any:
    """All state that datagrams could change, as plain values; what was dropped is counted elsewhere."""
    agent = robot.agent
    rounds = agent._rounds
    assert rounds is not None
    memory = rounds._memory
    logs = [
        (log.held, [str(e) for e in log.entries], sorted((k, str(e)) for k, e in log.later.items()))
        for log in memory._logs
    ]
    return (
        logs,
        str(memory._statements),
        memory.settled,
        memory.applied,
        memory.shared,
        str(agent._link.sessions),
        agent._link.epoch,
        list(agent._fleet_clock._exchanges),
        str(agent._joining._others),
    )


class Wiretap:
    """A mission of three with everything that went over its air."""

    def __init__(self) -> None:
        self.fleet = Fleet(n=3)
        self.heard: list[tuple[int, int, bytes]] = []
        send = self.fleet.network.send

        def tapped(sender: int, receiver: int, datagram: bytes) -> None:
            self.heard.append((sender, receiver, datagram))
            send(sender, receiver, datagram)

        self.fleet.network.send = tapped  # type: ignore[method-assign]
        self.fleet.boot_all().run_rounds(20)
        self.fleet.run(0.05)  # between publishing and the next asking: nothing is under way
        self.victim = self.fleet.robots[0]
        self.before = snapshot(self.victim)

    def play(self, *datagrams: bytes) -> dict[str, int]:
        """Let them arrive now; what was dropped, by reason."""
        link = self.victim.agent._link
        counted = dict(link.rejected)
        queue = self.fleet.network._queues[0]
        queue[:] = [(self.fleet.time.time, i, d) for i, d in enumerate(datagrams)]
        self.victim.agent.poll(self.victim.clock.now())
        assert not queue
        assert not self.victim.agent._broken
        return {k: v - counted.get(k, 0) for k, v in link.rejected.items() if v != counted.get(k, 0)}

    def unharmed(self) -> bool:
        return bool(snapshot(self.victim) == self.before)

    def forged(self, change: Callable[[Round], Message]) -> bytes:
        """A datagram that the genuine key sealed, from a robot gone wrong: the next one of cleo, changed."""
        sent = [wire.decode(d, KEY) for s, r, d in self.heard if s == CLEO and r == 0]
        last = [m for m in sent if isinstance(m, Round)][-1]
        head = msgspec.structs.replace(last.head, sequence=last.head.sequence + 1, echoes=())
        return wire.encode(change(msgspec.structs.replace(last, head=head, closings=())), KEY)


@pytest.fixture(scope="module")
def tap() -> Wiretap:
    return Wiretap()


def to_alice(tap: Wiretap) -> list[bytes]:
    return [d for s, r, d in tap.heard if r == 0]


def test_a_replay_of_everything_changes_nothing(tap: Wiretap) -> None:
    dropped = tap.play(*to_alice(tap))
    assert tap.unharmed()
    assert dropped["replayed"] > 0.9 * len(to_alice(tap))


def test_what_was_meant_for_another_robot_changes_nothing_of_ours(tap: Wiretap) -> None:
    hellos = [d for s, r, d in tap.heard if r == 1 and s == CLEO and isinstance(wire.decode(d, KEY), Hello)]
    assert tap.play(*hellos) == {"for another robot": len(hellos)}
    assert tap.unharmed()


@pytest.mark.parametrize("key", [None, bytes(32)])
def test_another_key_is_not_authentic(tap: Wiretap, key: bytes | None) -> None:
    payload = unseal(KEY, MEMORY, to_alice(tap)[-1])
    assert payload is not None
    assert tap.play(seal(key, MEMORY, payload)) == {"not authentic": 1}
    assert tap.play(seal(KEY, POSITION, payload)) == {"not authentic": 1}
    assert tap.unharmed()


def test_another_format_version_is_told_apart_from_damage(tap: Wiretap) -> None:
    payload = unseal(KEY, MEMORY, to_alice(tap)[-1])
    assert payload is not None
    assert tap.play(seal(KEY, MEMORY, bytes([WIRE_FORMAT + 1]) + payload[1:])) == {"another format version": 1}


def test_oversize_is_dropped_before_anything_else(tap: Wiretap) -> None:
    assert tap.play(bytes(LIMIT + 1), bytes(65_000)) == {"oversize": 2}
    assert tap.unharmed()


@given(data=st.data())
@hypothesis_settings(max_examples=1500, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_flipped_and_cut_datagrams_are_not_authentic(tap: Wiretap, data: st.DataObject) -> None:
    datagram = bytearray(data.draw(st.sampled_from(to_alice(tap)[-40:])))
    if data.draw(st.booleans()):
        bit = data.draw(st.integers(0, len(datagram) * 8 - 1))
        datagram[bit // 8] ^= 1 << bit % 8
    else:
        del datagram[data.draw(st.integers(0, len(datagram) - 1)) :]
    assert tap.play(bytes(datagram)) == {"not authentic": 1}
    assert tap.unharmed()


@given(st.lists(st.binary(max_size=LIMIT + 10), min_size=1, max_size=5))
@hypothesis_settings(max_examples=500, deadline=None)
def test_random_bytes_change_nothing(tap: Wiretap, datagrams: list[bytes]) -> None:
    assert sum(tap.play(*datagrams).values()) == len(datagrams)
    assert tap.unharmed()


_plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.binary(max_size=9) | st.text("ab"),
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=20,
)


@given(_plain | st.binary(max_size=200).map(msgspec.Raw), st.integers(0, 3))
@hypothesis_settings(max_examples=1500, deadline=None)
def test_well_sealed_nonsense_changes_nothing(tap: Wiretap, value: Any, tag: int) -> None:
    """From a robot that has the key: garbage, and a genuine head followed by garbage."""
    plain = tap.forged(lambda m: m)
    payload = unseal(KEY, MEMORY, plain)
    assert payload is not None
    head = msgspec.to_builtins(msgspec.msgpack.decode(payload[1:])[1])
    version = bytes([WIRE_FORMAT])
    for body in (value, [tag, head, value], [tag, head, 1, value, [0, 0, 0], []], [tag, head, 1, 1, [0] * 3, [value]]):
        tap.play(seal(KEY, MEMORY, version + wire.encoder.encode(body)))
    assert tap.unharmed()


def deeply_nested() -> bytes:
    return seal(KEY, MEMORY, bytes([WIRE_FORMAT]) + b"\x91" * 1100)


def test_deep_nesting_does_not_exhaust_the_stack(tap: Wiretap) -> None:
    assert tap.play(deeply_nested()) == {"malformed": 1}


def closing(author: int = CLEO, first: int = 21, round_: int = 21, writes: tuple[Write, ...] = ()) -> Closing:
    return Closing(author, 0, first, round_, writes=writes)


def write(index: int, value: Any) -> tuple[Write, ...]:
    return (Write(index, msgspec.Raw(msgspec.msgpack.encode(value))),)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (closing(author=3), "closing does not fit"),
        (closing(author=127), "closing does not fit"),
        (closing(first=0), "closing does not fit"),
        (closing(first=22), "closing does not fit"),
        (closing(round_=10_000), "closing too far ahead"),
        (closing(first=TOP, round_=TOP), "closing too far ahead"),
        (closing(author=0, first=21, round_=22), "closing of ours that we did not write"),
        (closing(first=20, writes=write(1, 5)), "closing does not fit"),
        (closing(writes=write(2, 5)), "closing does not fit"),
        (closing(writes=write(1, 5) + write(1, 6)), "closing does not fit"),
        (closing(writes=write(1, 5) + write(0, Point())), "closing does not fit"),
        (closing(writes=write(1, "5")), "closing does not fit"),
        (closing(writes=write(1, 5.5)), "closing does not fit"),
        (closing(writes=write(1, True)), "closing does not fit"),
        (closing(writes=write(1, 2**63)), "closing does not fit"),
        (closing(writes=write(0, [1.0, 2.0, 3.0, 4.0])), "closing does not fit"),
        (closing(writes=write(0, [1.0, None, 3.0])), "closing does not fit"),
        (closing(writes=write(0, [1.0, math.nan, 3.0])), "closing does not fit"),
        (closing(writes=write(0, [1.0, 2.0, math.inf])), "closing does not fit"),
    ],
)
def test_closings_that_do_not_fit_are_refused(bad: Closing, reason: str) -> None:
    tap = Wiretap()
    dropped = tap.play(tap.forged(lambda m: msgspec.structs.replace(m, closings=(bad,))))
    assert dropped == {reason: 1}
    after = snapshot(tap.victim)
    assert after[0] == tap.before[0] and after[4] == tap.before[4]


@pytest.mark.parametrize(
    "change",
    [
        lambda m: msgspec.structs.replace(m, held=(1, 1)),
        lambda m: msgspec.structs.replace(m, held=(1,) * 4),
        lambda m: msgspec.structs.replace(m, held=(1, TOP, 1)),
        lambda m: msgspec.structs.replace(m, settled=TOP),
        lambda m: msgspec.structs.replace(m, round=TOP),
        lambda m: Need(m.head, TOP, (0, 0, 0)),
    ],
)
def test_statements_that_cannot_be_are_refused(change: Callable[[Round], Message]) -> None:
    tap = Wiretap()
    sent = tap.fleet.network.sent
    assert tap.play(tap.forged(change)) == {"statement does not fit": 1}
    assert snapshot(tap.victim)[:5] == tap.before[:5]
    assert tap.fleet.network.sent == sent  # nor is it answered


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("application", 1, "another application"),
        ("interface", bytes(8), "another interface"),
        ("program", bytes(8), "another program"),
        ("pid", 0, "not a peer"),
        ("pid", 3, "not a peer"),
        ("boot", bytes(8), "another boot"),
        ("epoch", bytes(8), "another mission"),
        ("epoch", b"", "another mission"),
    ],
)
def test_foreign_heads_are_dropped(tap: Wiretap, field: str, value: Any, reason: str) -> None:
    def change(m: Round) -> Message:
        return msgspec.structs.replace(m, head=msgspec.structs.replace(m.head, **{field: value}))

    assert tap.play(tap.forged(change), tap.forged(change)) == {reason: 2}
    said = [line for line in tap.victim.lines if f"robot cleo runs {reason}" in line]
    assert len(said) == (1 if reason in ("another program", "another interface") else 0)


def test_a_closing_of_a_flood_is_kept_only_up_to_a_bound() -> None:
    tap = Wiretap()
    link = tap.victim.agent._link
    for sequence in range(3000):

        def change(m: Round, sequence: int = sequence) -> Message:
            head = msgspec.structs.replace(m.head, sequence=m.head.sequence + sequence)
            return msgspec.structs.replace(m, head=head, closings=(closing(first=22 + sequence % 7, round_=28),))

        tap.play(tap.forged(change))
    rounds = tap.victim.agent._rounds
    assert rounds is not None
    assert sum(len(log.later) + len(log.entries) for log in rounds._memory._logs) < 100
    assert len(link.rejected) < 20


@given(st.lists(st.integers(1, 3000), max_size=300))
def test_a_sequence_number_is_taken_once(sequences: list[int]) -> None:
    session = Session(b"")
    taken: set[int] = set()
    for sequence in sequences:
        fresh = session.fresh(sequence)
        assert not (fresh and sequence in taken)
        newest = max(taken, default=0)
        if sequence not in taken and sequence > newest - 1024 and sequence > 0:
            assert fresh
        if fresh:
            taken.add(sequence)
        assert session.seen < 1 << 1024


def test_a_recorded_hello_of_an_earlier_boot_never_passes_for_live() -> None:
    fleet = Fleet(n=3)
    recorded: list[tuple[int, bytes]] = []
    send = fleet.network.send

    def tapped(sender: int, receiver: int, datagram: bytes) -> None:
        if sender == 1:
            recorded.append((receiver, datagram))
        send(sender, receiver, datagram)

    fleet.network.send = tapped  # type: ignore[method-assign]
    fleet.boot(0)
    fleet.boot(1)
    fleet.run(1.0)
    old = fleet.robots[0].agent._link.sessions[1].boot
    del fleet.robots[1]
    old_hellos = list(recorded)
    fleet.boot(1)
    fleet.run(1.0)
    new = fleet.robots[1].agent._link.boot
    assert fleet.robots[0].agent._link.sessions[1].boot == new != old
    for receiver, datagram in old_hellos:
        if receiver in fleet.network._queues:
            send(1, receiver, datagram)
    fleet.run(0.01)
    assert fleet.robots[0].agent._link.sessions[1].boot == new
    fleet.boot(2)
    for _ in range(5):
        for receiver, datagram in old_hellos:
            send(1, receiver, datagram)
        fleet.run(0.3)
    fleet.run_rounds(3)
    assert all(r.records[-1].frame is not None for r in fleet.robots.values())


def test_a_robot_that_began_anew_during_the_mission_is_told_of_and_not_let_in() -> None:
    fleet = Fleet(n=3).boot_all()
    fleet.run_rounds(5)
    fleet.boot(1)
    fleet.run(2.0)
    assert fleet.robots[1].agent.phase == "joining"
    assert any("alice, cleo in a mission that began before this start" in line for line in fleet.robots[1].lines)
    told = [line for line in fleet.robots[0].lines if "bert began anew during the mission" in line]
    assert len(told) == 1
    assert fleet.robots[0].platform.held and fleet.robots[0].records[-1].skipped == "not current: lacks bert"


def test_a_robot_with_another_program_is_named() -> None:
    fleet = Fleet(n=3)
    fleet.boot(0)
    fleet.boot(2)
    fleet.boot(1, program=replace(PROGRAM, program_hash="ffffffffffffffff"))
    fleet.run(3.0)
    assert all(r.agent.round == 0 for r in fleet.robots.values())
    for pid in (0, 2):
        said = [line for line in fleet.robots[pid].lines if "robot bert runs another program" in line]
        assert len(said) == 1


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"key": bytes(32)}, "sealed with another key"),
        ({"key": None, "insecure": True}, "sealed with another key"),
        ({"application_id": 7}, "another application_id"),
        ({"program": replace(PROGRAM, program_hash="ffffffffffffffff")}, "another program"),
    ],
)
def test_the_waiting_say_why_a_robot_that_sends_is_not_heard(change: dict[str, Any], told: str) -> None:
    fleet = Fleet(n=2)
    fleet.boot(0)
    fleet.boot(1, **change)
    fleet.run(3.0)
    for robot in fleet.robots.values():
        said = [line for line in robot.lines if "not heard yet" in line]
        assert told in said[-1]
        assert len(said) <= 2, "once more at most, when the reason is known"


def test_silence_is_given_no_reason() -> None:
    fleet = Fleet(n=2)
    fleet.boot(0)
    fleet.run(3.0)
    assert [line.rpartition("waiting ")[2] for line in fleet.robots[0].lines if "waiting" in line] == [
        "for bert, not heard yet"
    ]
