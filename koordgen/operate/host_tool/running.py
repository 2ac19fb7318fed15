"""Start and stop of agents, and their status and doctor reports."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

from . import agents, logs, releases, service, supervise
from .deployment import Boot, Deployment
from .folder import Folder, ToolError, checked_robot
from .lock import deciding
from .releases import Release

_READY = 60.0  # seconds that `start` waits until agents report that they are ready
_TURN = 0.1  # seconds between two checks of the agents' states
_DOCTOR = 60.0  # time limit in seconds for a bundle's --doctor, which needs at most 20 s on an idle computer


def start(folder: Folder, boot: Boot, deployment: Deployment, wanted: Any) -> dict[str, str]:
    """Start agents of the confirmed release; return a state for each robot.

    The states are "ready", "starting" (not ready after 60 s) and "running" (the agent ran before). Raises ToolError
    "unconfirmed" while a release is pending, and "not started" if an agent ends at once.
    """
    with deciding(folder):
        deployment.repair()
        release = releases.read_release(folder, deployment.runnable())
    robots = _of_release(release, wanted)
    found = agents.look(folder, [release], ask=False)
    idle = [robot for robot in robots if not found[robot].running]
    if release.service == "systemd" and idle:
        service.start(folder, boot, idle)
        states = dict.fromkeys(idle, "ready")
    else:
        states = _start_supervised(folder, boot, idle)
    return dict.fromkeys(robots, "running") | states


def _of_release(release: Release, wanted: Any) -> Sequence[str]:
    if wanted is None:
        return release.robots
    robots = [checked_robot(robot) for robot in wanted]
    for robot in robots:
        if robot not in release.robots:
            raise ToolError("unknown robot", f"release {release.id} has no robot {robot} on this host", "deploy again")
    return robots


def _start_supervised(folder: Folder, boot: Boot, robots: Sequence[str]) -> dict[str, str]:
    started = {robot: supervise.start(folder, boot, robot) for robot in robots}
    end = time.monotonic() + _READY
    while True:
        states = {robot: supervise.state_of(folder, robot, process) for robot, process in started.items()}
        bad = [robot for robot, state in states.items() if state in ("ended", "waiting")]
        if bad:
            for robot in bad:
                if states[robot] == "ended":
                    # wait for the supervisor's end, which frees its lock; a held lock would count as running
                    started[robot].wait()
            last = [text for _, text in logs.selected(logs.read_log(folder.log(bad[0])), 5, None)["lines"]]
            raise ToolError(
                "not started",
                f"robot {bad[0]}: its agent has ended: {' / '.join(last)}",
                f"`koordgen logs` shows the log of {', '.join(bad)}",
            )
        if all(state == "ready" for state in states.values()) or time.monotonic() > end:
            return states
        time.sleep(_TURN)


def stop(folder: Folder, deployment: Deployment, wanted: Any, seconds: float) -> list[str]:
    """Stop agents and wait up to `seconds` for their end; return the robots that were stopped.

    Each agent brings its robot to a safe stop before it ends. Raises ToolError "still running", which names the robots
    whose agents have not ended, with their phases.
    """
    known = releases.readable(folder, [deployment.read()["confirmed"]])
    found = agents.look(folder, known, ask=False)
    robots = [checked_robot(robot) for robot in (found if wanted is None else wanted)]
    _end_units(folder, known, robots)
    running = [robot for robot in robots if robot in found and found[robot].running]
    for robot in running:
        _end(folder, robot)
    end = time.monotonic() + seconds
    while left := _still_running(folder, known, running, ask=False):
        if time.monotonic() > end:
            left = _still_running(folder, known, running, ask=True)
            named = ", ".join(f"{robot} ({each.phase or 'no answer'})" for robot, each in left.items())
            raise ToolError(
                "still running",
                f"not stopped after {seconds:.0f} s: {named}",
                "wait and stop again; stop an agent that was started by hand with Ctrl-C in its terminal",
            )
        time.sleep(_TURN)
    return running


def _end_units(folder: Folder, known: Sequence[Release], robots: Sequence[str]) -> None:
    of_units = [robot for release in known if release.service == "systemd" for robot in robots]
    if of_units and service.has_systemd():
        service.stop(folder, of_units)


def _end(folder: Folder, robot: str) -> None:
    """Send SIGTERM to the agent's supervisor, which forwards it, or to the agent if it has no supervisor."""
    supervisor = agents.pid_in(agents.supervisor_lock(folder, robot))
    pid = supervisor or agents.pid_in(agents.lock_file(folder, robot))
    if pid is not None:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)


def _still_running(
    folder: Folder, known: Sequence[Release], robots: Iterable[str], ask: bool
) -> dict[str, agents.Found]:
    found = agents.look(folder, known, ask)
    return {robot: found[robot] for robot in robots if found[robot].running}


def asked(folder: Folder, deployment: Deployment, robot: Any, option: str, always: bool) -> dict[str, Any]:
    """Run the bundle of a robot with `--doctor` or `--status`.

    Return its exit status, document and message.

    always: True if the option must print a JSON document, so that a missing document is an error.
    """
    state = deployment.read()
    pending = state["pending"]
    known = releases.readable(folder, (state["confirmed"], pending and pending["id"]))
    release = next((each for each in known if checked_robot(robot) in each.robots), None)
    if release is None:
        raise ToolError("unknown robot", f"no release on this host has a robot {robot}", "deploy it")
    status, output, errors = releases.run(folder, release, robot, option, "--format", "json", seconds=_DOCTOR)
    document, said = releases.to_document(output), errors.strip()[-2000:]
    if always and document is None:
        raise ToolError("does not run", f"robot {robot}: its bundle printed no JSON document (status {status}): {said}")
    return {"status": status, "document": document, "message": said}


def log_lines(folder: Folder, deployment: Deployment, robot: Any, most: int, since: float | None) -> dict[str, Any]:
    """Return log lines of a robot: from the journal if systemd runs the agent, else from a log file."""
    name = checked_robot(robot)
    known = releases.readable(folder, [deployment.read()["confirmed"]])
    if any(release.service == "systemd" for release in known):
        return logs.selected(service.journal(folder, name, most, since), most, since)
    return logs.selected(logs.read_log(folder.log(name)), most, since)
