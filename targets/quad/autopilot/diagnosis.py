"""Pre-flight checks of an autopilot, computed from a record of its messages.

Subjects: the link, the firmware, the parameters, the position estimate, the place, the battery, the clock, and the
autopilot's own pre-arm checks.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.vehicle.platform import Finding, State
from targets.mavlink.framing import Message
from targets.quad.autopilot.check import DEADLINE, RIVAL, Heard, coordinates, misplaced, stranger, unheard
from targets.quad.autopilot.vehicles import identified

CHARGE, LEAST_CHARGE = 50, 20  # battery charge in percent: below CHARGE is a warning, below LEAST_CHARGE a failure
LEVEL = 1.0  # metres that the ground may be above or below z = 0 without a warning
FAR_ORIGIN = 1000.0  # metres between the EKF's origin and the fleet's origin, above which there is a warning
CLOCKS = 1.0  # seconds that the autopilot's time of day may differ from this computer's without a warning
VARIANCE = 0.8  # innovation test ratio at which ArduPilot's EKF failsafe acts (the default of FS_EKF_THRESH)
SLOW = 0.7  # share of the requested rate of a stream, below which there is a warning
STARTING = 30.0  # seconds after its boot in which an autopilot may send more slowly than requested
_FLAGS = {
    mavlink.EKF_ATTITUDE: "attitude",
    mavlink.EKF_VELOCITY_HORIZ: "horizontal velocity",
    mavlink.EKF_VELOCITY_VERT: "vertical velocity",
    mavlink.EKF_POS_VERT_ABS: "height",
}
RELEASE, _TYPES = 255, {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc"}  # MAVLink's version types
_REFUSALS = ("PreArm:", "Arm:", "Preflight Fail:")
# Sensors whose failure is a warning. The remote control is not in this table, because it may be absent. The motor
# outputs are not in it either, because a safety switch may block them.
_SENSORS = {
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO: "gyro",
    mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL: "accelerometer",
    mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG: "compass",
    mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE: "barometer",
    mavlink.MAV_SYS_STATUS_SENSOR_GPS: "GPS",
    mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION: "external position",
    mavlink.MAV_SYS_STATUS_AHRS: "AHRS",
    mavlink.MAV_SYS_STATUS_SENSOR_BATTERY: "battery",
    mavlink.MAV_SYS_STATUS_LOGGING: "logging",
}


def checks(url: str, heard: Heard, frame: LocalFrame, fence: Box, height: float) -> list[Finding]:
    """Return the results of all checks, in the order in which failures should be repaired."""
    link = heard.link
    if link.vehicle is None:
        return [Finding.of("link", unheard(url, link, heard.ended - heard.began))]
    found = [_link(url, heard, link.vehicle.system)]
    what, firmware = identified(link)
    if firmware is None:
        return [*found, Finding.of("firmware", stranger(url, what))]
    return [
        *found,
        _version(what, heard),
        *_parameters(heard),
        *_rival(heard),
        *_armed(heard),
        _estimate(heard),
        *_place(heard, fence, height),
        *_origin(heard, frame),
        _streams(heard),
        *_battery(heard),
        *_clock(heard),
        *_checks(heard),
    ]


def _link(url: str, heard: Heard, system: int) -> Finding:
    if not heard.link.alive(heard.ended):
        return Finding.of("link", unheard(url, heard.link, heard.ended - (heard.link.heard or 0.0)))
    if heard.link.crowded(heard.ended):
        others = ", ".join(map(str, sorted(heard.link.others))) or str(system)
        hint = "stop the other autopilot, or set the MAVLink system id of this robot's autopilot in `system`"
        return Finding("link", "fail", f"another autopilot (system {others}) sends to {url}", "one autopilot", hint)
    also = f"; also heard: {', '.join(map(str, sorted(heard.link.others)))}" if heard.link.others else ""
    return Finding("link", "ok", f"autopilot on {url}, system {system}{also}")


def _version(what: str, heard: Heard) -> Finding:
    message = heard.newest.get(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    if message is None:
        return Finding(
            "firmware", "warn", f"{what} of unknown version", "a version", "check whether the link loses messages"
        )
    version = ".".join(str(message.flight_sw_version >> shift & 0xFF) for shift in (24, 16, 8))
    kind = message.flight_sw_version & 0xFF
    version += "" if kind == RELEASE else _TYPES[kind & 0xC0]
    return Finding("firmware", "ok", f"{what} {version}, in {heard.telemetry.mode_name}")


def _parameters(heard: Heard) -> list[Finding]:
    """Return one finding for each parameter that differs from its wanted value."""
    if heard.parameters is None:
        return []
    wrong = heard.parameters.differences
    if not wrong:
        return [Finding("parameters", "ok", f"all {len(heard.parameters.readings)} checked parameters are right")]
    return [
        Finding(
            r.name, "fail" if r.wanted.vital else "warn", "does not answer" if r.found is None else f"{r.found:g}",
            r.expected, f"{r.wanted.why}; set the parameter by a ground station",
        )
        for r in wrong
    ]  # fmt: skip


def _rival(heard: Heard) -> list[Finding]:
    return [Finding("failsafe", "warn", RIVAL)] if math.isfinite(heard.link.rival) else []


def _armed(heard: Heard) -> list[Finding]:
    if not heard.telemetry.armed:
        return []
    state = "flying" if heard.telemetry.flying else "armed"
    return [Finding("state", "warn", state, "disarmed, on the ground", "disarm it, the agent arms it")]


def _estimate(heard: Heard) -> Finding:
    """Check the flags and the largest innovation test ratio of the state estimator (EKF).

    The flags have the same bits in ArduPilot's EKF_STATUS_REPORT and PX4's ESTIMATOR_STATUS."""
    report = heard.newest.get(mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT)
    report = report or heard.newest.get(mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS)
    if heard.telemetry.position is None:
        hint = "the estimate takes about 45 s from power-up, and needs a positioning source that works"
        flags = "no report of the EKF" if report is None else f"EKF flags {report.flags:#x}"
        return Finding("estimate", "fail", f"no position estimate yet: {flags}", f"a position in {DEADLINE:g} s", hint)
    if report is None:  # unexpected: `Telemetry` accepts a position only after an EKF report
        return Finding("estimate", "warn", "no report of the EKF", "5 reports a second", "check for a lossy link")
    lacking = [name for flag, name in _FLAGS.items() if not report.flags & flag]
    if lacking:
        return Finding(
            "estimate", "fail", f"the EKF lacks {', '.join(lacking)}", why="calibrate the sensors, wait, or reboot"
        )
    worst, name = max(_disagreements(report))
    told = f"EKF flags {report.flags:#x}, largest innovation {worst:.2f} of its limit: {name}"
    if not worst < 0.5:  # true also if `worst` is NaN
        hint = f"the sensors disagree about {name}; at the limit, the autopilot refuses to arm, or lands by itself"
        return Finding("estimate", "warn" if worst < 1.0 else "fail", told, "less than 0.5", hint)
    return Finding("estimate", "ok", told)


def _disagreements(report: Message) -> list[tuple[float, str]]:
    """Return the innovation test ratios, divided by the firmware's limits, and their names.

    ESTIMATOR_STATUS (PX4): the limit is 1, at which the EKF rejects the measurement. EKF_STATUS_REPORT (ArduPilot): the
    fields named variances contain test ratios (NavEKF3 getVariances), and the limit is that of the EKF failsafe."""
    if report.get_msgId() == mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS:
        ratios = report.vel_ratio, report.pos_horiz_ratio, report.pos_vert_ratio, report.mag_ratio
    else:
        variances = (
            report.velocity_variance, report.pos_horiz_variance, report.pos_vert_variance, report.compass_variance,
        )  # fmt: skip
        ratios = tuple(v / VARIANCE for v in variances)
    return list(zip(ratios, ("velocity", "horizontal position", "height", "compass"), strict=True))


def _place(heard: Heard, fence: Box, height: float) -> list[Finding]:
    p = heard.telemetry.position
    if p is None:
        return []
    fault = "" if heard.telemetry.flying else misplaced(fence, height, p)
    if fault:
        return [Finding("place", "fail", fault)]
    told = f"{coordinates(p)} m, inside the geofence, {height - p.z:.1f} m to climb"
    if abs(p.z) > LEVEL and not heard.telemetry.flying:
        hint = "the quad flies too low or too high over the ground by this height: check the fleet's origin's altitude"
        return [Finding("place", "warn", told, f"a ground within {LEVEL:g} m of z = 0", hint)]
    return [Finding("place", "ok", told)]


def _origin(heard: Heard, frame: LocalFrame) -> list[Finding]:
    """Check the distance of the EKF's origin from the fleet's origin.

    The EKF sets its origin to the place where the vehicle first knew its position."""
    message = heard.newest.get(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
    if message is None:
        return []
    x, y, z = frame.enu(message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
    away = math.hypot(x, y)
    told = f"the autopilot's origin is {away:.1f} m from the fleet's, {round(z, 1) + 0.0:+.1f} m in altitude"
    if max(away, abs(z)) > FAR_ORIGIN:
        hint = "check the fleet's origin; if it is right, restart the autopilot on the ground near this origin"
        return [Finding("origin", "warn", told, f"less than {FAR_ORIGIN:g} m", hint)]
    return [Finding("origin", "ok", told)]


def _streams(heard: Heard) -> Finding:
    firmware = heard.telemetry.firmware
    asked = {number: rate for number, rate in firmware.rates.items() if number not in firmware.occasional}
    told = ", ".join(f"{_name(n)} {heard.rate(n):.0f} of {rate:.0f}" for n, rate in asked.items())
    hint = "raise the link's baud rate, or end other programs that request streams from this autopilot"
    clock = heard.newest.get(mavlink.MAVLINK_MSG_ID_SYSTEM_TIME)
    if clock is not None and clock.time_boot_ms < STARTING * 1e3:
        hint = (
            f"the autopilot booted {clock.time_boot_ms / 1e3:.0f} s ago and is still starting: "
            f"check again {STARTING:g} s after its boot"
        )
    if any(heard.rate(number) < SLOW * rate for number, rate in asked.items()):
        return Finding("streams", "warn", f"{told} Hz", "the requested rates", hint)
    return Finding("streams", "ok", f"{told} Hz")


def _name(message: int) -> str:
    return str(mavlink.mavlink_map[message].msgname)


def _battery(heard: Heard) -> list[Finding]:
    """Check the battery voltage and charge in SYS_STATUS.

    Voltage: millivolts; 0 or 65535 means not measured. Charge: percent; -1 means not measured."""
    status = heard.newest.get(mavlink.MAVLINK_MSG_ID_SYS_STATUS)
    if status is None:
        return []
    if status.voltage_battery in (0, 65535):
        hint = "an empty battery stays unnoticed: set BATT_MONITOR and the BATT_ failsafes on the autopilot"
        return [Finding("battery", "warn", "not measured", why=hint)]
    volts, charge = f"{status.voltage_battery / 1e3:.1f} V", status.battery_remaining
    if charge < 0:
        return [Finding("battery", "ok", f"{volts}, charge not reported")]
    told = f"{volts}, {charge} %"
    if charge < CHARGE:
        state: State = "fail" if charge < LEAST_CHARGE else "warn"
        return [Finding("battery", state, told, f"a charge of {CHARGE} % or more", "charge it")]
    return [Finding("battery", "ok", told)]


def _clock(heard: Heard) -> list[Finding]:
    message = heard.newest.get(mavlink.MAVLINK_MSG_ID_SYSTEM_TIME)
    if message is None:
        return []
    up = f"up for {message.time_boot_ms / 1e3:.0f} s"
    if message.time_unix_usec == 0:
        return [Finding("boot", "ok", f"{up}, the autopilot does not know the time of day")]
    off = message.time_unix_usec * 1e-6 - heard.wall
    told = f"{up}, the autopilot's clock is {off:+.1f} s from this computer's"
    if abs(off) > CLOCKS:
        hint = "times in the logs of autopilot and agent do not match; set this computer's clock"
        return [Finding("boot", "warn", told, f"within {CLOCKS:g} s", hint)]
    return [Finding("boot", "ok", told)]


def _checks(heard: Heard) -> list[Finding]:
    """Return the autopilot's report of its own health.

    The report consists of the sensor health bits in SYS_STATUS, and of the autopilot's STATUSTEXT messages of pre-arm
    checks and warnings."""
    found = []
    texts = [text for _, severity, text in heard.link.texts if severity <= mavlink.MAV_SEVERITY_WARNING]
    refusals = list(dict.fromkeys(text for text in texts if text.startswith(_REFUSALS)))
    others = list(dict.fromkeys(text for text in texts if text not in refusals))
    status = heard.newest.get(mavlink.MAVLINK_MSG_ID_SYS_STATUS)
    failing = 0
    if status is not None:
        failing = (
            status.onboard_control_sensors_present
            & status.onboard_control_sensors_enabled
            & ~status.onboard_control_sensors_health
        )
    if sick := [name for flag, name in _SENSORS.items() if failing & flag]:
        found.append(
            Finding("sensors", "warn", f"not healthy: {', '.join(sick)}", "all", "calibrate or repair sensors")
        )
    if refusals or (failing & mavlink.MAV_SYS_STATUS_PREARM_CHECK and not heard.telemetry.armed):
        told = "; ".join(refusals) or "the autopilot's pre-arm checks fail, and it does not report which checks"
        found.append(Finding("checks", "fail", told, why="the autopilot will refuse to arm"))
    if others:
        found.append(Finding("says", "warn", "; ".join(others), why="these warnings come from the autopilot"))
    return found
