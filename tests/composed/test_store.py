"""Store of several applications: who may write what, entries with parts, and rounds of instances."""

from __future__ import annotations

from random import Random
from typing import Any

import msgspec
import pytest

from koordgen.runtime.net.codec import encoder
from koordgen.runtime.net.layout import MOST_SHARED, Layout, TooLarge
from koordgen.runtime.net.wire import Entry, EntryPart, Snapshot, View, Write
from koordgen.runtime.program.fleet_program import FleetApplication, FleetProgram, ImportBinding, StoreAccess
from koordgen.runtime.program.program import Program, Transaction, Variable
from koordgen.runtime.replication.state_machine import InstanceEvent, StateMachine
from koordgen.runtime.values.bounds import Fixed, Text
from tests.runtime.replication.states import append, contents, view, write


def program(name: str, *shared: Variable, locks: tuple[tuple[str, ...], ...] = ()) -> Program:
    return Program(
        name, f"{name}.koord", "00" * 8, "00" * 8, (), shared, (), None, (), Transaction, "", {}, locks
    )  # fmt: skip


def number(name: str, kind: Any = "allwrite") -> Variable:
    return Variable(name, kind, int, Fixed(9), lambda: 0)


# Mapping runs on robots 0 and 2, Task on robots 1 and 2. Instances: 0 and 1 of Mapping, 2 and 3 of Task.
# Indices: 0 done, 1 secret, 2 place (of Mapping), 3 goal, 4 seen (of Task). Locks: 0 of done, 1 of secret, 2 of goal.
MAPPING = program(
    "mapping", number("done"), number("secret"), number("place", "allread"), locks=(("done",), ("secret",))
)
TASK = program(
    "task", number("goal"), number("seen", "allread"), number("done"), number("place"), locks=(("goal",), ("done",))
)
FLEET = FleetProgram(
    (
        FleetApplication("mapping", MAPPING, (0, 2), locks=(0, 1)),
        FleetApplication("task", TASK, (1, 2), (ImportBinding("Mapping", 0, ("done", "place"), ("done",)),), (2, 0)),
    ),
    3,
    "00" * 8,
    "00" * 8,
)
LAYOUT = Layout.of(FLEET)


def part(*writes: Write, acted: bool = True, stopped: bool = False, lock: int = -1) -> EntryPart:
    return EntryPart(stopped, acted, lock, writes)


def entry(author: int, round_: int, writes: Any = (), **more: Any) -> Entry:
    return Entry(author, 0, round_, round_, **{"acted": True, **more}, writes=writes)


def received(made: Entry) -> Entry:
    return msgspec.msgpack.decode(encoder.encode(made), type=Entry)


def test_names_and_slots_are_those_of_the_applications() -> None:
    assert LAYOUT.names == ("mapping.done", "mapping.secret", "mapping.place", "task.goal", "task.seen")
    assert LAYOUT.initial()["mapping.place"] == (0, 0) and LAYOUT.instances == 4
    assert FLEET.stored(1, "done") == "mapping.done" and FLEET.constants(FLEET.instances[2]) == {"Mapping.pid": -1}
    assert FLEET.constants(FLEET.instances[3]) == {"Mapping.pid": 1}
    alone = FleetProgram.alone(MAPPING, 3)
    assert Layout.of(alone).names == ("done", "secret", "place") and alone.of(2) is MAPPING


@pytest.mark.parametrize(
    ("made", "data"),
    [
        (Entry(2, 0, 0, 0), "9902000000c2c2c2ff90"),
        (
            Entry(1, 3, 4, 4, False, True, True, -1, (write(0, 7), Write(1, msgspec.Raw(b"\xa2ab"), True))),
            "9901030404c2c3c3ff92930007c29301a26162c3",
        ),
        (Entry(0, 0, 5, 5, True, True, False, 2, (write(255, None),)), "9900000505c3c3c2029193ccffc0c2"),
        (Entry(127, 9, 1, 2**40, True), "997f0901cf0000010000000000c3c2c2ff90"),
        (
            Snapshot(View(1, 2, (0, 1, -1)), 9, (write(0, [1, 2, 3]).value, write(0, 4).value), (-1, 7, -1), (9, 7, 0)),
            "95930102930001ff0992930102030493ff07ff93090700",
        ),
    ],
)
def test_bytes_of_fleets_with_one_application_never_change(made: Entry | Snapshot, data: str) -> None:
    assert encoder.encode(made).hex() == data
    if isinstance(made, Entry):
        assert encoder.encode(received(made)).hex() == data


