"""The autopilot's parameters: read under either name, decoded as each firmware sends them, and what follows."""

from __future__ import annotations

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import Rig, Wire, commands, sent
from targets.mavlink.framing import Framer
from targets.mavlink.link import Link
from targets.mavlink.parameters import Parameters, Wanted
from tests.mavlink.test_link import heartbeat

READ, SET = mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ, mavlink.MAVLINK_MSG_ID_PARAM_SET
BYTEWISE, CAST = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE,
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST,
)
REAL32, INT8, UINT8, INT32 = (
    mavlink.MAV_PARAM_TYPE_REAL32,
    mavlink.MAV_PARAM_TYPE_INT8,
    mavlink.MAV_PARAM_TYPE_UINT8,
    mavlink.MAV_PARAM_TYPE_INT32,
)


def packed(message: mavlink.MAVLink_message) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, 1, 1)))


def answer(name: str, raw: bytes, kind: int) -> bytes:
    """A PARAM_VALUE whose value has these four bytes."""
    frame = bytearray(packed(mavlink.MAVLink_param_value_message(name.encode(), 1.0, kind, 900, 65535)))
    frame[10:14] = raw
    crc = mavlink.x25crc(frame[1:-2])
    crc.accumulate(bytes([mavlink.MAVLink_param_value_message.crc_extra]))
    frame[-2:] = struct.pack("<H", crc.crc)
    return bytes(frame)


def version(capabilities: int) -> bytes:
    nothing = [0] * 8
    return packed(mavlink.MAVLink_autopilot_version_message(capabilities, 0, 0, 0, 0, *[nothing] * 3, 0, 0, 0))


def reader(*wanted: Wanted, bytewise: bool = False) -> tuple[Parameters, Link, Wire]:
    wire = Wire()
    link = Link(wire)
    wire.inject(heartbeat())
    link.receive(0.0)
    return Parameters(wanted, bytewise), link, wire


def asked(wire: Wire) -> list[str]:
    return [m.param_id for m in Framer().stream(b"".join(wire.up)) if m.get_msgId() == READ]


CASES = [
    (struct.pack("<f", 14.0), INT8, CAST, 14.0),
    (struct.pack("<f", -1.0), INT32, CAST, -1.0),
    (struct.pack("<f", 0.25), REAL32, CAST, 0.25),
    (struct.pack("<i", 14), INT32, BYTEWISE, 14.0),
    (struct.pack("<i", -1), INT32, BYTEWISE, -1.0),  # as a float: a NaN
    (struct.pack("<i", -5_000_000), INT32, BYTEWISE, -5_000_000.0),  # a signalling one
    (struct.pack("<Bxxx", 200), UINT8, BYTEWISE, 200.0),
    (struct.pack("<bxxx", -3), INT8, BYTEWISE, -3.0),
    (struct.pack("<f", 0.25), REAL32, BYTEWISE, 0.25),
]


@pytest.mark.parametrize(("raw", "kind", "capability", "value"), CASES)
@pytest.mark.parametrize("late", [False, True])
def test_values_are_decoded_as_the_firmware_sends_them(
    raw: bytes, kind: int, capability: int, value: float, late: bool
) -> None:
    parameters, link, wire = reader(Wanted("P", (), (value,), "why"), bytewise=capability != BYTEWISE)
    frames = [version(capability), answer("P", raw, kind)]
    for frame in reversed(frames) if late else frames:
        wire.inject(frame)
    for message in link.receive(1.0):
        parameters.handle(message)
    assert [r.found for r in parameters.readings] == [value] and parameters.done(1.0) and not parameters.differences


def test_both_names_are_tried_and_one_that_nobody_knows_ends() -> None:
    old, new = Wanted("MAV_GCS_SYSID", ("SYSID_MYGCS",), (255,), "why"), Wanted("NOSUCH", (), (1, 2), "it matters")
    parameters, link, wire = reader(old, new)
    now = 0.0
    while not parameters.done(now):
        now += 0.05
        parameters.poll(link, now)
        if asked(wire).count("SYSID_MYGCS") == 1:
            wire.inject(answer("SYSID_MYGCS", struct.pack("<f", 254.0), INT32))
        wire.inject(answer("OTHER", struct.pack("<f", 1.0), INT32))  # nobody wants to know
        for message in link.receive(now):
            parameters.handle(message)
    assert 3.0 < now < 5.0
    assert asked(wire)[:4] == ["MAV_GCS_SYSID", "NOSUCH", "SYSID_MYGCS", "NOSUCH"]
    assert [str(r) for r in parameters.differences] == [
        "SYSID_MYGCS is 254, wanted 255: why",
        "NOSUCH does not answer, wanted 1 or 2: it matters",
    ]
    wire.up.clear()
    parameters.again()
    parameters.poll(link, now)
    assert asked(wire) == ["MAV_GCS_SYSID", "NOSUCH"]


