"""The scan feed: what arrives is what was sent, for a while; what is hostile raises and keeps nothing."""

from __future__ import annotations

import math
import socket
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.net.seal import POSITION, SCAN, seal
from koordgen.runtime.values.points import Point, transmissible
from koordgen.runtime.vehicle.platform import Finding, Unready
from koordgen.runtime.vehicle.scans import (
    FIRST_SAMPLE_TIMEOUT,
    MOST_RAYS,
    MOST_SCANS,
    WINDOW,
    ScanPort,
    Scans,
    Sweep,
    encode,
    packed,
)

KEY = bytes(range(32))
PLACE = Point(1.0, -2.0, 0.07)
RANGES = [6.0, 7.0, 0.0, 0.123, 3.0, 5.9999, -0.01]


def sweep(sequence: int = 1, **change: Any) -> Sweep:
    usual = Sweep("bert", 1, sequence, PLACE, 0.5, 0.1, 6.0, packed(RANGES, 6.0))
    return msgspec.structs.replace(usual, **change)


def datagram(sequence: int = 1, key: bytes | None = KEY, **change: Any) -> bytes:
    return encode(sweep(sequence, **change), key)


def test_what_arrives_is_what_was_measured() -> None:
    feed = Scans("bert", KEY)
    assert feed.recent(0.0) == ()
    assert feed.receive(datagram(), 10.0) and feed.heard
    ((place, scan),) = feed.recent(10.0)
    assert place == PLACE and scan.max_range == 6.0
    assert scan.angles == pytest.approx([0.5 + 0.1 * i for i in range(7)])
    assert scan.ranges == pytest.approx([6.0, 6.0, 0.0, 0.123, 3.0, 5.9999, 0.0], abs=1e-4)
    assert scan.ranges[:2] == (6.0, 6.0) and scan.ranges[5] < 6.0, "nothing is told from something"
    assert transmissible(feed.recent(10.0))


@pytest.mark.parametrize("max_range", [0.1, 6.0, 7.7, 100.0, 511.99347310532653])
def test_nothing_is_the_maximum_to_the_last_bit_and_the_farthest_thing_is_nearer(max_range: float) -> None:
    feed = Scans("bert", KEY)
    just_below = math.nextafter(max_range, 0.0)
    feed.receive(datagram(max_range=max_range, ranges=packed([max_range, just_below], max_range)), 0.0)
    ((_, scan),) = feed.recent(0.0)
    assert scan.ranges[0] == max_range > scan.ranges[1]


def test_the_largest_turn_fits_in_a_datagram() -> None:
    full = packed([1.0] * MOST_RAYS, 6.0)
    large = datagram(2**60, robot="r" * 32, session=2**60, age=0.1, ranges=full)
    assert len(large) <= 1200
    assert Scans("r" * 32, KEY).receive(large, 0.0)


def test_looking_changes_nothing_and_scans_are_seen_for_a_while() -> None:
    feed = Scans("bert", KEY)
    feed.receive(datagram(1), 10.0)
    feed.receive(datagram(2, age=0.3), 10.2)  # measured before the first arrived
    assert len(feed.recent(10.2)) == 2 and feed.recent(10.2) == feed.recent(10.2)
    assert len(feed.recent(9.9 + WINDOW + 0.05)) == 1
    assert feed.recent(10.01 + WINDOW) == ()


def test_of_many_the_newest_are_kept() -> None:
    feed = Scans("bert", KEY)
    for k in range(1, 20):
        feed.receive(datagram(k, position=Point(float(k), 0.0, 0.0)), 10.0)
    assert [place.x for place, _ in feed.recent(10.0)] == [16.0, 17.0, 18.0, 19.0]


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (datagram(5), "old"),
        (datagram(4), "old"),
        (datagram(9, session=0), "old"),
        (datagram(9, robot="alice"), "another robot's"),
        (datagram(9, key=bytes(32)), "not authentic"),
        (datagram(9)[:-1], "not authentic"),
        (b"", "not authentic"),
        (seal(KEY, POSITION, msgspec.msgpack.encode(sweep(9))), "not authentic"),  # of another protocol
        (seal(KEY, SCAN, b"\xc1"), "malformed"),
        (seal(KEY, SCAN, b"\x91" * 1000), "malformed"),
        (seal(KEY, SCAN, msgspec.msgpack.encode(list(range(9)))), "malformed"),
        (datagram(9, first=math.nan), "out of range"),
        (datagram(9, step=math.inf), "out of range"),
        (datagram(9, step=1e300), "out of range"),
        (datagram(9, age=math.nan), "out of range"),
        (datagram(9, position=Point(0.0, math.inf, 0.0)), "out of range"),
        (datagram(9, max_range=0.0), "out of range"),
        (datagram(9, max_range=-1.0), "out of range"),
        (datagram(9, max_range=math.nan), "out of range"),
        (datagram(9, max_range=1e9), "out of range"),
        (datagram(9, ranges=b""), "out of range"),
        (datagram(9, ranges=b"odd"), "out of range"),
        (datagram(9, ranges=bytes(2 * MOST_RAYS + 2)), "out of range"),
    ],
)
def test_what_is_not_right_changes_nothing(bad: bytes, reason: str) -> None:
    feed = Scans("bert", KEY)
    feed.receive(datagram(5), 10.0)
    before = feed.recent(10.0)
    assert not feed.receive(bad, 10.0)
    assert feed.rejected == {reason: 1}
    assert feed.recent(10.0) == before