GOOD = (
    entry(0, 4, (write(0, 5), write(2, 6))),  # own variable and own slot
    entry(1, 4, (write(0, 5), write(3, 1), write(4, 2)), lock=0),  # an imported variable with `write`
    entry(2, 4, {0: part(write(1, 5), lock=1), 1: part(write(0, 1), lock=2)}),
    entry(2, 4, {1: part(write(4, 5))}),
    entry(0, 4),
    entry(2, 4, acted=False),
)
BAD = (
    entry(0, 4, (write(3, 5),)),  # robot 0 does not run Task
    entry(0, 4, (write(4, 5),)),  # a slot of Task
    entry(1, 4, (write(2, 5),)),  # imported slots are never written
    entry(1, 4, (write(1, 5),)),  # not imported
    entry(0, 4, {0: part(write(0, 5))}),  # parts of a robot with one instance
    entry(1, 4, {0: part(write(0, 5))}),
    entry(2, 4, (write(0, 5),)),  # no parts of a robot with two instances
    entry(2, 4),
    entry(2, 4, {0: part(write(3, 5)), 1: part()}),  # Mapping does not import `goal`
    entry(2, 4, {1: part(write(2, 5))}),
    entry(2, 4, {2: part()}),  # there is no third application
    entry(2, 4, {0: part(lock=2)}),  # a lock of Task alone
    entry(2, 4, {0: part(lock=3)}),  # there is no such lock
    entry(2, 4, {0: part()}, lock=0),
    entry(2, 4, {0: part()}, acted=False),
    entry(2, 4, {0: part(acted=False)}),
    entry(2, 4, {0: part(write(0, 1), write(0, 2))}),
    entry(1, 4, (), lock=1),
    entry(1, 4, (), lock=3),
    Entry(2, 0, 3, 4, acted=True, writes={0: part()}),  # an event covers one round
    entry(3, 4),
)


@pytest.mark.parametrize("made", GOOD)
def test_an_instance_may_write_what_its_application_declares_or_imports_with_write(made: Entry) -> None:
    assert LAYOUT.read(received(made)) is not None


@pytest.mark.parametrize("made", BAD)
def test_an_entry_with_other_writes_is_refused_and_changes_nothing(made: Entry) -> None:
    assert LAYOUT.read(received(made)) is None
    if made.author < 3:
        (state,) = fleet()[(made.author + 1) % 3 : (made.author + 1) % 3 + 1]
        before = contents(state)
        assert append(state, received(made), round_=4) == ["entry does not fit"] and contents(state) == before


def test_a_lock_that_the_only_application_lacks_is_refused() -> None:
    layout = Layout.of(FleetProgram.alone(MAPPING, 3))
    assert layout.read(entry(1, 4, lock=1)) is not None and layout.read(entry(1, 4, lock=2)) is None


def fleet(inits: tuple[Entry, ...] = ()) -> list[StateMachine]:
    inits = inits or tuple([Entry(pid, 0, 0, 0) for pid in range(3)])
    return [StateMachine.begin(LAYOUT, pid, view(), inits) for pid in range(3)]


def run(states: list[StateMachine], entries: list[Entry], round_: int) -> list[Entry]:
    """Hand the entries of a round to all robots, which apply them. Return them as they were sent."""
    sent = [received(e) for e in entries]
    for pid, state in enumerate(states):
        assert append(state, *[e for e in sent if e.author != pid], round_=round_) == [None, None]
        assert state.apply_rounds() and state.applied == round_
    assert contents(states[0]) == contents(states[1]) == contents(states[2])
    return sent


def test_events_of_all_instances_apply_by_locks_and_then_by_instance() -> None:
    states = fleet()
    parts = [InstanceEvent(0, {"done": 7, "place": 8}, False, 0), InstanceEvent(1, {"seen": 4}, True, -1)]
    entries = [
        states[0].close(1, {"done": 1, "place": 5}, stopped=False, acted=True),
        states[1].close(1, {"done": 2, "goal": 3}, stopped=False, acted=True),
        states[2].close(1, {}, stopped=False, parts=parts),
    ]
    run(states, entries, 1)
    expected = {"mapping.done": 2, "mapping.secret": 0, "mapping.place": (5, 8), "task.goal": 3, "task.seen": (0, 4)}
    assert states[0].shared == expected, "the plain write of the highest instance counts, a transaction comes first"
    assert states[2].won == {1: 1} and states[0].won == {} and states[0].acted == [1, 1, 1, 1]
    assert states[0].stopped == {3: 1}
    entries = [
        states[0].close(2, {"done": 10}, stopped=False, acted=True, lock=0),
        states[1].close(2, {"done": 20}, stopped=False, acted=True, lock=0),
        states[2].close(2, {}, stopped=False, parts=[InstanceEvent(0, {"done": 30}, True, 0)]),
    ]
    run(states, entries, 2)
    assert states[0].shared["mapping.done"] == 20, "instance 2: (2 - 2 - 0) mod 4 is the least"
    assert states[0].acted == [1, 1, 2, 1] and states[0].stopped == {3: 1}, "a lost transaction stops nobody"


