"""Firmware facts of PX4 for multicopters, version 1.14 and later.

PX4 stays in OFFBOARD mode only while setpoints arrive at 2 Hz or more. PX4 reports the target of OFFBOARD mode in
POSITION_TARGET_LOCAL_NED; its POSITION_TARGET_GLOBAL_INT reports the target of a mission.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.mavlink.parameters import Wanted
from targets.quad.autopilot.firmware import Firmware


def custom_mode(main: int, sub: int = 0) -> int:
    """Return a PX4 main mode and sub-mode packed as in HEARTBEAT.custom_mode (px4_custom_mode.h)."""
    return main << 16 | sub << 24


OFFBOARD, LAND = custom_mode(6), custom_mode(4, 6)
MODES = {
    custom_mode(1): "MANUAL", custom_mode(2): "ALTITUDE", custom_mode(3): "POSITION", custom_mode(5): "ACRO",
    OFFBOARD: "OFFBOARD", custom_mode(7): "STABILIZED", custom_mode(4, 2): "TAKEOFF", custom_mode(4, 3): "HOLD",
    custom_mode(4, 4): "MISSION", custom_mode(4, 5): "RETURN", LAND: "LAND", custom_mode(4, 9): "PRECISION LAND",
}  # fmt: skip
PARAMETERS = (
    Wanted("COM_OBL_RC_ACT", (), (4,), "else the vehicle does not land when the agent dies", vital=True),
    Wanted("COM_OF_LOSS_T", (), (1, 0.5), "seconds from the agent's last setpoint to the landing"),
    Wanted("COM_RCL_EXCEPT", (), (4, 5, 6, 7), "else the vehicle does not fly OFFBOARD without a remote control"),
)
_NO_OWN = (
    Wanted("EKF2_HGT_REF", (), (3,), "else the EKF does not use the height of the feed"),
    Wanted("EKF2_GPS_CTRL", (), (0,), "else the EKF uses a GPS as well"),
    Wanted("EKF2_MAG_TYPE", (), (5,), "else the EKF uses the compass, which iron indoors disturbs"),
)
POSITIONING = {
    "vision": (Wanted("EKF2_EV_CTRL", (), (11,), "else the EKF does not use the poses of the feed"), *_NO_OWN),
    "odometry": (Wanted("EKF2_EV_CTRL", (), (15, 11), "else the EKF does not use the poses of the feed"), *_NO_OWN),
}
PX4 = Firmware(
    name="PX4",
    modes=MODES,
    follows=OFFBOARD,
    lands=LAND,
    returns=(custom_mode(4, 5), custom_mode(4, 9)),
    ask_mode=lambda mode: (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mode >> 16 & 0xFF, mode >> 24),
    rises=True,
    rates={
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 20.0,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20.0,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
        mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 5.0,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: 4.0,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    },
    occasional=(
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    ),
    parameters=PARAMETERS,
    positioning=POSITIONING,
    bytewise=True,
)
