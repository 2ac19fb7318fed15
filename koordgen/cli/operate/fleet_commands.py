"""`koordgen start`, `stop`, `logs` and `doctor --fleet`: work on all hosts in parallel, over SSH."""

from __future__ import annotations

import asyncio
import sys
from argparse import Namespace
from collections.abc import Awaitable, Callable, Sequence
from datetime import datetime
from typing import TypeVar

from koordgen.cli.base import console
from koordgen.cli.base.terminal import coloured_name
from koordgen.cli.operate.ssh import chosen_robots, connection, describe, fleet_hosts, read_fleet, status_of
from koordgen.fleet.file import Fleet
from koordgen.operate.examination import examine, table, to_json, worst
from koordgen.operate.host_tool_archive import archive
from koordgen.operate.hosts import HostError, Sessions, sessions
from koordgen.operate.logs import Line, show_lines
from koordgen.operate.physical import PhysicalRobot, physical_robots
from koordgen.operate.services import Done, ServiceRefused
from koordgen.operate.services import start as start_agents
from koordgen.operate.services import stop as stop_agents

Result = TypeVar("Result")


def start(options: Namespace) -> int:
    """Start the agents of a fleet.

    If hosts have different releases, no agent is started, and Failure is raised.
    """
    fleet = read_fleet(options.fleet)
    robots = chosen_robots(fleet, options.fleet, options.robots)
    try:
        done = on_hosts(options, fleet, robots, start_agents)
    except ServiceRefused as error:
        raise console.Failure(console.WRONG, str(error), error.help) from None
    except HostError as error:
        raise console.Failure(status_of([error]), str(error), _join(error.help, "nothing was started")) from None
    if done.robots:
        print(f"started {_names(robots, done.robots)}, release {done.release[:8]}", flush=True)
    if done.idle:
        print(f"running already: {_names(robots, done.idle)}", flush=True)
    return _ended(done, f"`koordgen stop {options.fleet}` stops those that were started" if done.robots else "")


def stop(options: Namespace) -> int:
    """Stop the agents of a fleet. Each agent first brings its robot to a safe stop."""
    fleet = read_fleet(options.fleet)
    robots = chosen_robots(fleet, options.fleet, options.robots)
    done = on_hosts(options, fleet, robots, lambda opened: stop_agents(opened, options.seconds))
    if done.robots:
        print(f"stopped {_names(robots, done.robots)}", flush=True)
    if done.idle:
        print(f"no agent ran on: {_names(robots, done.idle)}", flush=True)
    return _ended(done, f"in an emergency: `koordgen estop {options.fleet}`")


def logs(options: Namespace) -> int:
    """Show the log lines of all robots of a fleet, ordered by time."""
    fleet = read_fleet(options.fleet)
    robots = chosen_robots(fleet, options.fleet, options.robots)
    lost: list[HostError] = []
    index = {robot.name: place for place, robot in enumerate(physical_robots(fleet, options.fleet))}
    width = max(map(len, index))

    def show(line: Line) -> None:
        at = datetime.fromtimestamp(line.time).strftime("%m-%d %H:%M:%S.%f")[:-3]
        name = coloured_name(f"{line.robot:<{width}}", index[line.robot], sys.stdout)
        print(f"{at}  {name}  {_shown(line.text)}", flush=True)

    def note(error: HostError) -> None:
        lost.append(error)
        console.notify(f"warning: {describe([error])}")

    on_hosts(options, fleet, robots, lambda opened: show_lines(opened, options.lines, options.follow, show, note))
    if lost:
        names = ", ".join(robot for error in lost for robot in error.host.robots)
        raise console.Failure(status_of(lost), f"lines of {names} are missing", "the warnings above give the reasons")
    return console.HOLDS


def doctor(options: Namespace) -> int:
    """Run `doctor` on every robot and print the results; return the greatest exit status."""
    fleet = read_fleet(options.fleet)
    robots = physical_robots(fleet, options.fleet)
    order = [robot.name for robot in robots]
    examined = sorted(on_hosts(options, fleet, robots, examine), key=lambda each: order.index(each.robot))
    print(to_json(examined) if options.format == "json" else table(examined), flush=True)
    return worst(examined)


def on_hosts(
    options: Namespace,
    fleet: Fleet,
    robots: Sequence[PhysicalRobot],
    work: Callable[[Sessions], Awaitable[Result]],
) -> Result:
    """Run `work` with sessions on the hosts of `robots`. Raises Failure."""
    hosts, how = fleet_hosts(fleet, options.fleet, robots), connection(options)

    async def run() -> Result:
        async with sessions(hosts, how, archive()) as opened:
            return await work(opened)

    return asyncio.run(run())


def _ended(done: Done, help: str) -> int:
    if done.failed:
        raise console.Failure(status_of(done.failed), describe(done.failed), help)
    return console.HOLDS


def _names(among: Sequence[PhysicalRobot], robots: Sequence[str]) -> str:
    return ", ".join(robot.name for robot in among if robot.name in robots)


def _join(*parts: str) -> str:
    return "; ".join(filter(None, parts))


def _shown(text: str) -> str:
    """Return a log text without control characters, which could change the terminal's display."""
    return "".join(c if c.isprintable() else " " if c == "\t" else "\N{REPLACEMENT CHARACTER}" for c in text)
