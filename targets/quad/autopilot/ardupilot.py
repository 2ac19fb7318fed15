"""Firmware facts of ArduCopter (ArduPilot for multicopters), as observed on version 4.7.

Each parameter is listed by its name in version 4.7, followed by its name in older versions.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.mavlink.parameters import Wanted
from targets.quad.autopilot.firmware import Firmware

MODES = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE", 9: "LAND",
    11: "DRIFT", 13: "SPORT", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 20: "GUIDED_NOGPS", 21: "SMART_RTL",
}  # fmt: skip
# First and last AUTOPILOT_VERSION.flight_sw_version of the builds that may spin in flight: the pre-releases of 4.7.0.
# The version number has one byte each for major, minor, patch and type (0: development, 64: alpha, 128: beta, 192:
# release candidate, 255: release). The number does not show whether a build contains the fix,
# github.com/ArduPilot/ardupilot/pull/31351.
SPINNING = (4 << 24 | 7 << 16, 4 << 24 | 7 << 16 | 254)
SPINS = "else the vehicle may spin in flight without a radio receiver (ArduPilot issue 31353)"
PARAMETERS = (
    Wanted("FS_GCS_ENABLE", (), (5,), "else the vehicle does not land when the agent dies", vital=True),
    Wanted("MAV_GCS_SYSID", ("SYSID_MYGCS",), (255,), "else the autopilot ignores the agent's heartbeats", vital=True),
    Wanted("FS_GCS_TIMEOUT", (), (5, 4, 3, 2), "seconds from the agent's last heartbeat to the landing"),
    Wanted("FS_THR_ENABLE", (), (0,), "else the vehicle does not fly without a remote control"),
    Wanted("LAND_REPOSITION", (), (0,), "else the vehicle waits for a pilot after landing, and does not disarm"),
    Wanted("GUID_TIMEOUT", (), (3,), "seconds for which the vehicle keeps its velocity when setpoints cease"),
    Wanted("GUID_OPTIONS", (), (4,), SPINS, bits=True, versions=SPINNING),
)
_NO_OWN = (
    Wanted("GPS1_TYPE", ("GPS_TYPE",), (0,), "else the autopilot looks for a GPS"),
    Wanted("COMPASS_ENABLE", (), (0,), "else the EKF uses the compass, which iron indoors disturbs"),
    Wanted("VISO_TYPE", (), (1,), "else the autopilot ignores poses over MAVLink; takes effect at a reboot"),
    Wanted("EK3_SRC1_POSXY", (), (6,), "else the EKF does not use the position of the feed"),
    Wanted("EK3_SRC1_POSZ", (), (6,), "else the EKF does not use the height of the feed"),
    Wanted("EK3_SRC1_YAW", (), (6,), "else the EKF does not use the heading of the feed"),
)
POSITIONING = {
    "gps_input": (
        Wanted("GPS1_TYPE", ("GPS_TYPE",), (14,), "else the autopilot ignores positions over MAVLink"),
        Wanted("GPS1_DELAY_MS", ("GPS_DELAY_MS",), (50,), "the default causes position errors of 0.08 m, not 0.02 m"),
        Wanted("EK3_SRC1_POSXY", (), (3,), "else the EKF does not use the position of the feed"),
        Wanted("EK3_SRC1_VELXY", (), (3,), "else the EKF does not use the velocity of the feed"),
        Wanted("EK3_SRC1_POSZ", (), (3,), "else the EKF does not use the height of the feed"),
        Wanted("EK3_SRC1_VELZ", (), (3,), "else the EKF does not use the vertical velocity of the feed"),
        Wanted("EK3_SRC1_YAW", (), (2, 3), "else the EKF does not use the heading of the feed"),
    ),
    "vision": (
        *_NO_OWN,
        Wanted("EK3_SRC1_VELXY", (), (0,), "else the EKF waits for a velocity that is not sent, or for a GPS"),
        Wanted("EK3_SRC1_VELZ", (), (0,), "else the EKF waits for a velocity that is not sent, or for a GPS"),
    ),
    "odometry": (
        *_NO_OWN,
        Wanted("EK3_SRC1_VELXY", (), (6, 0), "else the EKF waits for a GPS"),
        Wanted("EK3_SRC1_VELZ", (), (6, 0), "else the EKF waits for a GPS"),
    ),
}
ARDUPILOT = Firmware(
    name="ArduPilot",
    modes=MODES,
    follows=4,
    lands=9,
    returns=(6, 21),
    ask_mode=lambda mode: (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mode),
    rises=False,
    rates={
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 20.0,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 5.0,
        # The setpoint in use is requested in the local frame. ArduPilot reports it in global coordinates only for
        # position-only setpoints, but in the local frame for all setpoints.
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 5.0,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: 4.0,  # more often than the default, because it carries the flight mode
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    },
    # Messages whose absence is no fault. The autopilot sends POSITION_TARGET_LOCAL_NED only while it has a setpoint. It
    # always sends HEARTBEAT, but without a request too seldom. SYS_STATUS is not used for control.
    occasional=(
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    ),
    parameters=PARAMETERS,
    positioning=POSITIONING,
    bytewise=False,
)
