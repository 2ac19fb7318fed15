"""ArduPilot's copter. Facts as observed on 4.7; names of parameters as in 4.7 and before."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.mavlink.parameters import Wanted
from targets.quad.autopilot.firmware import Firmware

MODES = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE", 9: "LAND",
    11: "DRIFT", 13: "SPORT", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 20: "GUIDED_NOGPS", 21: "SMART_RTL",
}  # fmt: skip
# flight_sw_version is major, minor, patch and type (0: development, 64: alpha, 128: beta, 192: candidate, 255:
# release). It does not tell which builds before the release of 4.7.0 have the fix:
# github.com/ArduPilot/ardupilot/pull/31351
SPINNING = (4 << 24 | 7 << 16, 4 << 24 | 7 << 16 | 254)
SPINS = "else a build of this version may spin in flight without a receiver (ArduPilot issue 31353)"
PARAMETERS = (
    Wanted("FS_GCS_ENABLE", (), (5,), "else it does not land when the agent dies", vital=True),
    Wanted("MAV_GCS_SYSID", ("SYSID_MYGCS",), (255,), "else the agent's heartbeats do not count", vital=True),
    Wanted("FS_GCS_TIMEOUT", (), (5, 4, 3, 2), "seconds from the agent's last heartbeat to the landing"),
    Wanted("FS_THR_ENABLE", (), (0,), "else it does not fly without a remote control"),
    Wanted("LAND_REPOSITION", (), (0,), "else it waits for a pilot after landing, and does not disarm"),
    Wanted("GUID_TIMEOUT", (), (3,), "seconds for which it runs on when setpoints with a velocity cease"),
    Wanted("GUID_OPTIONS", (), (4,), SPINS, bits=True, versions=SPINNING),
)
_NO_OWN = (
    Wanted("GPS1_TYPE", ("GPS_TYPE",), (0,), "else it looks for a GPS"),
    Wanted("COMPASS_ENABLE", (), (0,), "else the compass is believed, which iron indoors misleads"),
    Wanted("VISO_TYPE", (), (1,), "else it does not take poses over MAVLink; it takes effect when it boots"),
    Wanted("EK3_SRC1_POSXY", (), (6,), "else its position is not the feed's"),
    Wanted("EK3_SRC1_POSZ", (), (6,), "else its height is not the feed's"),
    Wanted("EK3_SRC1_YAW", (), (6,), "else its heading is not the feed's"),
)
POSITIONING = {
    "gps_input": (
        Wanted("GPS1_TYPE", ("GPS_TYPE",), (14,), "else it does not take positions over MAVLink"),
        Wanted("GPS1_DELAY_MS", ("GPS_DELAY_MS",), (50,), "the default lets it err by 0.08 m instead of 0.02 m"),
        Wanted("EK3_SRC1_POSXY", (), (3,), "else its position is not the feed's"),
        Wanted("EK3_SRC1_VELXY", (), (3,), "else its velocity is not the feed's"),
        Wanted("EK3_SRC1_POSZ", (), (3,), "else its height is not the feed's"),
        Wanted("EK3_SRC1_VELZ", (), (3,), "else its climb is not the feed's"),
        Wanted("EK3_SRC1_YAW", (), (2, 3), "else its heading is not the feed's"),
    ),
    "vision": (
        *_NO_OWN,
        Wanted("EK3_SRC1_VELXY", (), (0,), "else it waits for a velocity that is not sent, or for a GPS"),
        Wanted("EK3_SRC1_VELZ", (), (0,), "else it waits for a velocity that is not sent, or for a GPS"),
    ),
    "odometry": (
        *_NO_OWN,
        Wanted("EK3_SRC1_VELXY", (), (6, 0), "else it waits for a GPS"),
        Wanted("EK3_SRC1_VELZ", (), (6, 0), "else it waits for a GPS"),
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
        # The target in global coordinates is told for position-only setpoints alone, the local one for all.
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 5.0,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: 4.0,  # it carries the mode, so it is wanted more often than it comes
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    },
    # The first comes only while there is a target, the second always, only too seldom; nobody flies by the third.
    occasional=(
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    ),
    parameters=PARAMETERS,
    positioning=POSITIONING,
    bytewise=False,
)
