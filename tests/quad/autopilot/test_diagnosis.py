"""What a quad finds of its autopilot before a flight, each thing wrong in turn; nothing moves."""

from __future__ import annotations

import itertools

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import FENCE, ORIGIN, Rig, Wire, commands, sent, settings, told
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.vehicle.platform import Finding, Unready
from targets.mavlink.framing import Message
from targets.mavlink.link import Link
from targets.mavlink.transport import Transport
from targets.quad.autopilot.check import SILENCE, Heard
from targets.quad.autopilot.diagnosis import checks
from targets.quad.autopilot.telemetry import Telemetry
from targets.quad.platform.platform import Quad

HARMLESS = {
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_REQUEST_MESSAGE,
    mavlink.MAV_CMD_RUN_PREARM_CHECKS,
}


def diagnosed(rig: Rig) -> dict[str, Finding]:
    found = rig.quad.diagnose()
    assert len({f.name for f in found}) == len(found) and rig.wire.closed
    assert all(f.state == "ok" or f.why or f.name == "place" for f in found), "what to do about it"
    return {f.name: f for f in found}


def test_all_is_well_and_nothing_moves() -> None:
    rig = Rig()
    rig.pass_time(2.0)
    began = rig.now
    found = diagnosed(rig)
    assert rig.now - began <= 15.0
    assert {f.state for f in found.values()} == {"ok"}, found
    assert "ArduPilot quadrotor 4.7.0" in found["firmware"].found
    assert "(1.00, -2.00, 0.00) m, inside the geofence, 1.5 m to climb" in found["place"].found
    assert "GLOBAL_POSITION_INT 20 of 20" in found["streams"].found
    assert {m.command for m in sent(rig, mavlink.MAVLINK_MSG_ID_COMMAND_LONG)} <= HARMLESS
    assert not commands(rig, mavlink.MAV_CMD_COMPONENT_ARM_DISARM)


@pytest.mark.parametrize(
    ("up", "advice"), [(5.0, "still starting: check again 30 s after its boot"), (40.0, "baud rate")]
)
def test_streams_that_are_slow_while_the_autopilot_starts_are_not_the_links_fault(up: float, advice: str) -> None:
    rig = Rig()
    rig.pass_time(up)
    seen = itertools.count()

    def slow(data: bytes, down: bool) -> bytes | None:
        return None if down and told(data) == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT and next(seen) % 2 else data

    rig.wire.meddle = slow
    streams = diagnosed(rig)["streams"]
    assert streams.state == "warn" and advice in streams.why and "GLOBAL_POSITION_INT 10 of 20" in streams.found


def test_a_build_that_may_spin_and_the_parameter_that_helps() -> None:
    rig = Rig(harness={"version": "4.7-dev"})
    found = diagnosed(rig)
    assert "ArduPilot quadrotor 4.7.0-dev" in found["firmware"].found
    spins = found["GUID_OPTIONS"]
    assert (spins.state, spins.found) == ("warn", "0") and "spin in flight without a radio receiver" in spins.why
    assert spins.wanted == "4, or any number with that bit set"
    assert rig.autopilot is not None
    rig.autopilot.copter.params["GUID_OPTIONS"] = 6.0
    rig.quad = rig.agent()
    assert "parameters" in diagnosed(rig)


@pytest.mark.parametrize("version", ["4.6", "4.6-dev", "4.7", "4.8-dev"])
def test_a_build_that_does_not_spin(version: str) -> None:
    assert "GUID_OPTIONS" not in diagnosed(Rig(harness={"version": version}))


def test_a_silent_link() -> None:
    rig = Rig(autopilot=False)
    found, *_ = diagnosed(rig).values()
    assert (found.name, found.state) == ("link", "fail") and "no autopilot answers on udpin:" in found.found
    assert rig.now - 1000.0 == pytest.approx(SILENCE, abs=0.1)


def test_a_link_that_cannot_be_opened() -> None:
    def connect(url: str) -> Transport:
        raise Unready(f"cannot open {url}", "free it")

    found, *_ = Quad(settings(), None, connect=connect).diagnose()
    assert found == Finding("link", "fail", "cannot open udpin:127.0.0.1:14550", why="free it")


def test_no_position_estimate() -> None:
    rig = Rig(boot=42.0)
    found = diagnosed(rig)
    assert found["estimate"].state == "fail" and "no position estimate yet" in found["estimate"].found
    assert "place" not in found and rig.now - 1000.0 <= 15.0


def test_a_place_outside_the_fence() -> None:
    found = diagnosed(Rig(position=(9.0, 0.0, 0.0)))
    assert found["place"].state == "fail" and "(9.00, 0.00, 0.00), outside the geofence" in found["place"].found