def test_a_robot_has_stopped_when_all_its_instances_have() -> None:
    states = fleet()
    entries = [state.close(1, {}, stopped=pid < 2) for pid, state in enumerate(states[:2])]
    entries.append(states[2].close(1, {}, stopped=False, parts=[InstanceEvent(0, {}, True, -1)]))
    run(states, entries, 1)
    assert states[0].stopped == {0: 1, 1: 1, 2: 1} and states[0].all_stopped is None
    entries = [state.close(2, {}, stopped=True) for state in states]
    run(states, entries, 2)
    assert states[0].stopped == {0: 1, 1: 1, 2: 1, 3: 2} and states[0].all_stopped == 2


def test_inits_of_all_instances_begin_the_store() -> None:
    inits = (
        Entry(0, 0, 0, 0, writes=(write(2, 1),)),
        Entry(1, 0, 0, 0, writes=(write(0, 3),)),
        Entry(2, 0, 0, 0, writes={0: part(write(0, 4), write(2, 2), acted=False), 1: part(write(4, 9), acted=False)}),
    )
    (state, *_) = fleet(inits)
    assert state.shared["mapping.done"] == 3 and state.shared["mapping.place"] == (1, 2)
    assert state.shared["task.seen"] == (0, 9) and state.acted == [0, 0, 0, 0]


def test_a_snapshot_has_all_instances() -> None:
    states = fleet()
    entries = [state.close(1, {}, stopped=False, acted=True) for state in states[:2]]
    entries.append(states[2].close(1, {}, stopped=False, parts=[InstanceEvent(1, {"seen": 4}, True, -1)]))
    run(states, entries, 1)
    blob = encoder.encode(states[0].snapshot())
    assert len(blob) <= LAYOUT.snapshot_bytes
    found = StateMachine.from_snapshot(LAYOUT, 2, msgspec.msgpack.decode(blob, type=Snapshot))
    assert found is not None and contents(found) == contents(states[0])
    other = Layout.of(FleetProgram.alone(MAPPING, 3))
    assert StateMachine.from_snapshot(other, 2, states[0].snapshot()) is None


def test_no_entry_is_longer_than_the_layout_says() -> None:
    top, low = 2**53, -(2**63)
    parts = {
        0: part(write(0, low), write(1, low), write(2, low), stopped=True, lock=65535),
        1: part(write(0, low), write(3, low), write(4, low), stopped=True, lock=65535),
    }
    longest = len(encoder.encode(Entry(127, top, top, top, True, True, True, -1, parts)))
    assert longest <= LAYOUT.entry_bytes <= longest + 30


def test_the_limits_count_all_applications() -> None:
    def system(count: int, length: int) -> FleetProgram:
        texts = [Variable(f"x{k}", "allwrite", str, Text(length), str) for k in range(count)]
        applications = [FleetApplication(name, program(name, *texts), (0, 1, 2)) for name in ("a", "b")]
        return FleetProgram(tuple(applications), 3, "", "")

    Layout.of(system(6, 10_000))
    with pytest.raises(TooLarge, match="take up to 140"):
        Layout.of(system(7, 10_000))
    with pytest.raises(TooLarge, match=f"applications with {MOST_SHARED + 2} shared variables"):
        Layout.of(system(MOST_SHARED // 2 + 1, 1))
    with pytest.raises(TooLarge, match="run 1100 times"):
        Layout((), 100, [StoreAccess(tuple(range(100)), 0, {}) for _ in range(11)])


@pytest.mark.parametrize("seed", range(8))
def test_a_damaged_entry_is_refused_or_writes_only_what_its_author_may(seed: int) -> None:
    rng = Random(seed)
    allowed = [{0, 1, 2}, {0, 3, 4}, {0, 1, 2, 3, 4}]
    for _ in range(400):
        data = bytearray(encoder.encode(rng.choice(GOOD)))
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        try:
            made = msgspec.msgpack.decode(bytes(data), type=Entry)
        except (ValueError, RecursionError):
            continue
        for event in LAYOUT.read(made) or ():
            assert event.instance in [instance.number for instance in FLEET.of_robot(made.author)]
            written = {index for index, _ in event.values}
            assert written <= allowed[made.author] and written <= ({0, 1, 2} if event.instance < 2 else {0, 3, 4})
