"""MAVLink link to one autopilot: identifies the vehicle, exchanges heartbeats, sends commands and receives answers.

No method blocks. Commands are repeated until the caller has seen their effect. An acknowledgement alone proves nothing:
in the first second after boot, ArduPilot acknowledges a change of mode and then loses it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.mavlink.framing import Framer, Message
from targets.mavlink.transport import Transport

# MAVLink system id of the agent; if MAV_GCS_SYSID equals it, only heartbeats of this id prevent the GCS failsafe
GROUND_STATION = 255
COMPONENT = mavlink.MAV_COMP_ID_MISSIONPLANNER
# seconds between two heartbeats of the agent: some are lost, and the autopilot lands after 5 s without any
GREETING = 0.4
LOST = 2.0  # seconds without a heartbeat after which the vehicle no longer counts as alive
GONE = 5.0  # seconds without a heartbeat after which another autopilot or ground station no longer counts as present
RESULTS = {
    mavlink.MAV_RESULT_ACCEPTED: "accepted",
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "rejected for now",
    mavlink.MAV_RESULT_DENIED: "denied",
    mavlink.MAV_RESULT_UNSUPPORTED: "unsupported",
    mavlink.MAV_RESULT_FAILED: "failed",
    mavlink.MAV_RESULT_IN_PROGRESS: "in progress",
}


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Autopilot of the link: the sender of the first heartbeat with the wanted system id."""

    system: int
    component: int
    autopilot: int  # kind of autopilot: a MAV_AUTOPILOT
    type: int  # kind of vehicle: a MAV_TYPE


@dataclass(slots=True)
class SentCommand:
    """Command that was sent, and is sent again until its effect is seen."""

    times: int  # number of times that the command was sent
    at: float  # time when the command was sent last
    result: int | None = None  # MAV_RESULT in the last acknowledgement; None without an acknowledgement