def test_a_ground_above_the_flight_height() -> None:
    found = diagnosed(Rig(flight_height=0.3, position=(0.0, 0.0, 0.0)))
    assert found["place"].state == "ok"
    rig = Rig(flight_height=1.0)
    rig.fly()
    rig.quad.close()
    found = diagnosed(rig)
    assert found["state"].found == "flying" and found["state"].state == "warn"


def test_another_vehicle_ends_the_look_at_once() -> None:
    rig = Rig()
    assert rig.autopilot is not None

    def disguised(data: bytes, down: bool) -> bytes | None:
        if down and told(data) == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            heartbeat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GROUND_ROVER, 3, 81, 15, 3, 3)
            return bytes(heartbeat.pack(mavlink.MAVLink(None, 1, 1)))
        return data

    rig.wire.meddle = disguised
    found = diagnosed(rig)
    assert found["firmware"].state == "fail" and "not an ArduPilot or PX4 copter" in found["firmware"].found
    assert rig.now - 1000.0 < 3.0


def test_streams_that_come_too_seldom() -> None:
    rig = Rig()
    count = 0

    def thin(data: bytes, down: bool) -> bytes | None:
        nonlocal count
        if down and told(data) == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            count += 1
            return data if count % 3 == 0 else None
        return data

    rig.wire.meddle = thin
    found = diagnosed(rig)["streams"]
    assert found.state == "warn" and "GLOBAL_POSITION_INT 7 of 20" in found.found


def test_a_link_that_answers_no_question() -> None:
    rig = Rig()
    version = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    rig.wire.meddle = lambda data, down: None if down and told(data) == version else data
    assert diagnosed(rig)["firmware"].state == "warn"


# What the simulated autopilot never tells, as the real one would.


def judged(*messages: Message, wall: float = 1.8e9) -> dict[str, Finding]:
    frame = LocalFrame(*ORIGIN)
    wire = Wire()
    link = Link(wire)
    heard = Heard(link, Telemetry(frame))
    alive = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, 3, 81, 4, 3, 3)
    latitude, longitude = (round(v * 1e7) for v in ORIGIN[:2])
    place = mavlink.MAVLink_global_position_int_message(1, latitude, longitude, round(ORIGIN[2] * 1e3), 0, 0, 0, 0, 0)
    for message in (alive, ekf(), *messages, place):
        wire.inject(message.pack(mavlink.MAVLink(None, 1, 1)))
        for received in link.receive(1000.0):
            heard.record(received, 1000.0)
    heard.wall, heard.began, heard.ended = wall, 995.0, 1000.0
    return {f.name: f for f in checks("udpin:1", heard, frame, FENCE, 1.5)}


def ekf(flags: int = 0x33F, variance: float = 0.1) -> Message:
    return mavlink.MAVLink_ekf_status_report_message(flags, variance, 0.01, 0.01, 0.01, 0.0)


