"""Bytes and messages: garbage is counted and skipped, strangers are ignored, commands are asked again."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import Wire
from koordgen.runtime.vehicle.platform import Unready
from targets.mavlink.framing import Framer
from targets.mavlink.link import Link, Vehicle
from targets.mavlink.transport import opened


def heartbeat(system: int = 1, component: int = 1, autopilot: int = 3, kind: int = 2) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(kind, autopilot, 1, 0, 3, 3)
    return bytes(message.pack(mavlink.MAVLink(None, system, component)))


def text(said: str, severity: int = 2, number: int = 0, part: int = 0) -> bytes:
    message = mavlink.MAVLink_statustext_message(severity, said.encode(), number, part)
    return bytes(message.pack(mavlink.MAVLink(None, 1, 1)))


@given(st.lists(st.binary(max_size=400), max_size=5), st.integers(1, 50))
def test_frames_survive_garbage_between_them(garbage: list[bytes], cut: int) -> None:
    framer = Framer()
    messages = framer.datagram(b"".join(g + heartbeat() for g in garbage) + heartbeat())
    assert len(messages) == len(garbage) + 1


@given(st.binary(max_size=2000))
def test_garbage_never_raises(data: bytes) -> None:
    framer = Framer()
    framer.datagram(data)
    framer.stream(data)
    framer.stream(data)


def test_garbage_is_counted() -> None:
    framer = Framer()
    damaged = bytearray(heartbeat())
    damaged[12] ^= 1
    assert framer.datagram(bytes(damaged) + b"abc") == []
    assert framer.rejected == {"bytes": len(damaged) + 3, "frames": 1}


def test_a_stream_may_be_cut_anywhere() -> None:
    stream = (heartbeat() + text("Arm: hello")) * 20
    for size in (1, 7, 30):
        framer = Framer()
        messages = [m for i in range(0, len(stream), size) for m in framer.stream(stream[i : i + size])]
        assert len(messages) == 40 and not framer.rejected


def test_a_stream_finds_back_after_damage() -> None:
    random.seed(3)
    framer = Framer()
    framer.stream(b"\xfd\xff\x00" + random.randbytes(50))  # claims 267 bytes
    messages = [m for _ in range(20) for m in framer.stream(heartbeat())]
    assert len(messages) == 20


def test_mavlink_1_is_understood() -> None:
    message = mavlink.MAVLink_heartbeat_message(2, 3, 1, 0, 3, 3)
    frame = bytes(message.pack(mavlink.MAVLink(None, 1, 1), force_mavlink1=True))
    assert frame[0] == 0xFE
    assert len(Framer().datagram(frame)) == 1


def test_the_first_autopilot_is_the_vehicle_and_others_are_ignored() -> None:
    wire = Wire()
    link = Link(wire)
    wire.inject(heartbeat(system=255, autopilot=mavlink.MAV_AUTOPILOT_INVALID))  # a ground station
    wire.inject(text("before any vehicle"))
    assert link.receive(0.0) == []
    wire.inject(heartbeat(system=7))
    wire.inject(heartbeat(system=8))
    assert len(link.receive(1.0)) == 1
    assert link.vehicle == Vehicle(7, 1, 3, 2)
    assert link.rejected["another system"] == 1


def test_while_the_vehicle_speaks_no_other_address_does_in_its_name() -> None:
    wire = Wire()
    link = Link(wire)
    wire.inject(heartbeat())
    link.receive(0.0)
    wire.down.append((heartbeat(), ("10.0.0.9", 5)))
    assert link.receive(1.0) == [] and link.rejected["another address"] == 1
    wire.down.append((heartbeat(), ("10.0.0.9", 5)))  # the autopilot restarted and sends from another port
    assert len(link.receive(5.0)) == 1


def test_a_second_autopilot_on_the_link_is_noticed_and_forgotten_when_it_is_gone() -> None:
    for second, source in ((heartbeat(system=2), ("127.0.0.1", 1)), (heartbeat(), ("10.0.0.9", 5))):
        wire = Wire()
        link = Link(wire)
        wire.inject(heartbeat())
        wire.inject(heartbeat(system=255, autopilot=mavlink.MAV_AUTOPILOT_INVALID))
        wire.inject(heartbeat(component=154, autopilot=0))  # a gimbal of the vehicle's own
        link.receive(0.0)
        assert not link.crowded(0.0)
        wire.down.append((second, source))
        link.receive(1.0)
        assert link.crowded(1.0) and link.crowded(4.0) and not link.crowded(7.0)


def test_long_texts_are_put_together() -> None:
    wire = Wire()
    link = Link(wire)
    for datagram in (heartbeat(), text("a" * 50, number=4), text("b" * 10, number=4, part=1), text("c")):
        wire.inject(datagram)
    link.receive(1.0)
    assert [said for _, _, said in link.texts] == ["a" * 50 + "b" * 10, "c"]
    assert link.reasons(0.0) == "a" * 50 + "b" * 10 + "; c"
    assert link.reasons(1.1) == ""


def sent_commands(wire: Wire) -> list[tuple[int, int]]:
    return [(m.command, m.confirmation) for m in Framer().stream(b"".join(wire.up)) if m.get_msgId() == 76]


def test_a_command_is_asked_again_until_forgotten() -> None:
    wire = Wire()
    link = Link(wire)
    assert link.ask(0.0, 400, 1.0).times == 0  # nobody there yet
    wire.inject(heartbeat())
    link.receive(0.0)
    for tick in range(50):
        link.ask(tick * 0.05, 400, 1.0)
    assert sent_commands(wire) == [(400, 0), (400, 1), (400, 2)]
    ack = mavlink.MAVLink_command_ack_message(400, mavlink.MAV_RESULT_FAILED, 0, 0, 255, 190)
    wire.inject(bytes(ack.pack(mavlink.MAVLink(None, 1, 1))))
    link.receive(2.6)
    asked = link.asked(400)
    assert asked is not None and asked.result == mavlink.MAV_RESULT_FAILED
    link.forget(400)
    assert link.asked(400) is None


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_no_command_carries_what_is_not_finite(bad: float) -> None:
    wire = Wire()
    link = Link(wire)
    wire.inject(heartbeat())
    link.receive(0.0)
    with pytest.raises(ValueError, match="not finite"):
        link.send_once(22, 0, 0, 0, 0, 0, 0, bad)
    assert wire.up == []


BAD = ["", "udp", "udpin:", "udpin:1.2.3.4", "udpin:1.2.3.4:x", "http:h:1", "udpin:127.0.0.1:99999", "serial:/no:57600"]


@pytest.mark.parametrize("url", BAD)
def test_a_bad_link_is_refused_in_words(url: str) -> None:
    with pytest.raises(Unready) as error:
        opened(url)
    assert (url in error.value.message or not url) and error.value.hint


def test_a_system_that_is_asked_for_is_the_vehicle_and_the_others_are_counted() -> None:
    wire = Wire()
    link = Link(wire, system=7)
    for system in (3, 255, 7, 3):
        wire.inject(heartbeat(system=system, autopilot=3 if system != 255 else mavlink.MAV_AUTOPILOT_INVALID))
    assert len(link.receive(0.0)) == 1 and link.vehicle == Vehicle(7, 1, 3, 2)
    assert link.rejected == {"another system": 3} and link.others == {3}
    assert not link.crowded(0.0)
    wire.down.append((heartbeat(system=3), ("10.0.0.9", 5)))
    assert link.receive(1.0) == [] and not link.crowded(1.0)
    wire.down.append((heartbeat(system=7), ("10.0.0.9", 5)))  # two with one id
    assert link.receive(1.0) == [] and link.crowded(1.0) and link.rejected["another address"] == 1
