"""Process of one robot: `main`, which an agent bundle calls, reads the settings and runs the agent.

Exit statuses:
0: the mission is done, and the robot has stopped safely.
1: the settings or the program are wrong.
2: the command line is wrong.
3: the robot has stopped safely because a monitored property was violated, as the fleet file demands.
5: the environment has a problem (port, link, device, vehicle).
70: internal error.
130: a third signal has ended the process at once.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import select
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

from koordgen.runtime.agent.checkpoint import CheckpointFile
from koordgen.runtime.agent.machine import INTERNAL, OK, SURROUNDINGS, WRONG_PROGRAM, Agent
from koordgen.runtime.agent.squad import Squad
from koordgen.runtime.agent.squad_host import SquadHost
from koordgen.runtime.agent.squad_process import AgentProcess, open_host
from koordgen.runtime.config.settings import BadSettings, Settings, load
from koordgen.runtime.native import protocol
from koordgen.runtime.native.loader import NotCompiled
from koordgen.runtime.net import inbox
from koordgen.runtime.net.layout import Layout, TooLarge
from koordgen.runtime.net.seal import BadKey
from koordgen.runtime.net.transport import CannotOpen
from koordgen.runtime.ops.checks import print_briefly, print_checks
from koordgen.runtime.ops.control import Control
from koordgen.runtime.ops.doctor import OuterRobot, PlatformType, examine
from koordgen.runtime.ops.host import temperature
from koordgen.runtime.ops.journal import Emit
from koordgen.runtime.ops.notify import Notifier
from koordgen.runtime.ops.set_up import fleet_program, open_key, open_settings, open_trace, open_transport, programs_of
from koordgen.runtime.ops.status import ask, show
from koordgen.runtime.program.extern import BadExtern
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Program, wrong_first_value
from koordgen.runtime.program.property import Properties, without_properties
from koordgen.runtime.program.runner import EndedAtOnce, Interrupting
from koordgen.runtime.values.clock import SystemClock
from koordgen.runtime.vehicle.drivers import Drivers, with_drivers
from koordgen.runtime.vehicle.platform import Finding, Platform, Unready

__all__ = ["Agent", "main"]

INTERRUPTED = 130
LONGEST_WAIT = 0.1  # seconds; longest wait for messages, and therefore the longest delay until a signal is handled
YOUNG = 10_000  # number of new objects that starts a collection of the youngest generation; a collection takes 0.3 ms
PIECE = 200  # number of characters written at once, so few that a pipe or terminal that is ready accepts all of them

NO_DRIVERS: Drivers = {}


def main(
    program: Program | FleetProgram,
    platform_type: PlatformType,
    root: Path,
    argv: Sequence[str],
    drivers: Drivers = NO_DRIVERS,
    properties: Mapping[str, Properties] | Properties | None = None,
    squad: Squad | None = None,
) -> int:
    """Run the program of a robot. Return the exit status.

    program: the compiled program, or all applications of the fleet.
    platform_type: class that creates the platform, the code for the vehicle.
    root: folder of the bundle, which contains the settings.
    argv: arguments of the command line.
    drivers: module -> function that creates the driver of a module that the platform does not offer.
    properties: monitored properties, of each application by its name if there are several; None: none.
    squad: the outer robot that this robot's fleet is; None: the fleet is not a robot of another fleet.
    """
    arguments = _arguments(program, argv)
    if isinstance(arguments, int):
        return arguments
    if arguments.compile:
        return _compile()
    try:
        if arguments.check or arguments.doctor:
            outer = None if squad is None else _outer(squad, root, arguments.settings)
            found = examine(program, root, arguments.settings, arguments.pid, platform_type, drivers, outer)
            with closing(found) as results:
                return _print_results(program, results, arguments)
        settings = open_settings(root, arguments.settings, arguments.pid)
        key = open_key(settings)
        if key is None:
            _print_message(
                "warning", "INSECURE: no key is set, so every computer on this network can control this robot"
            )
        if arguments.status:
            return _status(settings, key, arguments.format)
        fleet = fleet_program(program, settings)
        wrong = _load(fleet, settings.pid)
        if wrong is not None:
            return _fail(wrong, "change the first value in the program", WRONG_PROGRAM)
        if reason := inbox.accelerator():  # compiles now if needed, which may take longer than a round
            _print_message("warning", f"{inbox.PYTHON_COSTS}: {reason}")
        process = AgentProcess(SystemClock(), _emitter(arguments.quiet), Interrupting(), os.urandom(8))
        watched = _watched(fleet, properties)
        with ExitStack() as opened:
            host = None
            if squad is not None:
                host = open_host(squad, fleet, settings, load(*_outer(squad, root, arguments.settings)[1:]), process)
                opened.callback(host.close)
                fleet, drivers = host.fleet, {**drivers, **host.drivers}
            platform = platform_type(settings, key)
            opened.callback(platform.close)
            whole = with_drivers(platform, fleet.of(settings.pid), drivers)
            opened.callback(whole.close)
            return _run(fleet, settings, key, whole, root, watched, process, host)
    except Exception as error:
        return _failed(error)
    except (KeyboardInterrupt, EndedAtOnce):
        return _fail("the agent was ended at once; only the failsafe of the vehicle acts now", "", INTERRUPTED)


def _failed(error: Exception) -> int:
    """Print why the agent cannot run. Return the exit status."""
    match error:
        case BadSettings() | BadKey() | TooLarge() | BadExtern():
            return _fail(str(error), "", WRONG_PROGRAM)
        case CannotOpen():
            return _fail(str(error), "", SURROUNDINGS)
        case Unready():
            return _fail(error.message, error.hint, SURROUNDINGS)
        case _:
            text = "".join(traceback.format_exception(error))
            return _fail(f"internal error, please report it:\n{text}", "", INTERNAL)


def _load(fleet: FleetProgram, robot: int) -> str | None:
    """Check the programs of a robot, and import their functions now, because that may take longer than a round.

    Return a message about a wrong first value; None if all are right. Raises TooLarge and BadExtern."""
    Layout.of(fleet)
    for program in programs_of(fleet, robot):
        wrong = wrong_first_value(program)
        if wrong is not None:
            return f"{program.name}: {wrong}" if fleet.is_composed else wrong
        if program.library is not None:
            program.library.load()
    return None


def _watched(fleet: FleetProgram, found: Mapping[str, Properties] | Properties | None) -> dict[str, Properties]:
    """Return the properties of each application by its name. `found`: see `main`."""
    given = found if isinstance(found, Mapping) else {fleet.applications[0].name: found}
    return {a.name: given.get(a.name) or without_properties(a.program) for a in fleet.applications}


def _print_results(program: Program | FleetProgram, results: Iterator[Finding], arguments: argparse.Namespace) -> int:
    """Print the results of checks: all of them for `--doctor`, up to the first failure for `--check`."""
    return print_checks(program.name, results, arguments.format) if arguments.doctor else print_briefly(results)


def settle_collector() -> None:
    """Make garbage collections short and rare during rounds. Call this once all permanent objects exist.

    A full collection takes 6 ms with CasADi and OMPL loaded, so all present objects are excluded from collections.
    Objects of a round are almost never part of a reference cycle, so collections may be rare."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(YOUNG)


