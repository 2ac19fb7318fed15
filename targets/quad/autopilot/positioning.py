"""External positioning: authenticated poses from a base station, forwarded to the vehicle's autopilot.

Mode `gps_input` sends fixes as a GPS receiver does, 8 per second. Modes `vision` and `odometry` send poses, 20 per
second.

Autopilots notice only after 7 to 8 seconds that an external source has failed. So this module supervises the source:
its samples must be fresh and must not jump, and the autopilot's estimate must follow the samples. If a check fails, the
vehicle holds at once; if the failure lasts, the vehicle lands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Pose, distance
from koordgen.runtime.vehicle.datagrams import DatagramLink, waiting
from koordgen.runtime.vehicle.feed import Feed
from koordgen.runtime.vehicle.platform import Finding, Unready
from targets.mavlink.framing import Message
from targets.mavlink.link import Link
from targets.mavlink.parameters import Wanted
from targets.quad.autopilot.check import coordinates
from targets.quad.autopilot.external import gps_input, odometry, vision
from targets.quad.autopilot.firmware import Firmware
from targets.quad.autopilot.flight import Flight, FlightPhase
from targets.quad.autopilot.origin import Origin
from targets.quad.autopilot.telemetry import Telemetry
from targets.quad.autopilot.track import PositionTrack

PERIODS = {"gps_input": 0.125, "vision": 0.05, "odometry": 0.05}  # seconds between two messages to the autopilot
STALE = 0.3  # seconds; an older sample is not forwarded, and the vehicle holds
CLIMBING = 0.5  # seconds without a trustworthy position after which a climb is aborted
JUMPED = 1.0  # seconds in which all samples jumped, after which the source counts as failed
APART, LAG = 0.5, 0.2  # metres, seconds: estimate and source may differ by APART plus the distance flown in LAG
HEIGHT = 0.1  # metres by which the heights of estimate and source may differ before a take-off
FIRST_SAMPLE_TIMEOUT = 60.0  # seconds to wait for the first sample: a base station may be started after the robots
_JITTER = 0.005  # seconds by which a message may be sent before its time, because polls are not regular
LEAST_RATE = 15.0  # Hz; a source with a lower rate gets a warning in the pre-flight check
_IN_FLIGHT = (FlightPhase.SWITCHING, FlightPhase.ARMING, FlightPhase.CLIMBING, FlightPhase.FLYING)


class Positioning:
    """External position source of one vehicle, and its supervision. Poll it after the `Flight`.

    `vouched`: latest time (s on the agent's clock) at which source and estimate agreed; None if they never did.
    `doubt`: reason in words why the position may be wrong now; "" if no check fails.
    `held`: whether the vehicle must not move, because its position may be wrong.
    """

    def __init__(
        self, mode: str, setting: str, settings: Settings, key: bytes | None, frame: LocalFrame, max_speed: float,
        bind: Callable[[str], DatagramLink], wall: Callable[[], float],
    ) -> None:  # fmt: skip
        """Prepare the source without opening it.

        `bind` opens the port that `setting` names. `wall` returns the time of day, seconds since 1970."""
        self._mode, self._setting, self._frame, self._bind, self._wall = mode, setting, frame, bind, wall
        self._lost = settings.safety.position_lost
        self._feed = Feed(settings.robot, key, settings.application_id)
        self._track = PositionTrack(max_speed)
        o = settings.origin
        self._origin = Origin(frame, (o.latitude, o.longitude, o.altitude))
        self._datagrams: DatagramLink | None = None
        self._began = 0.0
        self._unix = 0.0  # s, time of day minus the agent's clock; read once, so that no jump of the time of day counts
        self._next = self._sent = -math.inf  # due time of the next message; time of the sample that was sent last
        self._taken = 0  # samples received since the port was opened
        self._carried = 0  # how often the vehicle was carried to another place on the ground
        self.vouched: float | None = None
        self.doubt = self._waiting()
        self.held = True

    def open(self, now: float) -> None:
        """Bind the port of the position feed, if it is not bound yet, and restart the counts. Raises Unready."""
        if self._datagrams is None:
            self._datagrams = self._bind(self._setting)
            self._feed.hear(self._datagrams)
        self._began, self._unix, self._taken = now, self._wall() - now, 0

    def log_lines(self) -> list[str]:
        """Return the log lines of the position feed since the last call."""
        return self._feed.log_lines()

    def close(self) -> None:
        """Close the port of the position feed. Idempotent."""
        if self._datagrams is not None:
            self._datagrams.close()
            self._datagrams = None

    def wanted(self, firmware: Firmware) -> tuple[Wanted, ...]:
        """Return the parameters that this positioning mode depends on.

        Raises Unready if the firmware does not support the mode."""
        if self._mode not in firmware.positioning:
            there_are = ", ".join(firmware.positioning)
            raise Unready(
                f"{firmware.name} does not support positioning {self._mode!r}", f"use one of: own, {there_are}"
            )
        return firmware.positioning[self._mode]

    def tried(self, now: float) -> list[Finding]:
        """Open the feed's port for the pre-flight check. Return the failed check, or [] if the port is open."""
        try:
            self.open(now)
        except Unready as error:
            return [Finding.of("feed", error)]
        return []

    def attend(self, link: Link, messages: Iterable[Message], now: float) -> None:
        """Process the vehicle's messages, and forward the source's samples to the autopilot."""
        for message in messages:
            self._origin.update(message)
        self._pass_on(link, now)

    def _pass_on(self, link: Link, now: float) -> None:
        """Receive the samples that have arrived, and send the newest one to the autopilot if a message is due."""
        for datagram in waiting(self._datagrams) if self._datagrams is not None else ():
            if self._feed.receive(datagram, now) and self._feed.pose is not None and self._feed.time is not None:
                self._taken += 1
                self._track.add(self._feed.pose, self._feed.time)
        track = self._track
        if self._mode != "gps_input":
            self._origin.poll(link, track.pose, now)
            if not self._origin.known:
                return
        fresh = track.time > self._sent and now - track.time <= STALE
        if link.vehicle is None or track.pose is None or not fresh or now < self._next - _JITTER:
            return
        self._next = max(self._next, now - PERIODS[self._mode]) + PERIODS[self._mode]
        self._sent = track.time
        link.send(self._message(link, track.pose))

    def _message(self, link: Link, pose: Pose) -> Message:
        track, ned, resets = self._track, self._origin.ned, self._origin.resets + self._carried
        match self._mode:
            case "gps_input":
                return gps_input(self._frame, pose, track.velocity, self._unix + track.time)
            case "vision":
                return vision(ned, pose, track.time, resets)
            case _:
                assert link.vehicle is not None
                return odometry(ned, pose, track.velocity, track.time, resets, link.vehicle.autopilot)

    def poll(self, link: Link, flight: Flight, state: Telemetry, now: float) -> None:
        """Forward the source's samples to the autopilot, and supervise the source.

        Raises Unready if the vehicle must not fly by this source any more."""
        self.attend(link, flight.heard, now)
        grounded = flight.phase in (FlightPhase.CONNECTING, FlightPhase.ESTIMATING)
        if grounded and self._track.refused(now) > JUMPED:
            self._track.forget()
            self._carried += 1
        self._judge(state, grounded and not state.flying, now)
        flight.withheld = self.doubt or (
            "" if self.vouched is not None else "the source has not confirmed the estimate"
        )
        if flight.phase in _IN_FLIGHT:
            self._give_up(flight.phase, now)
        elif grounded and self._feed.time is None and now - self._began > FIRST_SAMPLE_TIMEOUT:
            raise Unready(*self._feed.silent(self._setting, now - self._began))

    def _judge(self, state: Telemetry, grounded: bool, now: float) -> None:
        track = self._track
        self.doubt = self._waiting() if track.pose is None else ""
        if track.refused(now) > 0.0:
            self.doubt = "the position source jumped"
        elif track.pose is not None and now - track.time > STALE:
            self.doubt = f"no fresh position has arrived on {self._setting}"
        elif (off := self._apart(state)) is not None:
            v = track.velocity
            if off > APART + LAG * math.hypot(v.x, v.y, v.z):
                self.doubt = f"the autopilot's estimate is {off:.1f} m from the position source"
            elif grounded and (differing := self._heights(state)):
                self.doubt = differing
            else:
                self.vouched = track.time
        self.held = self.vouched is None or now - self.vouched > STALE

    def _apart(self, state: Telemetry) -> float | None:
        """Return the distance (m) between estimate and source at the time of the estimate; None if unknown."""
        there = self._track.at(state.time) if state.time is not None else None
        return distance(state.position, there) if state.position is not None and there is not None else None

    def _heights(self, state: Telemetry) -> str:
        """Return a reason against a take-off if the heights of estimate and source differ too much, else ""."""
        there = self._track.at(state.time) if state.time is not None else None
        if state.position is None or there is None or abs(up := state.position.z - there.z) <= HEIGHT:
            return ""
        side = "above" if up > 0 else "below"
        return (
            f"the autopilot's height is {abs(up):.2f} m {side} the position source's, more than {HEIGHT:g} m: "
            "restart the autopilot, so that the agent can set its origin anew"
        )

    def _give_up(self, phase: FlightPhase, now: float) -> None:
        jumped = self._track.refused(now)
        if jumped > JUMPED:
            hint = "check the motion capture system for mistaken bodies and lost markers; then restart the agent"
            raise Unready(f"position source jumped: all samples of the last {jumped:.1f} s were rejected", hint)
        unsure = now - (self._began if self.vouched is None else self.vouched)
        if unsure > (CLIMBING if phase is FlightPhase.CLIMBING else self._lost) and self.doubt:
            raise Unready(
                f"{self.doubt} for {unsure:.1f} s",
                "check the base station, its network, and the autopilot's parameters",
            )

    def _waiting(self) -> str:
        return f"waiting for the position feed on {self._setting}{self._feed.dropped}"

    def checks(self, state: Telemetry, now: float) -> list[Finding]:
        """Return the pre-flight checks of the source: rate, age and jumps of its samples.

        A further check compares the autopilot's estimate with the samples. Samples must have been forwarded for some
        seconds since `open`."""
        feed, seconds = self._feed, max(now - self._began, 0.1)
        if feed.pose is None:
            return [Finding.of("feed", Unready(*feed.silent(self._setting, seconds)))]
        rate, age = self._taken / seconds, now - self._track.time
        place = coordinates(feed.pose.position)
        found = f"{rate:.0f} Hz on {self._setting}, {age * 1e3:.0f} ms old: {place} m{feed.dropped}"
        if self._track.jumps:
            why = "jumps make the robot land in flight: check the markers and the base station's network"
            return [Finding("feed", "fail", f"{found}; {self._track.jumps} samples jumped", "none that jumps", why)]
        if age > STALE:
            why = "a silent feed makes the robot land in flight: check the base station and its network"
            return [Finding("feed", "fail", found, f"not older than {STALE * 1e3:.0f} ms", why)]
        if rate < LEAST_RATE:
            why = "the robot flies less exactly at this rate: raise the base station's rate"
            came = Finding("feed", "warn", found, f"a rate of {LEAST_RATE:g} Hz or more", why)
        else:
            came = Finding("feed", "ok", found)
        return [came, *self._followed(state)]

    def _followed(self, state: Telemetry) -> list[Finding]:
        """Check the distance of the estimate from the source; [] if the estimate or the source is unknown."""
        if (off := self._apart(state)) is None:
            return []
        told = f"the estimate is {off:.2f} m from the position source"
        if off > APART:
            why = "this prevents the take-off: check the fleet's origin and the autopilot's parameters for its source"
            return [Finding("followed", "fail", told, f"within {APART:g} m", why)]
        if not state.flying and (differing := self._heights(state)):
            why = "the quad would fly too low or too high by this difference"
            return [Finding("followed", "fail", differing, f"a height difference of at most {HEIGHT:g} m", why)]
        return [Finding("followed", "ok", told)]