def status(millivolts: int, percent: int) -> Message:
    return mavlink.MAVLink_sys_status_message(0, 0, 0, 0, millivolts, 0, percent, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(("variance", "state"), [(0.39, "ok"), (0.41, "warn"), (0.79, "warn"), (0.81, "fail")])
def test_the_variances_of_the_estimate(variance: float, state: str) -> None:
    found = judged(ekf(variance=variance))["estimate"]
    assert found.state == state and found.found.endswith("of its limit: velocity")


def test_a_flag_that_the_estimate_lacks() -> None:
    found = judged(ekf(0x33F & ~mavlink.EKF_ATTITUDE))["estimate"]
    assert found.state == "fail" and found.found == "the EKF lacks attitude"


@pytest.mark.parametrize(
    ("millivolts", "percent", "state", "told"),
    [
        (12400, 80, "ok", "12.4 V, 80 %"),
        (11000, 49, "warn", "11.0 V, 49 %"),
        (10000, 19, "fail", "10.0 V, 19 %"),
        (12400, -1, "ok", "12.4 V, charge not reported"),
        (0, -1, "warn", "not measured"),
        (65535, -1, "warn", "not measured"),
    ],
)
def test_the_battery(millivolts: int, percent: int, state: str, told: str) -> None:
    found = judged(status(millivolts, percent))["battery"]
    assert (found.state, found.found) == (state, told)


@pytest.mark.parametrize(
    ("unix", "state", "told"),
    [
        (0, "ok", "up for 90 s, the autopilot does not know the time of day"),
        (1_800_000_000_500_000, "ok", "up for 90 s, the autopilot's clock is +0.5 s from this computer's"),
        (1_799_999_000_000_000, "warn", "up for 90 s, the autopilot's clock is -1000.0 s from this computer's"),
    ],
)
def test_the_autopilots_clock(unix: int, state: str, told: str) -> None:
    found = judged(mavlink.MAVLink_system_time_message(unix, 90_000))["boot"]
    assert (found.state, found.found) == (state, told)


@pytest.mark.parametrize(("degrees", "state"), [(0.0, "ok"), (0.02, "warn")])
def test_the_origins(degrees: float, state: str) -> None:
    latitude, longitude, altitude = ORIGIN
    place = round((latitude + degrees) * 1e7), round(longitude * 1e7), round(altitude * 1e3) + 2000
    found = judged(mavlink.MAVLink_gps_global_origin_message(*place))["origin"]
    assert found.state == state and "m from the fleet's" in found.found
    assert degrees or found.found == "the autopilot's origin is 0.0 m from the fleet's, +2.0 m in altitude"


def said(text: str, severity: int = mavlink.MAV_SEVERITY_CRITICAL) -> Message:
    return mavlink.MAVLink_statustext_message(severity, text.encode())


def test_what_the_autopilot_says() -> None:
    refusal = said("PreArm: Compass not calibrated")
    warning, log_lines = said("Bad vision", mavlink.MAV_SEVERITY_WARNING), said("Hello", mavlink.MAV_SEVERITY_INFO)
    found = judged(refusal, warning, refusal, log_lines)
    assert (found["checks"].state, found["checks"].found) == ("fail", "PreArm: Compass not calibrated")
    assert (found["says"].state, found["says"].found) == ("warn", "Bad vision")
    assert not {"checks", "says", "sensors"} & set(judged(log_lines))


def test_its_health() -> None:
    bits = mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG | mavlink.MAV_SYS_STATUS_PREARM_CHECK
    rc = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER

    def health(present: int, enabled: int, healthy: int) -> dict[str, Finding]:
        return judged(mavlink.MAVLink_sys_status_message(present, enabled, healthy, 0, 12000, 0, 99, 0, 0, 0, 0, 0, 0))

    found = health(bits | rc, bits | rc, 0)
    assert found["sensors"].found == "not healthy: compass" and found["sensors"].state == "warn"
    assert found["checks"].state == "fail" and "does not report which" in found["checks"].found
    for fine in (health(bits, bits, bits), health(bits, 0, 0), health(0, bits, 0)):
        assert not {"checks", "sensors"} & set(fine)


def test_a_link_that_falls_silent() -> None:
    rig = Rig()
    rig.wire.meddle = lambda data, down: None if rig.now > 1001.9 else data
    found = diagnosed(rig)["link"]
    assert found.state == "fail" and "has fallen silent on udpin:127.0.0.1:14550 (" in found.found


def test_another_autopilot_on_the_link() -> None:
    rig = Rig()
    pass_time = rig.pass_time

    def two(seconds: float) -> None:
        pass_time(seconds)
        heartbeat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, 3, 81, 4, 3, 3)
        rig.wire.inject(heartbeat.pack(mavlink.MAVLink(None, 7, 1)))

    quad = Quad(settings(), None, connect=lambda url: rig.wire, clock=lambda: rig.now, sleep=two)
    found = quad.diagnose()[0]
    assert (found.name, found.state) == ("link", "fail") and "another autopilot (system 7)" in found.found


@pytest.mark.parametrize(("z", "state"), [(0.9, "ok"), (1.1, "warn")])
def test_a_ground_that_is_not_level_with_the_origin(z: float, state: str) -> None:
    rig = Rig(position=(0.0, 0.0, 0.0), flight_height=3.0)
    rig.body.position[2] = z
    rig.body.step = lambda dt: None  # type: ignore[method-assign]  # it stands there
    assert diagnosed(rig)["place"].state == state


def test_garbage_on_the_link_is_told() -> None:
    rig = Rig(autopilot=False)
    pass_time = rig.pass_time

    def noisy(seconds: float) -> None:
        pass_time(seconds)
        rig.wire.inject(b"\xfdnoise" * 7)

    quad = Quad(settings(), None, connect=lambda url: rig.wire, clock=lambda: rig.now, sleep=noisy)
    found, *_ = quad.diagnose()
    assert found.state == "fail" and "bytes arrived that are no MAVLink" in found.why


def test_arming_checks_that_fail() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    rig.autopilot.copter.failing_check = "Compass not calibrated"
    found = diagnosed(rig)["checks"]
    assert found.state == "fail" and found.why == "the autopilot will refuse to arm"
