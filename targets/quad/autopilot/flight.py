"""Flight state machine: controls a vehicle from its first heartbeat until it has landed and disarmed.

The state machine is polled, and uses one MAVLink link. Each command is repeated until telemetry shows its effect. If an
armed vehicle is in a flight mode that the agent did not request, a pilot or a failsafe has taken over. The agent then
does not take the vehicle back.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from typing import NoReturn

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Unready
from targets.mavlink.framing import Message
from targets.mavlink.link import RESULTS, Link
from targets.mavlink.parameters import Review, Wanted
from targets.quad.autopilot.check import RIVAL, misplaced, stranger, unheard
from targets.quad.autopilot.firmware import Firmware
from targets.quad.autopilot.telemetry import Streams, Telemetry
from targets.quad.autopilot.vehicles import identified

SILENCE = 30.0  # seconds without a heartbeat after which the vehicle counts as lost for good
AT_HEIGHT = 0.3  # metres below the flight height at which the climb counts as complete

# If the vehicle is disarmed before the take-off within this time (s) after arming, a person or a failsafe has disarmed
# it. ArduPilot itself disarms a vehicle that does not take off only after 10 s (DISARM_DELAY).
BY_HAND = 5.0
BLIND = 3.0  # seconds without a position estimate after which a climb is aborted
STILL = 0.1  # m/s; a slower vehicle in LAND mode counts as touched down
QUIET = 0.4  # seconds without any message, in flight, after which `progress` reports that the link is silent

# Seconds for which setpoints are sent before the mode that follows them is requested: PX4 leaves OFFBOARD without them.
CALLING = 1.0
CLIMB, RISING = 0.5, 0.8  # take-off setpoints rise at CLIMB (m/s), or at RISING times the climb limit if that is less
CLIMB_SPEED = 2  # SPEED_TYPE_CLIMB_SPEED of DO_CHANGE_SPEED
ASKED = 4  # requests for a climb limit; if all are refused or unanswered, the vehicle takes off without the limit
DISARM_AFTER = 5.0  # seconds on the ground after which the agent disarms, if the autopilot's LAND mode does not
COMMANDS = (
    mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_DO_CHANGE_SPEED,
    mavlink.MAV_CMD_NAV_TAKEOFF,
)  # fmt: skip
_ON_GROUND = mavlink.MAV_LANDED_STATE_ON_GROUND


class FlightPhase(enum.Enum):
    """Phases of a flight, in their order."""

    CONNECTING = enum.auto()
    ESTIMATING = enum.auto()
    SWITCHING = enum.auto()
    ARMING = enum.auto()
    CLIMBING = enum.auto()
    FLYING = enum.auto()
    LANDING = enum.auto()
    STOPPED = enum.auto()


class Flight:
    """Take-off and landing of one vehicle, and supervision of its flight.

    `height`: flight height to climb to, m in the fleet's ENU frame.
    `climb`: limit of the climb rate, m/s.
    `go_to`: function that sends a position setpoint.
    `wanted`: function that returns the autopilot parameters that a flight with this firmware depends on.
    """

    def __init__(
        self, url: str, link: Link, telemetry: Telemetry, fence: Box, height: float, climb: float,
        go_to: Callable[[Point], None], wanted: Callable[[Firmware], tuple[Wanted, ...]], now: float,
    ) -> None:  # fmt: skip
        self._url, self._link, self._telemetry = url, link, telemetry
        self._fence, self._height, self._climbing = fence, height, climb
        self._go_to, self._wanted = go_to, wanted
        self._firmware = telemetry.firmware
        self._review = Review((), bytewise=False)
        self._rivalled = False  # whether the log has warned of another ground station with the agent's system id
        self._setpoint: Point | None = None  # last take-off setpoint, for a firmware that takes off by rising setpoints
        self.grounded = False  # whether the vehicle must not take off now
        self.withheld = ""  # reason in words why the positioning forbids the take-off; "" if it allows the take-off
        self.heard: list[Message] = []  # messages of the vehicle that the last poll received
        self._streams = Streams()
        self._since = now  # time at which the present phase began
        self._begun = self._now = self._polled = now
        self._restarts = 0
        self._climb_from = 0.0  # m, height at which the climb began
        self._unlimited = ""  # warning that the autopilot did not accept the climb limit; "" if it did
        self._airborne = False  # whether the vehicle has left the ground, so that the take-off is not restarted
        self._landing_seen = False  # whether a heartbeat has shown a landing mode since the agent began to land
        self._grounded: float | None = None  # time since which the landing vehicle seems to be on the ground
        self._taken = False  # whether a pilot or a failsafe has taken over the vehicle
        self.phase = FlightPhase.CONNECTING
        self._doing = f"waiting for a heartbeat on {url}"

    @property
    def progress(self) -> str:
        """Present activity for the log, with the autopilot's reason if it refuses a command."""
        if self.phase is FlightPhase.STOPPED or self._link.heard is None:
            return self._doing
        if not self._link.alive(self._now):
            return f"no heartbeat on {self._url}; was {self._doing}"
        silent = self._airborne and self._link.spoke is not None and self._now - self._link.spoke > QUIET
        return f"nothing comes on {self._url}; was {self._doing}" if silent else self._doing

    def poll(self, now: float) -> None:
        """Process the messages received, supervise the vehicle, and send the next command. Raises Unready."""
        self._polled, self._now = self._now, now
        self.heard = self._link.receive(now)
        for message in self.heard:
            self._streams.note(message.get_msgId(), now)
            self._telemetry.update(message, now)
            self._review.handle(message)
        self._link.greet(now)
        if self.phase is not FlightPhase.STOPPED:
            self._watch(now)
        if self.phase is not FlightPhase.CONNECTING:
            self._streams.poll(self._link, self._firmware, now)
        match self.phase:
            case FlightPhase.CONNECTING:
                self._connect(now)
            case FlightPhase.ESTIMATING:
                self._estimate(now)
            case FlightPhase.SWITCHING:
                self._switch(now)
            case FlightPhase.ARMING:
                self._arm(now)
            case FlightPhase.CLIMBING:
                self._climb(now)
            case FlightPhase.FLYING:
                self._fly(now)
            case FlightPhase.LANDING:
                self._land(now)
            case FlightPhase.STOPPED:
                pass

    def _enter(self, phase: FlightPhase, now: float, progress: str) -> None:
        self.phase, self._since, self._doing = phase, now, progress
        for command in COMMANDS:
            self._link.forget(command)

    def _watch(self, now: float) -> None:
        """React to a silent link and to a restart of the autopilot, in any phase. Raises Unready."""
        silent = now - (self._begun if self._link.heard is None else self._link.heard)
        if silent > SILENCE:
            raise unheard(self._url, self._link, silent)
        if self._telemetry.restarts != self._restarts:
            self._restarts = self._telemetry.restarts
            self._streams.restart()
            if self._airborne and self.phase is not FlightPhase.LANDING:
                raise Unready("the autopilot restarted in flight")
            if self.phase in (FlightPhase.ESTIMATING, FlightPhase.SWITCHING, FlightPhase.ARMING, FlightPhase.CLIMBING):
                self._read_parameters()
                self._enter(FlightPhase.ESTIMATING, now, "the autopilot restarted; waiting for its position estimate")

    def _connect(self, now: float) -> None:
        if self._link.vehicle is None:
            return
        what, firmware = identified(self._link)
        if firmware is None:
            raise stranger(self._url, what)
        self._firmware = self._telemetry.firmware = firmware
        self._read_parameters()
        self._enter(FlightPhase.ESTIMATING, now, f"{what}: waiting for its position estimate")

    def _read_parameters(self) -> None:
        self._review = Review(self._wanted(self._firmware), self._firmware.bytewise)

    def _estimate(self, now: float) -> None:
        state = self._telemetry
        self._review.poll(self._link, now)
        told = None not in (state.yaw, state.landed, state.mode)
        if state.position is None or not state.fresh(now) or not told:
            if differing := self._review.unreported():  # a wrong parameter may be the reason for the missing estimate
                self._doing = f"waiting for the autopilot's position estimate; {differing}"
            return
        if self._link.crowded(now):
            others = ", ".join(map(str, sorted(self._link.others)))
            self._doing = (
                f"another autopilot{f' (system {others})' if others else ''} sends to {self._url}: stop it, or set the "
                "MAVLink system id of this robot's autopilot in `system`"
            )
        elif state.flying:
            self._take_over(now)
        elif fault := self.withheld or misplaced(self._fence, self._height, state.position) or self._review.forbids:
            self._doing = f"not taking off: {fault}"
        elif not self._review.known:
            self._doing = "reading the autopilot's parameters"
        elif differing := self._review.unreported():
            self._doing = differing
        elif self._link.rivalled(now) and not self._rivalled:
            self._rivalled, self._doing = True, RIVAL
        elif self.grounded:
            self._doing = "ready to take off, waiting for the fleet"
        else:
            self._setpoint = None
            self._enter(FlightPhase.SWITCHING, now, f"switching to {self._firmware.mode(self._firmware.follows)}")

    def _take_over(self, now: float) -> None:
        """Take over a vehicle that flies already, for example after the agent's process was restarted.

        A vehicle that follows setpoints is taken over. If the vehicle is landing, the agent waits until it is on the
        ground. In any other mode, raises Unready."""
        state = self._telemetry
        if state.mode == self._firmware.follows:
            self._enter(FlightPhase.FLYING, now, "the vehicle flies already: taking over without a take-off")
        elif self._ends_itself:
            self._doing = f"already flying in {state.mode_name}: waiting until it has landed"
        else:
            wanted = self._firmware.mode(self._firmware.follows)
            raise Unready(f"already flying in {state.mode_name}", f"land the vehicle first, or switch it to {wanted}")

    @property
    def _ends_itself(self) -> bool:
        """Return whether the vehicle's flight mode ends on the ground without further commands."""
        return self._telemetry.mode == self._firmware.lands or self._telemetry.mode in self._firmware.returns

    def _switch(self, now: float) -> None:
        self._call()
        if self._telemetry.mode == self._firmware.follows and self._telemetry.mode_time > self._since:
            self._enter(FlightPhase.ARMING, now, "arming")
        elif not self._firmware.rises or now - self._since >= CALLING:
            asked = self._set_mode(self._firmware.follows, now)
            if asked > 1:
                doing = f"switching to {self._firmware.mode(self._firmware.follows)}"
                self._doing = self._explained(doing, mavlink.MAV_CMD_DO_SET_MODE, now)

    def _call(self) -> None:
        """Send setpoints on the ground, if the firmware takes off by rising setpoints (PX4).

        PX4 stays in OFFBOARD mode only while setpoints arrive. The setpoint is 0.2 m below the vehicle, so that an
        error of the position estimate cannot command a take-off."""
        if self._firmware.rises and self._telemetry.position is not None:
            self._setpoint = self._telemetry.position + Point(0.0, 0.0, -0.2)
            self._go_to(self._setpoint)

    def _lift(self, seconds: float) -> None:
        """Raise the take-off setpoint as far as the vehicle climbs in `seconds`, if its position is fresh."""
        if self._setpoint is not None and self._telemetry.fresh(self._now):
            p, rate = self._setpoint, min(CLIMB, RISING * self._climbing)
            self._setpoint = Point(p.x, p.y, max(p.z, min(p.z + rate * seconds, self._height)))
            self._go_to(self._setpoint)

    def _arm(self, now: float) -> None:
        self._call()
        if self._telemetry.mode != self._firmware.follows:
            self._enter(
                FlightPhase.SWITCHING, now, f"the autopilot fell back to {self._telemetry.mode_name}; switching again"
            )
        elif self._telemetry.armed:
            self._enter(FlightPhase.CLIMBING, now, "taking off")
        else:
            self._link.ask(now, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, every=2.0)
            self._doing = self._explained("arming", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, now)

    def _climb(self, now: float) -> None:
        state = self._telemetry
        self._lift(now - self._polled)
        if not state.armed and not self._airborne:
            said = self._link.reasons(self._since)
            words = f"disarmed before take-off{': ' if said else ''}{said}"
            if now - self._since < BY_HAND:
                raise Unready(words, "a person or a failsafe has acted; check the vehicle and restart the agent")
            self._enter(FlightPhase.ARMING, now, f"{words}; arming again")
        elif self._airborne:
            self._rise(now)
        elif state.mode != self._firmware.follows:
            self._leave_to_them()
        elif state.position is None or not state.fresh(now) or state.time is None or state.time < self._since + 0.3:
            pass  # wait for a newer position: arming has just moved home, and the take-off height is relative to home
        elif state.flying:
            self._airborne = True
        elif self._firmware.rises:
            self._climb_from = state.position.z
            self._doing = "taking off"
        elif self._climb_limited(now):
            self._climb_from = state.position.z
            # The height in NAV_TAKEOFF is relative to home. The height of home is the difference between the altitude
            # AMSL and the height above home in one GLOBAL_POSITION_INT.
            above_home = self._height - state.position.z + state.relative
            self._link.ask(now, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, above_home, every=2.0)
            self._doing = self._explained("taking off", mavlink.MAV_CMD_NAV_TAKEOFF, now)

    def _climb_limited(self, now: float) -> bool:
        """Request ArduPilot to limit its climb speed. Return True once it accepted, or after ASKED requests.

        The limit holds for this take-off only. Without the limit, ArduPilot climbs at up to WP_SPD_UP (2.5 m/s by
        default), or slower if the climb is short."""
        asked = self._link.ask(now, mavlink.MAV_CMD_DO_CHANGE_SPEED, CLIMB_SPEED, self._climbing, -1.0, every=0.5)
        if asked.result == mavlink.MAV_RESULT_ACCEPTED:
            self._unlimited = ""
            return True
        self._unlimited = f"; the autopilot does not limit its climb to {self._climbing:g} m/s"
        return asked.times >= ASKED

    def _rise(self, now: float) -> None:
        state = self._telemetry
        self._keep(now)
        self._doing = f"climbing to {self._height:g} m{self._unlimited}"
        if state.position is None or not state.fresh(now):
            lost = now - (state.time or self._since)
            if lost > BLIND:
                raise Unready(f"no position for {lost:.1f} s while climbing", "check the positioning source")
            return
        height, climb = state.position.z, self._height - self._climb_from
        stopped = abs(state.velocity.z) < STILL and height - self._climb_from > 0.5 * climb
        if height > self._height - min(AT_HEIGHT, 0.2 * climb) or stopped:
            self._enter(FlightPhase.FLYING, now, "flying")

    def _fly(self, now: float) -> None:
        self._keep(now)
        self._airborne = True
        self._doing = "flying"

    def _keep(self, now: float) -> None:
        """Raise Unready if the vehicle in the air is disarmed, or in a mode that the agent did not request."""
        if not self._telemetry.armed:
            said = self._link.reasons(now - 10.0)
            raise Unready(f"the autopilot disarmed in flight{': ' if said else ''}{said}")
        if self._telemetry.mode != self._firmware.follows:
            self._leave_to_them()

    def _leave_to_them(self) -> NoReturn:
        self._taken = True
        raise Unready(
            f"the autopilot is in {self._telemetry.mode_name}: a pilot or a failsafe took over",
            "the agent sends the vehicle no more commands",
        )

    def stop(self, now: float) -> None:
        """Begin to land. Idempotent.

        A vehicle that the agent never commanded is not landed, because it may be no copter, or a pilot may fly it.
        Exception: a flying vehicle in the mode that follows setpoints is landed, because its agent process has died."""
        state = self._telemetry
        orphan = state.flying and state.mode == self._firmware.follows and not self._link.crowded(now)
        if self.phase is FlightPhase.CONNECTING or (self.phase is FlightPhase.ESTIMATING and not orphan):
            self._enter(FlightPhase.STOPPED, now, "nothing was moved")
        elif self.phase is not FlightPhase.STOPPED and self.phase is not FlightPhase.LANDING:
            self._enter(FlightPhase.LANDING, now, "landing")

    def _land(self, now: float) -> None:
        state = self._telemetry
        # An arming command may still be in transit. So only a heartbeat that arrives 1 s or more after the beginning of
        # the landing proves that the vehicle is disarmed.
        if not state.armed and state.mode_time > self._since + 1.0:
            self._enter(FlightPhase.STOPPED, now, "at rest, disarmed")
            return
        ends_itself, lands = self._ends_itself, self._firmware.lands
        if self._landing_seen and not ends_itself:
            self._taken = True
        if self._taken and not ends_itself:
            self._enter(FlightPhase.STOPPED, now, f"left to the pilot or failsafe that switched to {state.mode_name}")
            return
        if ends_itself:
            self._landing_seen = True
            self._link.forget(mavlink.MAV_CMD_DO_SET_MODE)
            self._doing = "landing"
        else:
            self._set_mode(lands, now)
            self._doing = self._explained("switching to LAND", mavlink.MAV_CMD_DO_SET_MODE, now)
        self._touch_down(now)

    def _touch_down(self, now: float) -> None:
        """Disarm a vehicle that has been on the ground for DISARM_AFTER seconds and is still armed.

        Without a remote control, ArduPilot's LAND mode may wait forever before it disarms (LAND_REPOSITION). The
        command to disarm has no force flag, so the autopilot refuses it in flight."""
        state = self._telemetry
        down = state.landed == _ON_GROUND
        if state.mode == self._firmware.lands and state.fresh(now):
            down |= math.hypot(state.velocity.x, state.velocity.y, state.velocity.z) < STILL
        if not down:
            self._grounded = None
            return
        self._grounded = now if self._grounded is None else self._grounded
        if now - self._grounded > DISARM_AFTER:
            self._link.ask(now, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
            self._doing = self._explained(
                "on the ground but still armed: disarming", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, now
            )

    def _set_mode(self, mode: int, now: float) -> int:
        """Request a flight mode. Return how often the request was sent in this phase."""
        return self._link.ask(now, mavlink.MAV_CMD_DO_SET_MODE, *self._firmware.ask_mode(mode)).times

    def _explained(self, doing: str, command: int, now: float) -> str:
        """Return the activity `doing` for the log; if the autopilot refuses `command`, with its reasons."""
        asked = self._link.asked(command)
        if asked is None or (asked.result is None and asked.times < 3):
            return doing
        if asked.result == mavlink.MAV_RESULT_ACCEPTED:
            return doing
        answer = "no answer" if asked.result is None else RESULTS.get(asked.result, f"result {asked.result}")
        said = self._link.reasons(max(self._since, now - 35.0))  # ArduPilot repeats its pre-arm faults every 30 s
        return f"{doing}: {answer}{': ' if said else ''}{said}"
