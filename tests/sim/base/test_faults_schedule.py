"""What a scenario file may say, and what is told of one that says it wrong."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.net.network import Conditions
from koordgen.runtime.trace.schema import Wind
from targets.sim.base.fault_state import PositioningFault
from targets.sim.base.schedule import CONDITIONS, KINDS, Event, LinkConditions, Schedule, read

ROBOTS = ("ann", "bob", "cem")


def good(**data: Any) -> Schedule:
    schedule, mistakes = read(data, ROBOTS)
    assert mistakes == []
    return schedule


def test_an_empty_scenario_is_one() -> None:
    assert good() == Schedule() and not good().networked


def test_all_that_there_is() -> None:
    schedule = good(
        network={"loss": 0.1, "delay": 0.02, "jitter": 0.01, "duplication": 0.05, "reordering": 0.2},
        links=[{"from": "ann", "to": "bob", "loss": 1}],
        events=[
            {"at": 9, "wind": {"mean": [1, 0, 0], "gust": 0.5, "correlation": 2}},
            {"at": 1, "for": 2, "partition": [["ann", "bob"], ["cem"]]},
            {"at": 2, "crash": "ann"},
            {"at": 3, "restart": "ann"},
            {"at": 4, "for": 1, "freeze": "bob"},
            {"at": 5, "for": 3, "positioning": {"robot": "cem", "noise": 0.1, "bias": [0, 1, 0], "dropout": 0.5}},
            {"at": 6, "battery": {"robot": "ann", "level": 0.1}},
            {"at": 7, "lag": {"robot": "ann", "seconds": 0.2}},
        ],
    )
    assert schedule.networked and schedule.network == Conditions(0.1, 0.02, 0.01, 0.05, 0.2)
    assert schedule.links == (LinkConditions("ann", "bob", {"loss": 1.0}),)
    assert schedule.links[0].over(schedule.network) == Conditions(1.0, 0.02, 0.01, 0.05, 0.2)
    assert [event.at for event in schedule.events] == [1, 2, 3, 4, 5, 6, 7, 9]
    assert schedule.events[0] == Event("partition", 1.0, 2.0, ROBOTS, (("ann", "bob"), ("cem",)))
    assert schedule.events[4].positioning == PositioningFault(0.1, (0.0, 1.0, 0.0), 0.0, 0.5)
    assert schedule.events[7].wind == Wind((1.0, 0.0, 0.0), 0.5, 2.0)


def test_what_lasts_until_an_event_ends_it() -> None:
    schedule = good(
        events=[
            {"at": 1, "cut": ["bob", "ann"]},
            {"at": 1, "cut": ["bob", "cem"], "for": 2},
            {"at": 1, "freeze": "ann"},
            {"at": 2, "restore": ["ann", "bob"]},
            {"at": 2, "continue": "ann"},
            {"at": 3, "cut": ["ann", "bob"]},
            {"at": 3, "freeze": "ann"},
            {"at": 4, "network": {"loss": 0.5}},
            {"at": 5, "obstacle": {"number": 2, "by": [1, 0, -0.5]}},
        ]
    )
    assert schedule.networked and schedule.events[0].robots == ("bob", "ann")
    assert schedule.events[7].network == Conditions(loss=0.5)
    assert (schedule.events[8].number, schedule.events[8].by) == (2, (1.0, 0.0, -0.5))


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        ({"cut": ["ann", "bob"]}, {"cut": ["bob", "ann"]}, "a restore ends a cut"),
        ({"freeze": "ann"}, {"freeze": "ann", "for": 1}, "a continue ends a freeze"),
        ({"crash": "ann"}, {"crash": "ann"}, "a restart ends a crash"),
    ],
)
def test_what_lasts_does_not_begin_again(first: Any, second: Any, said: str) -> None:
    _, (mistake,) = read({"events": [{"at": 1, **first}, {"at": 2, **second}]}, ROBOTS)
    assert mistake.code == "F006" and mistake.hint == said


def test_a_partition_alone_concerns_the_network() -> None:
    assert good(events=[{"at": 0, "for": 1, "partition": [["ann"]]}]).networked
    assert not good(events=[{"at": 0, "crash": "ann"}]).networked


@pytest.mark.parametrize(
    ("data", "code", "path", "said"),
    [
        ([], "F004", (), "the scenario must be a mapping"),
        ({"netwrok": {}}, "F002", ("netwrok",), "did you mean 'network'"),
        ({"network": {"loss": 1.5}}, "F005", ("network", "loss"), "network.loss (a part of 1) is 1.5; it must be 0 to"),
        ({"network": {"delay": "20ms"}}, "F004", ("network", "delay"), "must be a finite number, not '20ms'"),
        ({"network": {"loss": True}}, "F004", ("network", "loss"), "must be a finite number"),
        ({"network": {"lost": 0.1}}, "F002", ("network", "lost"), "did you mean 'loss'"),
        ({"links": {}}, "F004", ("links",), "links must be a list"),
        ({"links": [{"from": "ann"}]}, "F003", ("links", 0), "link 0 lacks 'to'"),
        ({"links": [{"from": "ann", "to": "bbo"}]}, "F005", ("links", 0, "to"), "did you mean 'bob'"),
        ({"links": [{"from": "ann", "to": "ann"}]}, "F005", ("links", 0, "to"), "from ann to itself"),
        ({"links": [{"from": "ann", "to": "bob"}] * 2}, "F006", ("links", 1), "as link 0"),
        ({"events": [7]}, "F004", ("events", 0), "event 0 must be a mapping"),
        ({"events": [{"at": 1}]}, "F005", ("events", 0), "event 0 says nothing that happens"),
        ({"events": [{"crash": "ann"}]}, "F003", ("events", 0), "event 0 lacks 'at'"),
        ({"events": [{"at": -1, "crash": "ann"}]}, "F005", ("events", 0, "at"), "is -1; it must be 0 to"),
        ({"events": [{"at": 1, "crash": "zoe"}]}, "F005", ("events", 0, "crash"), "there are: ann, bob, cem"),
        ({"events": [{"at": 1, "crash": ["ann"]}]}, "F005", ("events", 0, "crash"), "no robot ['ann']"),
        ({"events": [{"at": 1, "crush": "ann"}]}, "F002", ("events", 0, "crush"), "did you mean 'crash'"),
        ({"events": [{"at": 1, "crash": "ann", "freeze": "bob"}]}, "F005", ("events", 0), "crash and freeze at once"),
        ({"events": [{"at": 1, "partition": [["ann"]]}]}, "F003", ("events", 0), "how many seconds the partition"),
        ({"events": [{"at": 1, "cut": ["ann"]}]}, "F004", ("events", 0, "cut"), "two robots, such as [ann, bob]"),
        ({"events": [{"at": 1, "cut": ["ann", "ann"]}]}, "F005", ("events", 0, "cut"), "names ann twice"),
        ({"events": [{"at": 1, "restore": ["ann", "zoe"]}]}, "F005", ("events", 0, "restore", 1), "no robot 'zoe'"),
        ({"events": [{"at": 1, "for": 1, "continue": "ann"}]}, "F005", ("events", 0, "for"), "continue takes no time"),
        ({"events": [{"at": 1, "network": {"loss": 2}}]}, "F005", ("events", 0, "network", "loss"), "is 2"),
        ({"events": [{"at": 1, "obstacle": {"number": -1, "by": [1, 0, 0]}}]}, "F005",
         ("events", 0, "obstacle", "number"), "from 0, not -1"),
        ({"events": [{"at": 1, "obstacle": {"number": 1}}]}, "F003", ("events", 0, "obstacle"), "lacks 'by'"),
        ({"events": [{"at": 1, "for": 0, "freeze": "ann"}]}, "F005", ("events", 0, "for"), "event 0.for"),
        ({"events": [{"at": 1, "for": 1, "restart": "ann"}]}, "F005", ("events", 0, "for"), "a restart takes no time"),
        ({"events": [{"at": 1, "for": 1, "partition": [["ann", "bob", "cem"]]}]}, "F005", ("events", 0, "partition"),
         "parts nobody"),
        ({"events": [{"at": 1, "for": 1, "partition": [["ann"], ["ann", "cem"]]}]}, "F006",
         ("events", 0, "partition", 1, 0), "ann is in two groups"),
        ({"events": [{"at": 1, "for": 1, "partition": ["ann"]}]}, "F004", ("events", 0, "partition", 0), "a list"),
        ({"events": [{"at": 1, "positioning": {"robot": "ann"}}]}, "F003", ("events", 0, "positioning"), "one of"),
        ({"events": [{"at": 1, "positioning": {"noise": 1}}]}, "F003", ("events", 0, "positioning"), "lacks 'robot'"),
        ({"events": [{"at": 1, "positioning": {"robot": "ann", "bias": 1}}]}, "F004",
         ("events", 0, "positioning", "bias"), "[x, y, z]"),
        ({"events": [{"at": 1, "positioning": {"robot": "ann", "dropout": 2}}]}, "F005",
         ("events", 0, "positioning", "dropout"), "dropout is 2"),
        ({"events": [{"at": 1, "battery": {"robot": "ann"}}]}, "F003", ("events", 0, "battery"), "lacks 'level'"),
        ({"events": [{"at": 1, "lag": {"robot": "ann", "seconds": 9}}]}, "F005", ("events", 0, "lag", "seconds"), "9"),
        ({"events": [{"at": 1, "wind": {"mean": [1, 2]}}]}, "F004", ("events", 0, "wind", "mean"), "[x, y, z]"),
    ],
)  # fmt: skip
def test_a_mistake_is_told_once_at_its_place(data: Any, code: str, path: tuple[str | int, ...], said: str) -> None:
    _, (mistake,) = read(data, ROBOTS)
    assert (mistake.code, mistake.path) == (code, path)
    assert said in f"{mistake.message} | {mistake.hint}"


PART = [["ann"], ["bob", "cem"]]


@pytest.mark.parametrize(
    ("events", "said"),
    [
        ([{"at": 1, "for": 2, "partition": PART}, {"at": 2.5, "for": 1, "partition": PART}],
         "event 1, partition at 2.5 s, begins while event 0 (1 s to 3 s) lasts"),
        ([{"at": 2.5, "for": 1, "partition": PART}, {"at": 1, "for": 2, "partition": PART}], "event 0, part"),
        ([{"at": 1, "for": 2, "partition": PART}, {"at": 3, "for": 1, "partition": PART}], ""),
        ([{"at": 1, "crash": "ann"}, {"at": 5, "crash": "ann"}], "event 0 (1 s for good)"),
        ([{"at": 1, "crash": "ann"}, {"at": 3, "restart": "ann"}, {"at": 5, "crash": "ann"}], ""),
        ([{"at": 1, "for": 2, "crash": "ann"}, {"at": 5, "crash": "ann"}], ""),
        ([{"at": 1, "crash": "ann"}, {"at": 5, "crash": "bob"}], ""),
        ([{"at": 1, "for": 5, "freeze": "ann"}, {"at": 5, "for": 1, "freeze": "ann"}], "freeze of ann"),
        ([{"at": 1, "wind": {"gust": 1}}, {"at": 5, "wind": {"gust": 2}}], ""),
        ([{"at": 1, "for": 9, "wind": {"gust": 1}}, {"at": 5, "wind": {"gust": 2}}], "event 1, wind at 5 s"),
        ([{"at": 1, "battery": {"robot": "ann", "level": 1}}, {"at": 5, "battery": {"robot": "ann", "level": 0}}], ""),
    ],
)  # fmt: skip
def test_faults_that_overlap(events: list[dict[str, Any]], said: str) -> None:
    _, mistakes = read({"events": events}, ROBOTS)
    assert [m.code for m in mistakes] == ["F006"] * bool(said)
    assert not said or said in mistakes[0].message


PLAIN = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.just(10**400), st.floats(), st.sampled_from([*ROBOTS, "x"])),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["robot", "level", *CONDITIONS]), inner)
    ),
    max_leaves=8,
)
PARTS = st.dictionaries(st.sampled_from(["at", "for", *KINDS, 3]), PLAIN, max_size=4)


@given(st.fixed_dictionaries({}, optional={"network": PLAIN, "links": PLAIN, "events": st.lists(PARTS, max_size=3)}))
def test_strange_data_are_mistakes_not_crashes(data: Any) -> None:
    schedule, mistakes = read(data, ROBOTS)
    assert mistakes or len(schedule.events) == len(data.get("events", []))
    for mistake in mistakes:
        assert mistake.message and mistake.code in ("F002", "F003", "F004", "F005", "F006")
