"""The agents' processes: one per robot, each running its bundle unchanged, and what is known of each while it runs."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec

from targets.sim.scenario import Robot
from targets.sim.trace import Log, Phase, Record, Round, Tail, fault_text

_SET_DEATH_SIGNAL = 1  # prctl: PR_SET_PDEATHSIG
# What an agent may end with when it was told to: done, or interrupted.
GOOD_ENDS = (0, 130, 128 + signal.SIGTERM)


def free_ports(count: int) -> list[int]:
    """UDP ports of the loopback that nobody holds at the moment."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    try:
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [int(each.getsockname()[1]) for each in sockets]
    finally:
        for each in sockets:
            each.close()


def overrides(
    robots: tuple[Robot, ...], ports: list[int], control: int, body: dict[str, Any], key_file: Path, trace: Path
) -> dict[str, Any]:
    """What is laid over a robot's settings.json: the devices and addresses of this run; its agents never start anew."""
    peers = [{"name": r.name, "host": "127.0.0.1", "port": p} for r, p in zip(robots, ports, strict=True)]
    return {
        "peers": peers,
        "bind": "",
        "network": {"transport": "unicast"},  # groups and endpoints are those of the real network
        "control": control,
        "state": None,
        "key_file": str(key_file.resolve()),
        "insecure": False,
        "trace": str(trace.resolve()),
        "body": body,
    }


class Agent:
    """One robot's process, its log and its trace in `folder`. Made, not yet launched."""

    def __init__(self, robot: Robot, bundle: Path, folder: Path) -> None:
        self.robot = robot
        self.trace_file = folder / "trace.jsonl"
        self.log_file = folder / "log.txt"
        self._settings_file = folder / "settings.json"
        self._bundle = bundle
        self._tail = Tail(self.trace_file)
        self._process: subprocess.Popen[bytes] | None = None
        self.told = False  # to come to rest
        self.killed = False
        self.phase = Phase("launched")
        self.resting: Phase | None = None  # when it came to rest unasked
        self.round = 0
        self.events = 0
        self.first_fault: Round | None = None
        self.first_round_start: float | None = None  # of round 1, host time
        self.last_error = ""

    def launch(self, settings: dict[str, Any], delta: float) -> None:
        """Start the process. Raises OSError."""
        self._delta = delta
        self._settings_file.write_bytes(msgspec.json.format(msgspec.json.encode(settings), indent=2) + b"\n")
        # The numeric libraries of all agents share the cores of one host.
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
        with self.log_file.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, str(self._bundle.resolve()), "--settings", str(self._settings_file.resolve())],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=environment,
                cwd=self._settings_file.parent,
                start_new_session=True,  # Ctrl-C on the terminal is the harness's to pass on
                preexec_fn=_end_with_parent,
            )

    @property
    def status(self) -> int | None:
        """The exit status, negative for the signal that killed it; None while it runs or was never launched."""
        return self._process.poll() if self._process else None

    @property
    def alive(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def tell_end(self) -> None:
        """Tell it to come to rest and end."""
        self.told = True
        if self._process and self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it and what it started, at once."""
        if self._process and self._process.poll() is None:
            self.killed = True
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def look(self) -> list[Record]:
        """Take what it traced since the last look."""
        records = self._tail.read()
        for record in records:
            self._take(record)
        return records

    def _take(self, record: Record) -> None:
        match record:
            case Phase():
                self.phase = record
                if record.phase == "resting" and not self.told and self.resting is None:
                    self.resting = record
            case Round():
                if self.first_round_start is None:
                    self.first_round_start = record.time - record.late - (record.round - 1) * self._delta
                self.round = record.round
                if record.fault is not None:
                    self.first_fault = self.first_fault or record
                elif record.event is not None:
                    self.events += 1
            case Log(level="error"):
                self.last_error = record.message
            case _:
                pass

    def failure(self) -> str | None:
        """Why its end was not a good one, or None: it runs on, ended well, or was told to before it traced anything."""
        status = self.status
        if status is None:
            return None
        self.look()
        if self.killed:
            return "did not come to rest in time and was killed"
        if status == 0 and not self.told and self.round == 0:
            return "ended by itself before round 1"
        if status == 0 or (self.told and (status in GOOD_ENDS or self.phase.phase == "launched")):
            return None
        if status < 0:
            return f"was killed by {signal.Signals(-status).name}"
        own = self.resting.detail if self.resting else self.last_error
        why = own.strip().splitlines()[-1:] or self.last_lines(1) or ["it said nothing"]
        return f"ended with status {status}: {why[0]}"

    def waiting_for(self) -> str:
        """Where it stands, in words."""
        if self.phase.phase == "launched" and not self.alive:
            return self.failure() or "not launched"
        return f"{self.phase.phase}: {self.phase.detail}" if self.phase.detail else self.phase.phase

    def last_lines(self, count: int) -> list[str]:
        """The end of its log."""
        try:
            with self.log_file.open("rb") as file:
                file.seek(max(0, self.log_file.stat().st_size - 8192))
                text = file.read().decode("utf-8", "replace")
        except OSError:
            return []
        return [line for line in text.splitlines() if line.strip()][-count:]

    def fault_text(self) -> str:
        return fault_text(self.first_fault.fault) if self.first_fault else ""


def _end_with_parent() -> None:
    """Runs in the child: should the harness be killed, its agents are told to come to rest."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_DEATH_SIGNAL, signal.SIGTERM)
