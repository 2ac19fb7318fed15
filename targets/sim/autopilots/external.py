"""Device of a quad whose autopilot is a real ArduPilot that the user runs: simulates its vehicle.

ArduPilot takes its time from the states that it receives, so this device works in real time only. ArduPilot adopts the
rate at which states arrive (SIM_JSON.cpp), asks for 1 Hz more until it gets its SIM_RATE_HZ, and refuses to arm while
its gyro is slower than 1.8 x SCHED_LOOP_RATE. So each step of the world sends at least `LEAST_STATES` interpolated
states, after waiting until ArduPilot has answered the states of the previous step."""

from __future__ import annotations

import math
import select
import socket
from collections.abc import Mapping
from typing import Any, Protocol

from targets.sim.autopilots import json_link
from targets.sim.autopilots.json_link import Servos, VehicleState
from targets.sim.base.bodies import BodyState, DeviceContext
from targets.sim.base.ports import Port
from targets.sim.physics.world import GRAVITY, STEP, BodyMotion

LOOPBACK = "127.0.0.1"
MOST_AT_ONCE = 64  # frames read, or states sent, in one go
LEAST_STATES, MOST_STATES = 5, 16  # per step of the world: rates of 1200 and 3840 a second
FRAME_TIMEOUT = 0.1  # seconds of the host's clock that the world waits for a frame
RESEND_AFTER = 0.1  # seconds without a frame after which the state is sent again: a frame or a state was lost
MOTORS_OFF_AFTER = 0.5  # seconds without a frame after which the motors stop
FULL, EMPTY = 12.6, 10.5  # volts, three cells
CURRENT = 30.0  # amperes of all motors together at full thrust
# ArduCopter's quad X numbers its motors front right, rear left, front left, rear right. The body has another order.
BODY_ORDER = (2, 1, 3, 0)  # front left, rear left, rear right, front right
LOW, HIGH = 1000, 2000  # microseconds
EXPO = 0.65  # the thrust curve that ArduPilot assumes by default: MOT_THST_EXPO


class QuadrotorBody(Protocol):
    """Methods of a quadrotor body that this device uses."""

    def state(self) -> BodyState: ...

    def motion(self) -> BodyMotion: ...

    def motors(self, on: bool) -> None: ...

    def thrusts(self, shares: tuple[float, float, float, float]) -> None: ...


class WaitablePort(Port, Protocol):
    """Port that can wait for a datagram."""

    def wait(self, seconds: float) -> bool:
        """Wait at most `seconds` for a datagram. Return whether one has arrived."""
        ...


