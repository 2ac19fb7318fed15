"""Facts in which the firmwares ArduPilot and PX4 differ, as data with one instance per firmware."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from targets.mavlink.parameters import Wanted


@dataclass(frozen=True, slots=True)
class Firmware:
    """Facts of one firmware. Flight modes are numbers as in HEARTBEAT.custom_mode.

    Setpoints are no part of these facts: each firmware accepts SET_POSITION_TARGET_GLOBAL_INT in frame 5
    (MAV_FRAME_GLOBAL_INT, altitudes AMSL)."""

    name: str
    modes: Mapping[int, str]  # names of the flight modes
    follows: int  # the mode in which the vehicle follows setpoints
    lands: int  # the mode in which the vehicle lands where it is
    returns: tuple[int, ...]  # other modes that end on the ground without further commands
    ask_mode: Callable[[int], tuple[float, ...]]  # the parameters of the command DO_SET_MODE for a mode
    rises: bool  # how the vehicle takes off: True: by rising setpoints, False: by the command NAV_TAKEOFF
    rates: Mapping[int, float]  # MAVLink message id -> requested rate, Hz
    occasional: tuple[int, ...]  # ids in `rates` of messages whose absence is no fault
    parameters: tuple[Wanted, ...]  # parameters that each flight depends on
    positioning: Mapping[str, tuple[Wanted, ...]]  # supported mode of external positioning -> its parameters
    bytewise: bool  # whether integer parameters are raw bytes, for an autopilot that does not report its encoding

    def mode(self, number: int | None) -> str:
        """Return the name of a flight mode; "no mode" for None."""
        return "no mode" if number is None else self.modes.get(number, f"mode {number}")