def bounded(feed: Scans) -> bool:
    return len(feed._seen) <= MOST_SCANS and len(feed.rejected) <= 5 and transmissible(feed.recent(10.0))


@given(st.lists(st.binary(max_size=300)), st.booleans())
def test_noise_neither_raises_nor_stays(noise: list[bytes], sealed: bool) -> None:
    feed = Scans("bert", None)
    for data in noise:
        feed.receive(seal(None, SCAN, data) if sealed else data, 10.0)
    assert bounded(feed)


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.binary(max_size=9) | st.text(),
    lambda inner: st.lists(inner, max_size=4),
    max_leaves=9,
)


@given(st.lists(st.tuples(st.integers(0, 8), ANYTHING), min_size=1, max_size=3))
def test_a_turn_with_anything_in_its_fields_neither_raises_nor_is_seen_wrongly(changes: list[tuple[int, Any]]) -> None:
    feed = Scans("bert", None)
    fields: list[Any] = msgspec.to_builtins(sweep(3), builtin_types=(bytes,))
    for place, value in changes:
        fields[place] = value
    feed.receive(seal(None, SCAN, msgspec.msgpack.encode(fields)), 10.0)
    assert bounded(feed)


@pytest.fixture
def ports() -> Iterator[Callable[[str], ScanPort]]:
    made: list[ScanPort] = []

    def make(setting: str) -> ScanPort:
        made.append(ScanPort(setting, "bert", KEY))
        return made[-1]

    yield make
    for port in made:
        port.close()
        port.close()


def free() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def send(number: int, data: bytes) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(data, ("127.0.0.1", number))


def test_a_robot_without_a_lidar_waits_for_none(ports: Callable[[str], ScanPort]) -> None:
    port = ports("")
    port.open()
    port.poll(0.0)
    port.poll(FIRST_SAMPLE_TIMEOUT + 1.0)
    assert port.waiting == "" and port.diagnose(lambda seconds: None) == []


def test_scans_arrive_over_udp(ports: Callable[[str], ScanPort]) -> None:
    number = free()
    port = ports(f"udp:127.0.0.1:{number}")
    port.open()
    send(number, b"noise")
    port.poll(0.0)
    assert port.waiting == f"waiting for scans on udp:127.0.0.1:{number}; dropped: 1 not authentic"
    send(number, datagram(1))
    send(number, datagram(2))
    port.poll(1.0)
    assert port.waiting == "" and len(port.scans.recent(1.0)) == 2


def test_a_lidar_that_stays_silent_is_told_once(ports: Callable[[str], ScanPort]) -> None:
    port = ports(f"udp:127.0.0.1:{free()}")
    port.open()
    port.poll(1000.0)
    port.poll(1000.0 + FIRST_SAMPLE_TIMEOUT)
    with pytest.raises(Unready, match="none has come for 61 s") as error:
        port.poll(1001.0 + FIRST_SAMPLE_TIMEOUT)
    assert "driver" in error.value.hint
    port.poll(1002.0 + FIRST_SAMPLE_TIMEOUT)  # the robot must be able to land


def test_diagnosis_waits_for_a_scan_and_closes_the_port(ports: Callable[[str], ScanPort]) -> None:
    number = free()
    waited: list[float] = []
    port = ports(f"udp:127.0.0.1:{number}")
    (found,) = port.diagnose(waited.append)
    assert (found.state, found.wanted) == ("fail", "one within 0.5 s") and "driver" in found.why
    assert sum(waited) == pytest.approx(WINDOW)
    (found,) = port.diagnose(lambda seconds: send(number, datagram()))
    assert found == Finding("scans", "ok", f"arrive on udp:127.0.0.1:{number}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", number))
        (found,) = port.diagnose(waited.append)
    assert found.state == "fail" and "cannot receive scans" in found.found


@pytest.mark.parametrize("setting", ["lidar", "udp:", "udp:1234", "tcp:127.0.0.1:1", "udp:127.0.0.1:x", "udp::"])
def test_a_setting_that_is_none_is_unready(ports: Callable[[str], ScanPort], setting: str) -> None:
    with pytest.raises(Unready, match="is not a UDP address") as error:
        ports(setting).open()
    assert "udp:HOST:PORT" in error.value.hint


def test_a_port_that_cannot_be_had_is_unready(ports: Callable[[str], ScanPort]) -> None:
    number = free()
    ports(f"udp:127.0.0.1:{number}").open()
    for setting in (f"udp:127.0.0.1:{number}", "udp:127.0.0.1:99999"):
        with pytest.raises(Unready, match="cannot receive scans"):
            ports(setting).open()