class ExternalAutopilot:
    """Device that connects a real ArduPilot to its simulated body.

    The agent talks to the autopilot directly, as its settings say. `resets` counts restarts of the autopilot, `lost`
    frames that never arrived, `dropped` datagrams that are no frames (wrong magic or length).

    A frame with the same count as the last one is a repetition: ArduPilot repeats a frame that got no answer. It is
    answered with the present state and has no other effect. A count lower than the last one means that the autopilot
    has restarted: the motors stop, and its time begins again."""

    def __init__(
        self, body: QuadrotorBody, context: DeviceContext, instance: int, link: WaitablePort | None = None
    ) -> None:
        """`instance` is ArduPilot's option -I. Raises OSError if its port is in use."""
        self._body, self._fault_state = body, context.fault_state
        self._link = link or Socket(json_link.PORT + json_link.PORT_STEP * instance)
        self.overrides: Mapping[str, Any] = {}
        self._last: Servos | None = None
        self._frame_at = self._sent_at = self._began = -math.inf
        self._unanswered = 0  # states that the autopilot has not yet answered
        self._is_answering = False  # whether it answered in time when the world last waited for it
        self._last_sent: VehicleState | None = None  # the last state sent
        self._velocity = body.motion().velocity
        self._thrust = 0.0  # share of the full thrust of all motors
        self.resets = self.lost = self.dropped = 0

    def step(self, now: float) -> None:
        """See Device."""
        asked = self._await_answers(now)
        if self._last is None:
            return
        motion = self._body.motion()
        present = json_link.vehicle(
            motion, self._body.state().position, self._velocity, GRAVITY, STEP, now - self._began
        )
        self._velocity = motion.velocity
        if now - self._frame_at > MOTORS_OFF_AFTER:
            self._body.motors(False)
        if now - max(self._frame_at, self._sent_at) > RESEND_AFTER or asked == "again":
            self._unanswered = 0
            self._send([present], now)
        elif asked:
            self._send(self._states(self._last.rate, present), now)

    def _await_answers(self, now: float) -> str:
        """Wait until the autopilot has answered all states sent. Return as `_receive` does.

        A process that does not answer within `FRAME_TIMEOUT` is not waited for again until it answers."""
        found = self._receive(now)
        while self._unanswered and self._is_answering:
            self._is_answering = self._link.wait(FRAME_TIMEOUT)
            if self._is_answering:
                found = self._receive(now) or found
            else:
                self._unanswered = 0
        return found

    def _states(self, wanted: int, present: VehicleState) -> list[VehicleState]:
        """Return the present state, after interpolated states that follow the last one sent.

        `wanted` (Hz) is the rate that ArduPilot asks for: 1 more than it gets, or the rate that it gets. Rounded up, so
        the rate rises until it suffices."""
        if self._last_sent is None:
            return [present]
        in_step = max(LEAST_STATES, min(MOST_STATES, math.ceil(wanted * STEP)))
        steps = max(1, round((present.time - self._last_sent.time) / STEP))
        count = min(MOST_AT_ONCE, in_step * steps)
        return [*(json_link.interpolate(self._last_sent, present, k / count) for k in range(1, count)), present]

    def _send(self, states: list[VehicleState], now: float) -> None:
        volts = EMPTY + (FULL - EMPTY) * self._fault_state.battery
        for state in states:
            self._link.send(json_link.line(state, volts, CURRENT * self._thrust))
        self._unanswered += len(states)
        self._last_sent, self._sent_at = states[-1], now

    def _receive(self, now: float) -> str:
        """Read all frames. Return "new" for new outputs, "again" for repeated frames only, "" for none."""
        found = ""
        for datagram in self._link.receive():
            frame = json_link.servos(datagram)
            if frame is None:
                self.dropped += 1
                continue
            self._frame_at, self._is_answering = now, True
            if self._last is not None and frame.count == self._last.count:
                found = found or "again"
                continue
            if self._last is None or frame.count < self._last.count:
                self._start(now)
            else:
                passed = frame.count - self._last.count
                self.lost += passed - 1
                self._unanswered = max(0, self._unanswered - passed)
            self._last, found = frame, "new"
        if found == "new" and self._last is not None:
            self._command(self._last)
        return found

    def _start(self, now: float) -> None:
        """Begin again: the autopilot has started or restarted."""
        self.resets += self._last is not None
        self._began, self._unanswered, self._last_sent = now, 0, None
        self._velocity = self._body.motion().velocity
        self._body.motors(False)

    def _command(self, frame: Servos) -> None:
        shares = [_thrust(frame.pwm[output]) for output in BODY_ORDER]
        self._thrust = sum(shares) / 4
        self._body.motors(True)
        self._body.thrusts((shares[0], shares[1], shares[2], shares[3]))

    def close(self) -> None:
        """See Device."""
        self._link.close()


def _thrust(pwm: int) -> float:
    """Return a motor's thrust as a share of its full thrust."""
    command = min(1.0, max(0.0, (pwm - LOW) / (HIGH - LOW)))
    return (1 - EXPO) * command + EXPO * command * command


class Socket:
    """Port that the autopilot sends to; answers go to the sender of its last frame."""

    def __init__(self, number: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer: tuple[str, int] | None = None
        try:
            self._socket.bind((LOOPBACK, number))
        except OSError as error:
            self._socket.close()
            raise OSError(error.errno, f"port {number} for an external autopilot: {error.strerror}") from None

    def receive(self) -> list[bytes]:
        """See Port."""
        found: list[bytes] = []
        while len(found) < MOST_AT_ONCE:
            try:
                datagram, self._peer = self._socket.recvfrom(2048)
            except ConnectionRefusedError:  # the operating system reports that the autopilot is gone
                continue
            except OSError:
                break
            found.append(datagram)
        return found

    def wait(self, seconds: float) -> bool:
        """See WaitablePort."""
        return bool(select.select([self._socket], [], [], seconds)[0])

    def send(self, data: bytes) -> None:
        """See Port."""
        if self._peer is not None:
            try:
                self._socket.sendto(data, self._peer)
            except OSError:
                return  # lost; the autopilot will ask again

    def close(self) -> None:
        """See Port."""
        self._socket.close()
