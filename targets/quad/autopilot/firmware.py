"""Firmware facts in which ArduPilot and PX4 differ: data without behaviour, one instance per firmware."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from targets.mavlink.parameters import Wanted


@dataclass(frozen=True, slots=True)
class Firmware:
    """Facts of one firmware. Flight modes are numbers as in HEARTBEAT.custom_mode.

    Each firmware accepts SET_POSITION_TARGET_GLOBAL_INT in frame 5 (MAV_FRAME_GLOBAL_INT, altitudes AMSL), so all of
    them are sent the same setpoints."""

    name: str
    modes: Mapping[int, str]  # names of the flight modes
    follows: int  # the mode in which the vehicle follows setpoints
    lands: int  # the mode in which it lands where it is
    returns: tuple[int, ...]  # other modes that end on the ground without further commands
    ask_mode: Callable[[int], tuple[float, ...]]  # the parameters of the command DO_SET_MODE for a mode
    rises: bool  # True: takes off by rising setpoints, sent from before the mode switch on. False: by NAV_TAKEOFF
    rates: Mapping[int, float]  # MAVLink message id -> requested rate, Hz
    occasional: tuple[int, ...]  # ids in `rates` of messages whose absence is no fault
    parameters: tuple[Wanted, ...]  # parameters that each flight depends on
    positioning: Mapping[str, tuple[Wanted, ...]]  # supported modes of external positioning, and their parameters
    bytewise: bool  # encoding of integer parameters as raw bytes, if the autopilot does not report its encoding

    def mode(self, number: int | None) -> str:
        """Return the mode's name."""
        return "no mode" if number is None else self.modes.get(number, f"mode {number}")