def _arguments(program: Program | FleetProgram, argv: Sequence[str]) -> argparse.Namespace | int:
    parser = argparse.ArgumentParser(
        prog=f"python3 <bundle of {program.name}>",
        description=f"Runs one robot of {program.name}.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--check", action="store_true", help="check that the robot can start, up to the first problem; move nothing"
    )
    parser.add_argument("--doctor", action="store_true", help="run all checks and report them; move nothing")
    parser.add_argument("--status", action="store_true", help="show the status of the agent that runs on this host")
    parser.add_argument(
        "--compile",
        action="store_true",
        help="compile the shared memory's modules, once for all bundles of this koordgen: for large and fast fleets",
    )
    parser.add_argument(
        "--format", choices=("text", "json"), default="text", help="of --status and --doctor (default: text)"
    )
    parser.add_argument("--settings", type=Path, metavar="FILE", help="JSON that overrides the bundle's settings.json")
    parser.add_argument("--pid", type=int, metavar="N", help="take the place of robot N of the fleet")
    parser.add_argument("--quiet", action="store_true", help="print only warnings and errors")
    try:
        return parser.parse_args(list(argv))
    except SystemExit as done:
        return done.code if isinstance(done.code, int) else 2


def _compile() -> int:
    _print_message(
        "info", "compiling the modules of the shared memory; this takes a minute, or several on a small computer"
    )
    try:
        path = protocol.compile_modules()
    except NotCompiled as error:
        return _fail(str(error), "", SURROUNDINGS)
    _print_message(
        "info", f"compiled: {path}; bundles of this koordgen version use this library from their next start on"
    )
    return OK