class Link:
    """Link to one autopilot; owns the transport.

    `system`: MAVLink system id of the vehicle; 0: the only vehicle on the link.
    `rejected`: numbers of dropped bytes and messages, by reason.
    `texts`: the last STATUSTEXT messages as (time, severity, text)."""

    def __init__(self, transport: Transport, system: int = 0) -> None:
        self._transport = transport
        self.system = system
        self._framer = Framer()
        self._packer = mavlink.MAVLink(None, srcSystem=GROUND_STATION, srcComponent=COMPONENT)
        self._source: object = None
        self._greeted = -math.inf
        self._other = -math.inf  # time of the last message of a second autopilot; either may be the robot's
        self.rival = -math.inf  # time of the last heartbeat of another ground station with the agent's system id
        self._asked: dict[int, SentCommand] = {}
        self._parts: tuple[int, int, str] = (0, 0, "")
        self.rejected = self._framer.rejected
        self.unsent = 0
        self.vehicle: Vehicle | None = None
        self.heard: float | None = None  # time of the vehicle's last heartbeat
        self.spoke: float | None = None  # time of the vehicle's last message
        self.others: set[int] = set()  # system ids of other autopilots whose heartbeats were received
        self.texts: deque[tuple[float, int, str]] = deque(maxlen=20)

    @property
    def garbled(self) -> int:
        """Return the number of received bytes that were not part of a frame."""
        return self.rejected.get("bytes", 0)

    def alive(self, now: float) -> bool:
        """Return whether the vehicle's heartbeat is fresh."""
        return self.heard is not None and now - self.heard <= LOST

    def crowded(self, now: float) -> bool:
        """Return whether another autopilot sends on this link, so that the robot's autopilot is ambiguous.

        The other autopilot has another system id (counted only if the setting `system` is 0), or another address."""
        return now - self._other <= GONE

    def rivalled(self, now: float) -> bool:
        """Return whether another ground station sends heartbeats with the agent's system id.

        In this case, the autopilot's failsafe would not act if the agent died."""
        return now - self.rival <= GONE

    def receive(self, now: float) -> list[Message]:
        """Return the vehicle's messages that have arrived, in order."""
        messages = []
        decode = self._framer.datagram if self._transport.datagrams else self._framer.stream
        for data, source in self._transport.receive(now):
            strange = self._source is not None and source != self._source and self.alive(now)
            for message in decode(data):
                if not self._from_vehicle(message):
                    self._note_foreign(message, now)
                elif strange:
                    # drop the message: the vehicle's own address is different, and its heartbeats arrive
                    self._count("another address")
                    self._other = now
                else:
                    self._source, self.spoke = source, now
                    self._transport.answer(source)
                    self._note(message, now)
                    messages.append(message)
        return messages

    def _from_vehicle(self, message: Message) -> bool:
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if self.vehicle is None:
            if not _is_autopilot(message) or self.system not in (0, system):
                return False
            self.vehicle = Vehicle(system, component, message.autopilot, message.type)
        return (system, component) == (self.vehicle.system, self.vehicle.component)

    def _note_foreign(self, message: Message, now: float) -> None:
        """Record a message from another sender than the vehicle: an autopilot, a ground station, a gimbal."""
        system = message.get_srcSystem()
        chosen = self.system or (self.vehicle.system if self.vehicle is not None else 0)
        if chosen and system != chosen:
            self._count("another system")
        if system == GROUND_STATION and message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self.rival = now
        if _is_autopilot(message) and chosen:
            self.others.add(system)
            if not self.system:
                self._other = now

    def _note(self, message: Message, now: float) -> None:
        match message.get_msgId():
            case mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                self.heard = now
            case mavlink.MAVLINK_MSG_ID_COMMAND_ACK:
                asked = self._asked.get(message.command)
                if asked is not None and message.target_system in (0, GROUND_STATION):
                    asked.result = message.result
            case mavlink.MAVLINK_MSG_ID_STATUSTEXT:
                self._note_text(message, now)

    def _note_text(self, message: Message, now: float) -> None:
        """Record a STATUSTEXT. Long texts arrive in chunks of 50 characters with a common id.

        If a chunk is lost, the recorded text ends before the lost chunk."""
        text = message.text if isinstance(message.text, str) else bytes(message.text).decode("ascii", "replace")
        text = "".join(c if c.isprintable() else "?" for c in text)
        if message.id:
            last, parts, before = self._parts
            follows = message.id == last and message.chunk_seq == parts
            self._parts = (message.id, message.chunk_seq + 1, (before if follows else "") + text)
            if follows and self.texts:
                self.texts.pop()
            text = self._parts[2]
        self.texts.append((now, message.severity, text))

    def reasons(self, since: float) -> str:
        """Return the latest STATUSTEXTs since a time, of severity warning or worse; "" without any."""
        said = [text for at, severity, text in self.texts if at >= since and severity <= mavlink.MAV_SEVERITY_WARNING]
        return "; ".join(dict.fromkeys(said[-4:]))

    def greet(self, now: float) -> None:
        """Send the agent's heartbeat if it is due."""
        if now - self._greeted >= GREETING:
            self._greeted = now
            self.send(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                )
            )

    def send(self, message: Message) -> None:
        """Send a message; if the transport cannot accept it now, drop it and count it in `unsent`."""
        frame = message.pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        if not self._transport.send(frame):
            self.unsent += 1

    def ask(self, now: float, command: int, *params: float, every: float = 1.0) -> SentCommand:
        """Send a command, and send it again in calls that come `every` seconds later. Unused params are zero."""
        asked = self._asked.get(command)
        if asked is None:
            asked = self._asked[command] = SentCommand(0, -math.inf)
        if now - asked.at >= every and self.vehicle is not None:
            self._command(command, min(asked.times, 255), *params)
            asked.times, asked.at = asked.times + 1, now
        return asked

    def asked(self, command: int) -> SentCommand | None:
        """Return the pending command with this number, or None."""
        return self._asked.get(command)

    def forget(self, command: int) -> None:
        """Drop a pending command after its effect was seen or is not wanted any more.

        The next `ask` sends the command at once."""
        self._asked.pop(command, None)

    def send_once(self, command: int, *params: float) -> None:
        """Send a command once, without a repetition. The caller checks the effect of the command."""
        self._command(command, 0, *params)

    def _command(self, command: int, confirmation: int, *params: float) -> None:
        if self.vehicle is None:
            return
        if not all(map(math.isfinite, params)):
            raise ValueError(f"command {command} with {params}: a parameter is not finite")
        seven = (*params, *(0.0,) * (7 - len(params)))
        self.send(
            mavlink.MAVLink_command_long_message(
                self.vehicle.system, self.vehicle.component, command, confirmation, *seven
            )
        )

    def _count(self, reason: str) -> None:
        self.rejected[reason] = self.rejected.get(reason, 0) + 1

    def close(self) -> None:
        self._transport.close()


def _is_autopilot(message: Message) -> bool:
    return bool(
        message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT
        and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID
        and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1
    )
