"""Telemetry scheduler of a simulated autopilot: periodic messages, requested messages and STATUSTEXTs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

Message = Any  # one of the dialect's generated classes
Maker = Callable[[float], Message | None]

_FAST, _NEVER = 1 / 50, math.inf  # seconds
_HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT


class SimulatedTelemetry:
    """Message streams with rates that SET_MESSAGE_INTERVAL sets.

    `makers` build the messages. `streams` are the default rates (Hz). `texts` holds STATUSTEXTs to be sent."""

    def __init__(
        self, makers: Mapping[int, Maker], streams: Mapping[int, float], texts: list[tuple[int, str]],
        send: Callable[[Message], None],
    ) -> None:  # fmt: skip
        self._makers, self._texts, self._send = makers, texts, send
        self._every = {message: 1 / rate for message, rate in streams.items()}
        self._usual = dict(self._every)
        self._due = dict.fromkeys(self._every, -math.inf)
        self._soonest = -math.inf

    def ask(self, message: int, interval: float, now: float) -> int:
        """Execute SET_MESSAGE_INTERVAL: microseconds, 0 for the default, -1 for never. Return a MAV_RESULT."""
        if message not in self._makers or not math.isfinite(interval):
            return int(mavlink.MAV_RESULT_FAILED)
        every = interval * 1e-6
        if interval == 0:
            every = self._usual.get(message, -1.0)
        self._every[message] = _NEVER if every < 0 else max(_FAST, every)
        self._due[message] = _NEVER if every < 0 else now
        self._soonest = min(self._due.values())
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def once(self, message: int, now: float) -> int:
        """Execute REQUEST_MESSAGE. Return a MAV_RESULT."""
        made = self._makers[message](now) if message in self._makers else None
        if made is None:
            return int(mavlink.MAV_RESULT_FAILED)
        self._send(made)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def step(self, now: float) -> None:
        """Send pending STATUSTEXTs and all messages that are due."""
        if self._texts:
            for severity, text in self._texts:
                self._send(mavlink.MAVLink_statustext_message(severity, text[:50].encode("ascii", "replace")))
            self._texts.clear()
        if now < self._soonest:
            return
        for message, due in self._due.items():
            if now >= due:
                made = self._makers[message](now)
                if made is not None:
                    self._send(made)
                every = self._every[message]
                self._due[message] = now + every if now - due > every else due + every
        self._soonest = min(self._due.values())
