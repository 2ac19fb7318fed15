"""Command `--status`: requests the status report of the agent on this host over the control port, and formats it."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.ops.control import address_of
from koordgen.runtime.ops.orders import LONG, NONCE, Ask, AskStatus, Offer, StatusPart, decode, encode

REPEAT, TIMEOUT = 0.1, 2.0  # seconds until a request is sent again, and until the command gives up


class StatusRequest:
    """Request of one agent's status report. The caller sends all `datagrams` and passes each answer to `receive`.

    This is repeated until `answer` is set. The first datagram requests the challenge that the other datagrams contain.
    """

    def __init__(self, application: int, key: bytes | None, nonce: bytes) -> None:
        self.answer: dict[str, Any] | None = None
        self._application = application
        self._key = key
        self._nonce = nonce
        self._challenge = b""
        self._pieces: list[bytes | None] = [None]

    def datagrams(self) -> list[bytes]:
        if not self._challenge:
            return [encode(Ask(self._application, self._nonce), self._key)]
        missing = [i for i, piece in enumerate(self._pieces) if piece is None]
        questions = [AskStatus(self._application, self._nonce, self._challenge, i) for i in missing]
        return [encode(question, self._key) for question in questions]

    def receive(self, datagram: bytes) -> bool:
        """Handle an answer. Return True if the report is complete, or if `datagrams` should be sent again at once."""
        order = decode(datagram, self._key)
        if isinstance(order, Offer) and order.nonce == self._nonce and not self._challenge:
            self._challenge = order.challenge
            return True
        if not isinstance(order, StatusPart) or order.nonce != self._nonce or order.part >= order.parts:
            return False
        more = len(self._pieces) != order.parts
        if more:
            self._pieces = [None] * order.parts
        self._pieces[order.part] = order.data
        whole = [piece for piece in self._pieces if piece is not None]
        if len(whole) < order.parts:
            return more
        try:
            self.answer = json.loads(b"".join(whole))
        except ValueError:  # the pieces belong to different reports, because the agent dropped the first report
            self._pieces = [None]
        return True


def ask(settings: Settings, key: bytes | None) -> dict[str, Any] | None:
    """Return the status report of the agent with these settings on this host, or None if it does not answer."""
    family, address = address_of(settings)
    asking = StatusRequest(settings.application_id, key, os.urandom(NONCE))
    with socket.socket(family, socket.SOCK_DGRAM) as asker:
        asker.settimeout(REPEAT)
        end = time.monotonic() + TIMEOUT
        while asking.answer is None and time.monotonic() < end:
            for datagram in asking.datagrams():
                with suppress(OSError):
                    asker.sendto(datagram, address)
            with suppress(OSError):  # includes a timeout
                while not asking.receive(asker.recv(LONG + 1)):
                    pass
    return asking.answer


def show(report: Mapping[str, Any]) -> str:
    """Return a status report as a table for a terminal."""
    late, names = report["late_ms"], report["names"]
    share = 100 * report["current"] / max(1, report["rounds"])
    lines = [
        f"{report['robot']}  pid {report['pid']} of {len(names)}, {report['app']}: {report['phase']}, "
        f"round {report['round']}",
        f"release   {report['release'] or 'none: built without a fleet file'}",
        f"rounds    {report['rounds']}, current in {share:.1f} %, {report['events']} events",
        f"lateness  {_durations(late)} ms",
        "",
        *applications_table([(report["robot"], report)]),
        f"{'peer':<12} {'loss':>7} {'delay p50 / p99 / max ms':>26} {'silent ms':>10} {'longest':>9} {'behind':>7} "
        f"{'repeats':>8}",
    ]
    for pid, peer in report["peers"].items():
        loss = "-" if peer["loss"] is None else f"{100 * peer['loss']:.1f} %"
        silent = "never" if peer["silent_ms"] is None else f"{peer['silent_ms']:.0f}"
        lines.append(
            f"{names[int(pid)]:<12} {loss:>7} {_durations(peer['delay_ms']):>26} {silent:>10} "
            f"{peer['longest_silence_ms']:>9.0f} {peer['behind']:>7} {peer['repeats']:>8}"
        )
    monitors = report["monitors"]
    if monitors["counts"]:
        counted = ", ".join(f"{count} {outcome}" for outcome, count in sorted(monitors["counts"].items()))
        lines += ["", f"properties, by the robot's monitors: {counted}"]
        for found in monitors["violated"]:
            word = f"{found['of']} {found['name']}".strip()
            lines.append(f"  violated since round {found['since']}: {word} ({found['line']}): {found['why']}")
    for title, counts in (("skipped", report["skipped"]), ("rejected", report["rejected"])):
        if counts:
            lines += ["", title, *(f"{count:>8}  {reason}" for reason, count in sorted(counts.items()))]
    return "\n".join(lines)


def applications_table(reports: Sequence[tuple[str, Mapping[str, Any]]]) -> list[str]:
    """Return lines of a table with each application of each robot, given by name and report, and an empty line.

    Return no lines if the fleet has only one application."""
    rows = [
        (
            name,
            each["name"],
            f"{each['pid']} of {len(each['members'])}",
            str(each["round"]),
            _last_event(each),
            *_state(each),
        )
        for name, report in reports
        for each in report.get("applications", ())
    ]
    if not rows:
        return []
    rows.insert(0, ("robot", "application", "pid", "round", "last event", "faults", "state"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return [*lines, ""]


def _last_event(application: Mapping[str, Any]) -> str:
    return f"{application['event']} (round {application['event_round']})" if application["event"] else "none yet"


def _state(application: Mapping[str, Any]) -> tuple[str, str]:
    """Return the number of faults of an application, and its state."""
    count, fault = str(application["counts"].get("faults", 0)), application["fault"]
    return count, "stopped" if application["stopped"] else f"holds: {fault}" if fault else "runs"


def _durations(found: Mapping[str, float]) -> str:
    return " / ".join(f"{found[key]:.1f}" for key in ("p50", "p99", "max")) if found else "-"
