"""Fleet file: one run reports all errors, each once and at its place."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args, get_type_hints

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.fleet import file as fleet
from koordgen.fleet import manifest, medium
from koordgen.fleet.address import control_port
from koordgen.fleet.settings import ValueCheck
from koordgen.lang.source import Source, Span
from koordgen.runtime.config.settings import Network, Safety, Settings

EXAMPLE = Path(__file__).parents[2] / "examples/lineform/fleet.yaml"
TARGETS = {name: manifest.load(name) for name in manifest.available()}

PARAMS: dict[str, ValueCheck] = {
    "margin": lambda v: "" if type(v) in (int, float) else f"param margin is of type float; {v!r} does not fit",
    "laps": lambda v: "" if type(v) is int else f"param laps is of type int; {v!r} does not fit",
    "home": lambda v: "" if type(v) is list and len(v) == 3 else f"param home is of type Point; {v!r} does not fit",
}


def read(text: str) -> tuple[fleet.Fleet | None, list[tuple[str, int, int, str]]]:
    found: list[tuple[str, int, int, str]] = []

    def report(code: str, message: str, span: Span, help: str) -> None:
        found.append((code, span.line, span.column, f"{message} | {help}"))

    return fleet.read(Source("fleet.yaml", text), TARGETS, PARAMS, report), found


def test_the_example_is_right() -> None:
    read_fleet, found = read(EXAMPLE.read_text())
    assert found == []
    assert read_fleet is not None
    assert [(r.name, r.target, r.pid) for r in read_fleet.robots] == [
        ("alice", "quad", 0), ("bert", "car", 1), ("cleo", "quad", 2), ("dora", "car", 3), ("emil", "quad", 4),
    ]  # fmt: skip
    assert read_fleet.robots[0].settings["flight_height"] == 1.5
    assert read_fleet.robots[1].settings["wheelbase"] == TARGETS["car"].settings["wheelbase"].default
    assert read_fleet.harness["sim"]["min_separation"] == 0.3


def test_safety_defaults_are_the_runtimes() -> None:
    assert {f: getattr(Safety(), f) for f in Safety.__struct_fields__} == fleet.SAFETY


def test_safety_actions_are_the_runtimes() -> None:
    assert get_args(get_type_hints(Safety)["missed_action"]) == fleet.MISSED_ACTIONS


@pytest.mark.parametrize(
    ("text", "safety"),
    [
        ("", Safety()),
        ("safety: {}", Safety()),
        (
            "safety: {missed_rounds: 9, missed_action: stop, peer_timeout: 3}",
            Safety(missed_rounds=9, missed_action="stop", peer_timeout=3),
        ),
        ("safety: {position_stale: 1, position_lost: 3}", Safety(position_stale=1.0, position_lost=3.0)),
    ],
)
def test_safety_is_what_robots_read(text: str, safety: Safety) -> None:
    read_fleet, found = read(f"{text}\n{GOOD}")
    assert found == [] and read_fleet is not None
    assert msgspec.convert(read_fleet.safety, Safety) == safety


def test_network_keys_are_the_runtimes() -> None:
    known = {"transport"}.union(*medium.NETWORK.values())
    assert known == set(Network.__struct_fields__)
    hints = get_type_hints(Network)
    assert tuple(medium.NETWORK) == get_args(hints["transport"])
    assert get_args(hints["mode"]) == medium.ZENOH_MODES


GOOD = """\
delta: 0.1
origin: {latitude: 47.0, longitude: 8.0, altitude: 400.0}
geofence: {lo: [-5, -5, -1], hi: [5, 5, 4]}
robots:
  - name: alice
    target: quad
    address: 127.0.0.1:47100
  - name: bert
    target: car
    address: 127.0.0.1:47101