def _status(settings: Settings, key: bytes | None, form: str) -> int:
    report = ask(settings, key)
    if report is None:
        place = f"{settings.bind or settings.peers[settings.pid].host}:{settings.control_port}"
        hint = "check that the robot's agent runs on this computer, with the same key and application_id"
        return _fail(f"robot {settings.robot} does not answer at {place}", hint, SURROUNDINGS)
    print(json.dumps(report, indent=2) if form == "json" else show(report))
    return OK


def _run(
    program: FleetProgram,
    settings: Settings,
    key: bytes | None,
    platform: Platform,
    root: Path,
    properties: Mapping[str, Properties],
    process: AgentProcess,
    host: SquadHost | None,
) -> int:
    clock, boot = process.clock, process.boot
    with ExitStack() as opened:
        transport = open_transport(settings)  # opened first, because this fails if the robot's agent already runs
        opened.callback(transport.close)
        control = Control.open(settings, key)
        opened.callback(control.close)
        store = _open_store(program, settings, root)
        opened.callback(store.close)
        trace = open_trace(settings, _warn)
        opened.callback(trace.close)
        agent = Agent(
            program, settings, key, platform, clock, transport, trace, process.emit, boot, store,
            limit=process.limit, properties=properties,
            cpu=time.thread_time,
        )  # fmt: skip
        if host is not None:
            host.attach(agent)

        def report() -> dict[str, Any]:
            return {"boot": boot.hex(), **_report(settings, agent, control, root, clock.now(), host)}

        notifier = Notifier(os.environ, os.getpid())
        opened.callback(notifier.close)
        signals = opened.enter_context(_Signals())
        seen = 0
        stopped = False
        agent.poll(clock.now())  # this first call opens the vehicle and imports its dependencies
        settle_collector()
        notifier.ready()
        while not agent.done:
            notifier.alive(clock.now(), f"{agent.phase}, round {agent.round // 100 * 100}")
            if control.poll(clock.now(), agent.phase, report) and not stopped:
                stopped = True
                agent.stop_all("emergency stop")
            wake = agent.poll(clock.now())
            if host is not None:
                wake = min(wake, host.poll(clock.now()))
            if signals.count > seen:
                seen += 1
                if seen == 1:
                    notifier.stopping()
                    agent.end(f"{signals.name}: stopping safely")
                else:
                    _print_message("warning", "the robot is still stopping; one more signal ends the process at once")
            transport.wait(min(wake - clock.now(), LONGEST_WAIT), *agent.expects)
        while control.lingers(clock.now()):
            control.poll(clock.now(), agent.phase, report)
            time.sleep(0.01)
        gc.unfreeze()  # return all objects to the collector, so that OMPL's binding can report leaks at the end
        return agent.status


