"""Parameters of an ArduPilot rover that matter when it is driven in MANUAL mode by overrides of RC channels.

WP_SPEED, CRUISE_SPEED, TURN_RADIUS and the gains of the rover's own controllers do not matter, because the rover does
not use them in MANUAL mode.

Two mechanisms stop a rover if the agent's computer dies. With a receiver, the overrides end after RC_OVERRIDE_TIME, and
the receiver controls the rover again. Without a receiver, the channels keep their values after the overrides end
(RC_Channels::read_input updates no channel), so only the failsafe for a lost ground station stops the rover.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from koordgen.runtime.vehicle.platform import Finding
from targets.car.base.settings import CarSettings
from targets.car.drive.throttle import DEAD_ZONE, NEUTRAL, SPAN
from targets.mavlink.link import GROUND_STATION
from targets.mavlink.parameters import Reading, Wanted

STEERING, THROTTLE = 1, 3  # numbers of the RC channels that are overridden
IGNORE_OVERRIDES = 2  # bit of RC_OPTIONS with which the rover ignores overrides
HOLD = 2  # value of FS_ACTION for the failsafe action Hold
SLOWEST = 2.0  # multiple of max_acceleration that the throttle's slew rate must allow


@dataclass(frozen=True, slots=True)
class Rule:
    """Rule for one parameter of the rover."""

    name: str
    right: Callable[[float], bool]  # whether a value of the parameter is right
    expected: str  # the right values, in words
    why: str  # consequence of a wrong value
    vital: bool = False  # whether the check fails with a wrong value; otherwise it warns
    older: tuple[str, ...] = ()  # names of the parameter in older versions of ArduPilot
    optional: bool = False  # whether older versions lack the parameter but behave as required

    @property
    def wanted(self) -> Wanted:
        """Return the parameter to read from the rover."""
        return Wanted(self.name, self.older, (), self.why, self.vital)

    def judged(self, reading: Reading) -> Finding | None:
        """Return the failed check or the warning for a wrong value; None if the value is right."""
        if reading.found is None and self.optional:
            return None
        if reading.found is not None and self.right(reading.found):
            return None
        found = "does not answer" if reading.found is None else f"{reading.found:g}"
        why = f"{self.why}; set it by a ground station"
        return Finding(reading.name, "fail" if self.vital else "warn", found, self.expected, why)


def rules(settings: CarSettings, receiver: bool | None) -> tuple[Rule, ...]:
    """Return the rules for a car with these settings.

    `receiver`: whether the rover receives signals of a remote control; None if unknown."""
    return (
        _one(
            "MAV_GCS_SYSID", GROUND_STATION, "with another value, the rover ignores the agent's overrides", True,
            ("SYSID_MYGCS",),
        ),
        Rule(
            "RC_OPTIONS", lambda v: not int(v) & IGNORE_OVERRIDES, f"a number without the bit {IGNORE_OVERRIDES}",
            "with this bit set, the rover ignores overrides and does not drive", vital=True,
        ),
        _one("RCMAP_ROLL", STEERING, "with another value, the agent's steering goes to another channel", True),
        _one("RCMAP_THROTTLE", THROTTLE, "with another value, the agent's throttle goes to another channel", True),
        _one(
            "FS_GCS_ENABLE", 1,
            "with another value, a rover without a receiver drives on when the agent's computer dies", True,
        ),
        _one("FS_ACTION", HOLD, "Hold stops the rover when the agent's computer dies", True),
        _within("FS_GCS_TIMEOUT", 1.0, 2.0, "seconds from the agent's last heartbeat to Hold", optional=True),
        _within("RC_OVERRIDE_TIME", 0.2, 1.0, "seconds for which the rover drives on with the agent's last command"),
        *_failsafe(receiver),
        *(rule for channel in (STEERING, THROTTLE) for rule in _channel(channel)),
        _slew_rate(settings),
        _one(
            "MANUAL_OPTIONS", 0, "with another value, the wheels turn less at speed than the agent commands",
            optional=True,
        ),
        _one(
            "MANUAL_STR_EXPO", 0, "with another value, the wheels do not turn as far as the agent commands",
            optional=True,
        ),
        Rule(
            "PILOT_STEER_TYPE", lambda v: v in (0, 2), "0 or 2",
            "with another value, steering is mixed with the throttle, or inverted in reverse",
        ),
    )  # fmt: skip


def checks(settings: CarSettings, receiver: bool | None, readings: tuple[Reading, ...]) -> list[Finding]:
    """Return one check result for each wrong parameter, vital parameters first.

    `readings`: the parameters that were read; a rule whose parameter is missing is left out."""
    by_name = {reading.wanted.name: reading for reading in readings}
    checked = [rule for rule in rules(settings, receiver) if rule.name in by_name]
    wrong = [found for rule in checked if (found := rule.judged(by_name[rule.name]))]
    if not wrong:
        return [Finding("parameters", "ok", f"all {len(checked)} that matter are right")]
    return sorted(wrong, key=lambda found: found.state != "fail")


def _one(
    name: str, value: float, why: str, vital: bool = False, older: tuple[str, ...] = (), optional: bool = False
) -> Rule:
    return Rule(name, lambda found: found == value, f"{value:g}", why, vital, older, optional)


def _within(name: str, low: float, high: float, why: str, optional: bool = False) -> Rule:
    close = 1e-6  # tolerance for rounding: ArduPilot stores parameters as floats with 24-bit mantissas
    return Rule(name, lambda v: low - close <= v <= high + close, f"{low:g} to {high:g}", why, optional=optional)


def _failsafe(receiver: bool | None) -> tuple[Rule, ...]:
    if receiver is None:
        return ()
    if receiver:
        return (
            Rule(
                "FS_THR_ENABLE",
                lambda v: v > 0,
                "1",
                "with another value, nothing happens when the remote control is lost",
            ),
        )
    return (
        _one(
            "FS_THR_ENABLE",
            0,
            "with another value, a rover without a receiver is in its failsafe until the agent sends",
        ),
    )


def _channel(number: int) -> tuple[Rule, ...]:
    why = "with another value, the wheels and the motor do less or more than the agent commands"
    ends = (("MIN", NEUTRAL - SPAN), ("TRIM", NEUTRAL), ("MAX", NEUTRAL + SPAN), ("DZ", DEAD_ZONE))
    reversed_ = _one(
        f"RC{number}_REVERSED", 0, "with another value, the rover turns or drives backwards: use SERVOn_REVERSED"
    )
    return (*(_one(f"RC{number}_{end}", value, why) for end, value in ends), reversed_)


def _slew_rate(settings: CarSettings) -> Rule:
    least = math.ceil(100.0 * SLOWEST * settings.max_acceleration / settings.full_speed)
    return Rule(
        "MOT_SLEWRATE", lambda v: v == 0 or v >= least, f"0, or {least} or more",
        "% of the throttle in a second; with a lower value, the motor lags behind the agent's commands",
    )  # fmt: skip