"""


LAUGHS = "a: &a [1, 2, 3, 4, 5, 6, 7, 8, 9, 0]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("change", "code", "line", "column", "words"),
    [
        (("delta: 0.1", "dleta: 0.1"), "F002", 1, 1, "did you mean 'delta'"),
        (("delta: 0.1", "delta: fast"), "F004", 1, 8, "delta must be a finite number, not 'fast'"),
        (("delta: 0.1", "delta: .nan"), "F004", 1, 8, "finite"),
        (("delta: 0.1", "delta: 0"), "F005", 1, 8, "0.005 to 60"),
        (("latitude: 47.0", "latitude: 147.0"), "F005", 2, 20, "-90 to 90"),
        ((", altitude: 400.0", ""), "F003", 2, 9, "origin lacks 'altitude'"),
        (("hi: [5, 5, 4]", "hi: [5, -5, 4]"), "F005", 3, 34, "below geofence.hi"),
        (("hi: [5, 5, 4]", "hi: [5, 5]"), "F004", 3, 34, "[x, y, z]"),
        (("name: bert", "name: alice"), "F006", 8, 11, "already robot 0's"),
        (("47101", "47100"), "F006", 10, 14, "already robot 0's"),
        (("name: bert", "name: Bert!"), "F005", 8, 11, "cannot be a robot's name"),
        (("name: bert", "name: fleet"), "F005", 8, 11, "cannot be a robot's name"),
        (("name: bert", "name: ../x"), "F005", 8, 11, "cannot be a robot's name"),
        (("target: car", "target: boat"), "F007", 9, 13, "possible targets: car, quad"),
        (("target: car", "target: sim"), "F007", 9, 13, "possible targets: car, quad"),
        (("127.0.0.1:47101", "127.0.0.1"), "F005", 10, 14, "not HOST:PORT"),
        (("127.0.0.1:47101", "127.0.0.1:99999"), "F005", 10, 14, "not HOST:PORT"),
        (("127.0.0.1:47101", "0.0.0.0:47101"), "F005", 10, 14, "at which the other robots reach"),
        (("127.0.0.1:47101", "'[::]:47101'"), "F005", 10, 14, "at which the other robots reach"),
        (("47101\n", "47101\n    settings: {wheelbse: 0.3}\n"), "F002", 11, 16, "did you mean 'wheelbase'"),
        (("47101\n", "47101\n    settings: {wheelbase: 99}\n"), "F005", 11, 27, "0.05 to 5"),
        (("delta: 0.1", "delta: 0.1\ndelta: 0.2"), "F006", 2, 1, "appears twice"),
        (("delta: 0.1", "key: ../fleet.key\ndelta: 0.1"), "F005", 1, 6, "without folders"),
        (("delta: 0.1", "key: my.key\ninsecure: true\ndelta: 0.1"), "F005", 1, 6, "not both"),
        (("delta: 0.1", "delta: [0.1"), "F001", 1, 8, "this '[' is not closed"),
        (("delta: 0.1", "delta: " + "[" * 50_000), "F001", 1, 107, "more than 100 deep"),
        (("delta: 0.1", "delta: " + "[" * 50_000 + "]" * 50_000), "F001", 1, 107, "more than 100 deep"),
        (("delta: 0.1", "delta: " + "{a: " * 50_000), "F001", 1, 404, "more than 100 deep"),
        (("delta: 0.1", "\n".join(f"{'  ' * i}a:" for i in range(3000)) + " 1"), "F001", 101, 201, "100 deep"),
        (("delta: 0.1", LAUGHS + "delta: 0.1"), "F001", 6, 12, "more than 200,000 values"),
        (("delta: 0.1", "delta: &a [*a]"), "F001", 1, 12, "the alias *a is a part of its own value"),
        (("delta: 0.1", "delta: &a [{x: [1, *a]}]"), "F001", 1, 20, "the alias *a is a part of its own value"),
        (("delta: 0.1", "delta: *a"), "F001", 1, 8, "undefined alias"),
        (("delta: 0.1", "delta: 1:30"), "F004", 1, 8, "finite number, not '1:30'"),
        (("delta: 0.1", "delta: " + "1:" * 50_000 + "1"), "F004", 1, 8, "not '1:1:1"),
        (("delta: 0.1", "delta: 0x" + "f" * 100_000), "F004", 1, 8, "not '0xfff"),
        (("delta: 0.1", "application_id: " + "9" * 31 + "\ndelta: 0.1"), "F005", 1, 17, "0 to 65535"),
        (("delta: 0.1", "application_id: " + "9" * 5000 + "\ndelta: 0.1"), "F004", 1, 17, "a whole number, not '999"),
        (("delta: 0.1", "sim: {boot: later}\ndelta: 0.1"), "F004", 1, 13, "boot must be"),
        (("delta: 0.1", "params: {margn: 1}\ndelta: 0.1"), "F002", 1, 10, "did you mean 'margin'"),
        (("delta: 0.1", "params: {laps: 1.5}\ndelta: 0.1"), "F004", 1, 16, "laps is of type int"),
        (("delta: 0.1", "params: {home: [1, 2]}\ndelta: 0.1"), "F004", 1, 16, "home is of type Point"),
        (("delta: 0.1", "safety: {missed_rounds: 2.5}\ndelta: 0.1"), "F004", 1, 25, "whole number"),
        (("delta: 0.1", "safety: {missed_rounds: 0}\ndelta: 0.1"), "F005", 1, 25, "missed_rounds (rounds) is 0; it"),
        (("delta: 0.1", "safety: {missed_action: rest}\ndelta: 0.1"), "F005", 1, 25, "'rest' is called 'stop' now"),
        (("delta: 0.1", "safety: {missed_action: land}\ndelta: 0.1"), "F005", 1, 25, "possible values: hold, stop"),
        (("delta: 0.1", "safety: {missed_action: 1}\ndelta: 0.1"), "F004", 1, 25, "must be a text"),
        (("delta: 0.1", "safety: {missed_action: stop}\ndelta: 0.1"), "F005", 1, 25, "`missed_rounds: 16` or more"),
        (("delta: 0.1", "safety: {missed_action: stop, missed_rounds: 15}\ndelta: 0.1"), "F005", 1, 25, "+ 5 = 15 rou"),
        (("delta: 0.1", "safety: {missed_action: stop, missed_rounds: 0}\ndelta: 0.1"), "F005", 1, 46, "it must be 1 "),
        (("delta: 0.1", "safety: {peer_timeout: 2}\ndelta: 0.1"), "F005", 1, 24, "it must be 3 to 10000"),
        (("delta: 0.1", "safety: {peer_timeout: 0.5}\ndelta: 0.1"), "F004", 1, 24, "whole number"),
        (("delta: 0.1", "safety: {peer_timout: 5}\ndelta: 0.1"), "F002", 1, 10, "did you mean 'peer_timeout'"),
        (("delta: 0.1", "safety: {position_lost: 0}\ndelta: 0.1"), "F005", 1, 25, "position_lost (seconds) is 0; it"),
        (("delta: 0.1", "link: {rat: 6e6}\ndelta: 0.1"), "F002", 1, 8, "did you mean 'rate'"),
        (("delta: 0.1", "link: {rate: fast}\ndelta: 0.1"), "F004", 1, 14, "link.rate (bits a second) must be"),
        (("delta: 0.1", "link: {rate: '6e6'}\ndelta: 0.1"), "F004", 1, 14, "link.rate (bits a second) must be"),
        (("delta: 0.1", "link: {rate: 6e99}\ndelta: 0.1"), "F005", 1, 14, "1000 to 1e+12"),
        (("delta: 0.1", "link: {rate: 6e999}\ndelta: 0.1"), "F004", 1, 14, "finite"),
        (("delta: 0.1", "link: {loss: 1.0}\ndelta: 0.1"), "F005", 1, 14, "0 to 0.9"),
        (("delta: 0.1", "link: {mtu: 100}\ndelta: 0.1"), "F005", 1, 13, "576 to 65535"),
        (("delta: 0.1", "link:\ndelta: 0.1"), "F004", 1, 6, "must be a mapping"),
        (("delta: 0.1", "network: {transprot: zenoh}\ndelta: 0.1"), "F002", 1, 11, "did you mean 'transport'"),
        (("delta: 0.1", "network: {transport: tcp, group: 1}\ndelta: 0.1"), "F005", 1, 22, "possible values: unicast"),
        (("delta: 0.1", "network: {transport: 7}\ndelta: 0.1"), "F004", 1, 22, "network.transport must be a"),
        (("delta: 0.1", "network: {group: 239.255.71.1}\ndelta: 0.1"), "F005", 1, 18, "unicast has no setting"),
        (("delta: 0.1", "network: {transport: multicast}\ndelta: 0.1"), "F005", 1, 10, "`group: 239.255.71.1`"),
        (("delta: 0.1", "network: {transport: multicast, group: 10.0.0.1}\ndelta: 0.1"), "F005", 1, 40, "needs a gro"),
        (("delta: 0.1", "network: {transport: multicast, group: 9}\ndelta: 0.1"), "F004", 1, 40, "group must be a"),
        (("delta: 0.1", "network: {transport: broadcast, group: 239.1.2.3}\ndelta: 0.1"), "F005", 1, 40, "192.168.1."),
        (("delta: 0.1", "network: {transport: zenoh, port: 1}\ndelta: 0.1"), "F005", 1, 35, "possible keys: mode,"),
        (("delta: 0.1", "network: {transport: zenoh, mode: hub}\ndelta: 0.1"), "F005", 1, 35, "peer, router, client"),
        (("delta: 0.1", "network: {transport: zenoh, connect: x}\ndelta: 0.1"), "F004", 1, 38, "must be a list"),
        (("delta: 0.1", "network: {transport: zenoh, listen: [x]}\ndelta: 0.1"), "F005", 1, 38, "not a Zenoh endpoint"),
    ],
)  # fmt: skip
def test_each_mistake_at_its_place(change: tuple[str, str], code: str, line: int, column: int, words: str) -> None:
    assert change[0] in GOOD
    read_fleet, found = read(GOOD.replace(*change, 1))
    assert read_fleet is None
    assert [(c, ln, col) for c, ln, col, _ in found] == [(code, line, column)], found
    assert words in found[0][3]


@pytest.mark.parametrize(
    ("text", "link"),
    [
        ("", None),
        ("link: {}\n", medium.Medium(6e6, 0.1, 1500)),
        ("link: {rate: 6e6, loss: 0, mtu: 576}\n", medium.Medium(6e6, 0.0, 576)),
        ("link: {rate: 54000000}\n", medium.Medium(54e6, 0.1, 1500)),
        ("link: {rate: 1.5E+7, loss: 0.25}\n", medium.Medium(15e6, 0.25, 1500)),
    ],
)
def test_the_link(text: str, link: medium.Medium | None) -> None:
    read_fleet, found = read(text + GOOD)
    assert found == []
    assert read_fleet is not None
    assert read_fleet.link == link


def test_a_word_may_stand_for_a_number() -> None:
    read_fleet, found = read("sim: {boot: real}\n" + GOOD)
    assert found == [] and read_fleet is not None and read_fleet.harness["sim"]["boot"] == "real"


@pytest.mark.parametrize(
    ("text", "network"),
    [
        ("", Network()),
        ("network: {}", Network()),
        (
            "network: {transport: multicast, group: 239.255.71.1, port: 47001, interface: wlan0}",
            Network("multicast", "239.255.71.1", 47001, "wlan0"),
        ),
        ("network: {transport: broadcast, group: 192.168.1.255}", Network("broadcast", "192.168.1.255")),
        ("network: {transport: zenoh}", Network("zenoh")),
        (
            "network: {transport: zenoh, mode: client, connect: [tcp/10.0.0.1:7447], listen: []}",
            Network("zenoh", mode="client", connect=("tcp/10.0.0.1:7447",), listen=()),
        ),
    ],
)
def test_the_network_is_what_robots_read(text: str, network: Network) -> None:
    read_fleet, found = read(f"{text}\n{GOOD}")
    assert found == [] and read_fleet is not None
    assert msgspec.convert(read_fleet.network, Network) == network


def test_several_mistakes_in_one_run() -> None:
    _, found = read(GOOD.replace("delta: 0.1", "delta: no").replace("car", "boat").replace("lo: [-5", "lo: [x"))
    assert [f[0] for f in found] == ["F004", "F004", "F007"]


@pytest.mark.parametrize("text", ["", "[]", "42", "robots: {}", "a: &a [*a]", "? [1]\n: 2\n", "\0", "- " * 3000])
def test_strange_files_are_mistakes_not_crashes(text: str) -> None:
    read_fleet, found = read(text)
    assert read_fleet is None
    assert found


@given(st.data())
def test_mutated_files_never_crash(data: Any) -> None:
    at = data.draw(st.integers(0, len(GOOD)))
    cut = data.draw(st.integers(0, 12))
    text = GOOD[:at] + data.draw(st.text(max_size=8)) + GOOD[at + cut :]
    read_fleet, found = read(text)
    assert (read_fleet is None) == bool(found)


def test_params_may_have_parts() -> None:
    seen: list[object] = []

    def fits(value: object) -> str:
        seen.append(value)
        return ""

    text = "params: {tasks: [{target: [1, 2.5, 0], name: a}, {}], on: true}\n" + GOOD
    found: list[str] = []
    source = Source("fleet.yaml", text)
    got = fleet.read(source, TARGETS, {"tasks": fits, "on": fits}, lambda code, *_: found.append(code))
    assert got is not None and not found
    assert seen == [[{"target": [1, 2.5, 0], "name": "a"}, {}], True]
    assert got.params == {"tasks": seen[0], "on": True}


@pytest.mark.parametrize("value", ["2001-01-01", "null", "!!binary aGVsbG8=", "[1, ~]"])
def test_params_are_plain_values(value: str) -> None:
    source = Source("fleet.yaml", f"params: {{p: {value}}}\n" + GOOD)
    found: list[str] = []
    assert fleet.read(source, TARGETS, {"p": lambda v: ""}, lambda code, *_: found.append(code)) is None
    assert found == ["F004"]


def test_control_ports_are_the_runtimes_by_default() -> None:
    for port in (1, 47100, 64535, 64536, 65535):
        robot = {"robot": "a", "pid": 0, "peers": [{"name": "a", "host": "h", "port": port}]}
        plain = {"app": "a", "delta": 0.1, "origin": {"latitude": 0.0, "longitude": 0.0, "altitude": 0.0}}
        fence = {"geofence": {"lo": [0, 0, 0], "hi": [1, 1, 1]}}
        assert msgspec.convert({**plain, **robot, **fence}, Settings).control_port == control_port(port)


@pytest.mark.parametrize(
    ("bert", "message"),
    [
        ("127.0.0.1:48100", "address 127.0.0.1:48100 is already robot 0's control"),
        ("127.0.0.1:46100", "control 127.0.0.1:47100 is already robot 0's address"),
        ("127.0.0.1:47101\n    control: 48100", "control 127.0.0.1:48100 is already robot 0's control"),
        ("127.0.0.1:47101\n    control: 47101", "control 127.0.0.1:47101 is already robot 1's address"),
        ("127.0.0.1:47101\n    control: 65536", "control is 65536"),
        ("127.0.0.2:48100", ""),
        ("127.0.0.1:47101\n    control: 5000", ""),
    ],
)
def test_control_ports_are_nobody_elses(bert: str, message: str) -> None:
    read_fleet, found = read(GOOD.replace("127.0.0.1:47101", bert))
    assert [f for f in found if message not in f[3]] == []
    assert len(found) == bool(message)
    assert message or (read_fleet and read_fleet.robots[0].control == 48100)