def test_no_take_off_with_an_autopilot_that_would_not_land_when_the_agent_dies() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    params = rig.autopilot.copter.params
    params["FS_GCS_ENABLE"] = 0.0
    rig.quad.start(rig.now)
    rig.run(12.0)
    assert rig.quad.progress == (
        "not taking off: FS_GCS_ENABLE is 0, wanted 5: else the vehicle does not land when the agent dies "
        "(correct them with a ground station, or switch on a pilot's remote control; with the robot's setting "
        "`allow_no_failsafe: true` the robot takes off without either)"
    )
    assert not commands(rig, mavlink.MAV_CMD_COMPONENT_ARM_DISARM) and not sent(rig, SET)
    (found,) = (f for f in rig.agent().diagnose() if f.name == "FS_GCS_ENABLE")
    assert (found.state, found.found, found.wanted) == ("fail", "0", "5") and "does not land" in found.why
    params["FS_GCS_ENABLE"] = 5.0  # somebody mends it
    assert rig.run(20.0, lambda: rig.quad.ready)


def test_no_take_off_while_a_vital_parameter_does_not_answer() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    del rig.autopilot.copter.params["MAV_GCS_SYSID"]
    rig.quad.start(rig.now)
    rig.run(10.0)
    assert "not taking off: MAV_GCS_SYSID does not answer, wanted 255" in rig.quad.progress
    rig.autopilot.copter.params["SYSID_MYGCS"] = 255.0
    assert rig.run(20.0, lambda: rig.quad.ready)


def test_with_a_pilot_s_remote_control_it_takes_off_and_says_who_must_land_it() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    rig.autopilot.copter.params["FS_GCS_ENABLE"] = 0.0
    rig.quad.start(rig.now)
    rig.run(8.0)
    assert "not taking off" in rig.quad.progress
    requests = [
        c for c in commands(rig, mavlink.MAV_CMD_REQUEST_MESSAGE) if c.param1 == mavlink.MAVLINK_MSG_ID_RC_CHANNELS
    ]
    assert requests  # it asks whether there is one
    rig.autopilot._send(mavlink.MAVLink_rc_channels_message(0, 16, *[1500] * 18, 255))
    assert rig.run(30.0, lambda: rig.quad.ready)
    assert any("if the agent dies, its pilot must land the robot" in said for said in rig.progress)


def test_what_does_not_forbid_a_take_off_is_told_once() -> None:
    rig = Rig(allow_no_failsafe=True)
    assert rig.autopilot is not None
    rig.autopilot.copter.params |= {"FS_GCS_ENABLE": 1.0, "LAND_REPOSITION": 1.0}
    rig.fly()
    (told,) = (said for said in rig.progress if "parameters" in said)
    assert told.endswith(
        "parameters of the autopilot differ: FS_GCS_ENABLE is 1, wanted 5: else the vehicle does not land when "
        "the agent dies; LAND_REPOSITION is 1, wanted 0: else the vehicle waits for a pilot after landing, and does "
        "not disarm"
    )
    assert not sent(rig, SET)


def test_what_differs_is_told_while_there_is_no_estimate_yet() -> None:
    """It may be why there is none."""
    rig = Rig(boot=30.0)
    assert rig.autopilot is not None
    rig.autopilot.copter.params["FS_THR_ENABLE"] = 1.0
    rig.quad.start(rig.now)
    rig.run(3.0)
    assert rig.quad.progress == (
        "waiting for the autopilot's position estimate; parameters of the autopilot differ: FS_THR_ENABLE is 1, "
        "wanted 0: else the vehicle does not fly without a remote control"
    )
    rig.autopilot.copter.params["FS_THR_ENABLE"] = 0.0
    assert rig.run(50.0, lambda: rig.quad.ready)
