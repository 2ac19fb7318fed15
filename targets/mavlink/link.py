"""The MAVLink link to one autopilot: which vehicle it is, heartbeats both ways, commands and their answers.

Nothing here waits. Commands are asked again until the caller has seen their effect; an acknowledgement alone proves
nothing [ArduPilot acknowledges a mode in the first second after boot and loses it].
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.mavlink.framing import Framer, Message
from targets.mavlink.transport import Transport

GROUND_STATION = 255  # MAV_GCS_SYSID: only from this system do heartbeats hold off the autopilot's GCS failsafe
COMPONENT = mavlink.MAV_COMP_ID_MISSIONPLANNER
GREETING = 0.4  # seconds between two heartbeats of ours: the autopilot lands after 5 s without one, and some are lost
LOST = 2.0  # seconds without a heartbeat
GONE = 5.0  # seconds without one of another autopilot's
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
    """The autopilot that was chosen: the first whose heartbeat was heard, of the system id that was asked for."""

    system: int
    component: int
    autopilot: int  # MAV_AUTOPILOT
    type: int  # MAV_TYPE


@dataclass(slots=True)
class Asked:
    """A command under way: how often it was sent, when last, and the answer to it if there was one."""

    times: int
    at: float
    result: int | None = None


class Link:
    """Owns the transport. `system` is the vehicle's MAVLink system id, 0 for the only one. `rejected` counts what was
    dropped, by reason; `texts` holds (time, severity, text)."""

    def __init__(self, transport: Transport, system: int = 0) -> None:
        self._transport = transport
        self.system = system
        self._framer = Framer()
        self._packer = mavlink.MAVLink(None, srcSystem=GROUND_STATION, srcComponent=COMPONENT)
        self._source: object = None
        self._greeted = -math.inf
        self._other = -math.inf  # when the last heartbeat came of another autopilot that may be the one meant
        self.rival = -math.inf  # when a heartbeat came of another ground station with our system id
        self._asked: dict[int, Asked] = {}
        self._parts: tuple[int, int, str] = (0, 0, "")
        self.rejected = self._framer.rejected
        self.unsent = 0
        self.vehicle: Vehicle | None = None
        self.heard: float | None = None  # when the vehicle's last heartbeat came
        self.spoke: float | None = None  # when its last message came
        self.others: set[int] = set()  # system ids of the other autopilots that were heard
        self.texts: deque[tuple[float, int, str]] = deque(maxlen=20)

    @property
    def garbled(self) -> int:
        """Bytes that came and were no part of a frame."""
        return self.rejected.get("bytes", 0)

    def alive(self, now: float) -> bool:
        """Return whether the vehicle's heartbeat is fresh."""
        return self.heard is not None and now - self.heard <= LOST

    def crowded(self, now: float) -> bool:
        """Whether another autopilot speaks on this link, by its system id (where none was asked for) or its address:
        which is ours is not known."""
        return now - self._other <= GONE

    def rivalled(self, now: float) -> bool:
        """Whether another ground station sends heartbeats under our system id: they hold off the autopilot's failsafe
        as well as ours do."""
        return now - self.rival <= GONE

    def receive(self, now: float) -> list[Message]:
        """Return the vehicle's messages that have arrived, in order."""
        messages = []
        decode = self._framer.datagram if self._transport.datagrams else self._framer.stream
        for data, source in self._transport.receive(now):
            strange = self._source is not None and source != self._source and self.alive(now)
            for message in decode(data):
                if not self._from_vehicle(message):
                    self._take_foreign(message, now)
                elif strange:
                    self._count("another address")  # while the vehicle speaks, nobody else does in its name
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

    def _take_foreign(self, message: Message, now: float) -> None:
        """Count what is not the vehicle's; of ground stations and of its own gimbals as well."""
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
                self._take_text(message, now)

    def _take_text(self, message: Message, now: float) -> None:
        """Long texts come in parts of 50 characters with a common id; a part that was lost ends the text there."""
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
        """The autopilot's own words since then, warnings and worse, the latest last; empty when it said nothing."""
        said = [text for at, severity, text in self.texts if at >= since and severity <= mavlink.MAV_SEVERITY_WARNING]
        return "; ".join(dict.fromkeys(said[-4:]))

    def greet(self, now: float) -> None:
        """Send our heartbeat when one is due."""
        if now - self._greeted >= GREETING:
            self._greeted = now
            self.send(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                )
            )

    def send(self, message: Message) -> None:
        """Send a message, or count it when the transport cannot take it."""
        frame = message.pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        if not self._transport.send(frame):
            self.unsent += 1

    def ask(self, now: float, command: int, *params: float, every: float = 1.0) -> Asked:
        """Ask for a command, again every so many seconds as long as this is called. Unused params are zero."""
        asked = self._asked.get(command)
        if asked is None:
            asked = self._asked[command] = Asked(0, -math.inf)
        if now - asked.at >= every and self.vehicle is not None:
            self._command(command, min(asked.times, 255), *params)
            asked.times, asked.at = asked.times + 1, now
        return asked

    def asked(self, command: int) -> Asked | None:
        """Return the pending command, if any."""
        return self._asked.get(command)

    def forget(self, command: int) -> None:
        """Its effect was seen, or is no longer wanted: the next `ask` starts afresh."""
        self._asked.pop(command, None)

    def tell(self, command: int, *params: float) -> None:
        """Send a command once; the caller sees to its effect."""
        self._command(command, 0, *params)

    def _command(self, command: int, confirmation: int, *params: float) -> None:
        if self.vehicle is None:
            return
        if not all(map(math.isfinite, params)):
            raise ValueError(f"command {command} with {params}: not finite")
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
