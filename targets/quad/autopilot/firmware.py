"""What one autopilot's firmware does otherwise than another's: facts, no behaviour. One instance for each kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from targets.mavlink.parameters import Wanted


@dataclass(frozen=True, slots=True)
class Firmware:
    """Modes are numbers as HEARTBEAT.custom_mode has them. All of them take SET_POSITION_TARGET_GLOBAL_INT in frame 5
    (heights AMSL), so a setpoint is the same message for each."""

    name: str
    modes: Mapping[int, str]
    follows: int  # the mode in which it follows setpoints
    lands: int
    returns: tuple[int, ...]  # modes that like `lands` end on the ground by themselves
    ask_mode: Callable[[int], tuple[float, ...]]  # the parameters of DO_SET_MODE
    rises: bool  # takes off by setpoints that rise, which flow before it follows and from then on; else by NAV_TAKEOFF
    rates: Mapping[int, float]  # message -> how often it is wanted, Hz
    occasional: tuple[int, ...]  # of these, those whose absence proves nothing
    parameters: tuple[Wanted, ...]
    positioning: Mapping[str, tuple[Wanted, ...]]  # what it takes in place of a GPS of its own, and parameters for that
    bytewise: bool  # how it sends integer parameters, where it does not say

    def mode(self, number: int | None) -> str:
        """Return the mode's name."""
        return "no mode" if number is None else self.modes.get(number, f"mode {number}")