def _report(
    settings: Settings, agent: Agent, control: Control, root: Path, now: float, host: SquadHost | None
) -> dict[str, Any]:
    counters, error = agent.counters(), agent.clock_error(now)
    dropped = {k.removeprefix("dropped: "): v for k, v in counters.items() if k.startswith("dropped: ")}
    return {
        "app": settings.app,
        "release": settings.release,
        "robot": settings.robot,
        "pid": settings.pid,
        "names": [peer.name for peer in settings.peers],
        "phase": agent.phase,
        "round": agent.round,
        "delta": settings.delta,
        "geofence": [[p.x, p.y, p.z] for p in (settings.geofence.lo, settings.geofence.hi)],
        "monitors": agent.monitors.report(),
        "host": {
            "clock_ms": None if error is None else round(error * 1e3, 3),
            "disk_gb": round(shutil.disk_usage(root).free / 1e9, 3),
            "temperature": temperature(),
        },
        "counters": {k: v for k, v in counters.items() if not k.startswith("dropped: ")},
        **({} if host is None else {"outer": host.report(now)}),
        **agent.snapshot(now),
        **agent.metrics.snapshot(now, dropped | {f"order: {k}": v for k, v in control.rejected.items()}),
    }


class _Signals:
    """Context manager that counts SIGINT, SIGTERM and SIGHUP; the third signal raises EndedAtOnce.

    A SIGHUP (the terminal was closed) counts only if it is the first signal. Under `nohup`, SIGHUP is ignored."""

    def __init__(self) -> None:
        self.count = 0
        self.name = ""

    def __enter__(self) -> _Signals:
        numbers = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
            numbers.append(signal.SIGHUP)
        self._before = {number: signal.signal(number, self._count) for number in numbers}
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _count(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP and self.count:
            return
        self.count += 1
        self.name = signal.Signals(number).name
        if self.count > 2:
            raise EndedAtOnce


def _open_store(program: FleetProgram, settings: Settings, root: Path) -> CheckpointFile:
    """Open the checkpoint file of the robot.

    The file is beside the bundle's folder, so that the bundle can be replaced as a whole.
    """

    if settings.state is None:
        _warn("state: nothing is persisted (`state` is null), so the robot cannot rejoin its mission if its agent dies")
        path = None
    else:
        path = root.resolve().parent / settings.state / f"{settings.robot}.state"
    pid, instances = settings.pid, len(program.of_robot(settings.pid))
    return CheckpointFile.open(path, program.of(pid), settings.robot, pid, len(settings.peers), _warn, instances)


def _emitter(quiet: bool) -> Emit:
    """Return a function that prints log lines: all of them, or warnings and errors only."""

    def emit(level: str, line: str) -> None:
        if not quiet or level != "info":
            _print(line)

    return emit


def _outer(squad: Squad, root: Path, overrides: Path | None) -> OuterRobot:
    """Return the outer robot. Its settings may be overridden in the folder of the settings that the user gave."""
    beside = None if overrides is None else overrides.with_name(squad.settings)
    return OuterRobot(squad.program, root / squad.settings, beside if beside is not None and beside.is_file() else None)


def _warn(text: str) -> None:
    _print_message("warning", text)


def _fail(message: str, hint: str, status: int) -> int:
    _print_message("error", message + (f"\n  help: {hint}" if hint else ""))
    return status


def _print_message(level: str, text: str) -> None:
    _print(f"{level}: {text}")


def _print(line: str) -> None:
    """Print a line to standard error without blocking.

    Text that standard error does not accept at once is dropped. A halted or closed terminal (Ctrl-S, a
    broken ssh connection) must not stop the control loop of a flying robot."""
    text = line + "\n"
    with suppress(OSError, ValueError):
        for at in range(0, len(text), PIECE):
            if not _is_writable(sys.stderr):
                return
            sys.stderr.write(text[at : at + PIECE])
            sys.stderr.flush()


def _is_writable(stream: TextIO) -> bool:
    """Return whether a short text can be written to the stream without waiting."""
    try:
        number = stream.fileno()
    except (OSError, ValueError):  # the stream has no file descriptor
        return True
    return bool(select.select([], [number], [], 0.0)[1])
