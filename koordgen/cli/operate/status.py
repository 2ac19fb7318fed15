"""`koordgen status`: shows a table of a fleet's robots, once or periodically."""

from __future__ import annotations

import asyncio
import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from koordgen.cli.base import console
from koordgen.operate.estop import CannotStop, contacts_of, find_fleet
from koordgen.operate.status import StatusAnswer, ask_all, odd_releases, table, to_json, with_hosts

if TYPE_CHECKING:
    from koordgen.operate.hosts import Host

_EVERY = 1.0  # seconds between two tables that `--watch` prints


def status(options: Namespace) -> int:
    """Ask all robots and print their answers; return the exit status.

    The exit status is 0 if all robots answered and have the same release; otherwise Failure is raised.
    """
    try:
        fleet = find_fleet(Path(options.fleet), console.notify)
        contacts = contacts_of(fleet, options.fleet, options.key, console.notify)
    except CannotStop as error:
        raise console.Failure(console.WRONG, str(error), f"{error.help}nobody was asked") from None
    while True:
        began = time.monotonic()
        answers = _ask_hosts(options, ask_all(contacts))
        if options.watch and options.format == "text" and sys.stdout.isatty():
            print("\x1b[H\x1b[2J", end="")  # cursor home, then clear the screen
        print(to_json(answers) if options.format == "json" else table(answers), flush=True)
        if not options.watch:
            return _verdict(options, answers)
        time.sleep(max(0.0, began + _EVERY - time.monotonic()))


def _ask_hosts(options: Namespace, answers: list[StatusAnswer]) -> list[StatusAnswer]:
    """Return the robots' answers, or their hosts' answers over SSH for robots that did not answer.

    A host can answer only if the fleet file names it.
    """
    silent = [each.place.name for each in answers if each.report is None]
    hosts = _hosts_of(options, silent) if silent else ()
    if not hosts:
        return answers
    from koordgen.cli.operate.ssh import connection
    from koordgen.operate.host_tool_archive import archive
    from koordgen.operate.hosts import NoHosts, sessions
    from koordgen.operate.installed import installed

    async def ask() -> list[StatusAnswer]:
        async with sessions(hosts, connection(options), archive()) as opened:
            found, failed = await installed(opened)
        return with_hosts(answers, found, {robot: error.message for robot, error in failed.items()})

    try:
        return asyncio.run(ask())
    except NoHosts as error:
        console.notify(
            f"warning: the hosts of {', '.join(silent)} were not asked over SSH: {error}\n  help: {error.help}"
        )
        return answers


def _hosts_of(options: Namespace, robots: Sequence[str]) -> Sequence[Host]:
    """Return the hosts that the fleet file names for `robots`.

    Return no hosts if the file has errors, or if `options.fleet` is a folder of bundles.
    """
    from koordgen.build.pipeline import Rejected
    from koordgen.cli.operate.ssh import read_fleet
    from koordgen.operate.hosts import hosts_of
    from koordgen.operate.physical import physical_robots

    if Path(options.fleet).is_dir():
        return ()
    try:
        fleet = read_fleet(options.fleet)
    except Rejected:
        return ()
    known = physical_robots(fleet, options.fleet)
    return hosts_of([r for r in known if r.login is not None and r.name in robots], fleet.deployment)


def _verdict(options: Namespace, answers: Sequence[StatusAnswer]) -> int:
    if odd := odd_releases(answers):
        help = "build once with one fleet file, and copy every robot's bundle; `koordgen deploy` does both"
        raise console.Failure(_silent_status(answers), f"different release from most robots: {', '.join(odd)}", help)
    silent = [each for each in answers if each.report is None]
    if silent and all(each.host is not None and each.host.release and not each.host.running for each in silent):
        help = f"`koordgen start {options.fleet}` starts the agents"
        raise console.Failure(console.SURROUNDINGS, f"the agents of {_names(silent)} do not run", help)
    if silent:
        help = "check that computers and agents run; on a robot, `python3 BUNDLE --status` shows its state"
        raise console.Failure(console.SURROUNDINGS, f"no answer from {_names(silent)}", help)
    return console.HOLDS


def _silent_status(answers: Sequence[StatusAnswer]) -> int:
    """Return the exit status for different releases or missing answers.

    It is SURROUNDINGS if neither a robot nor its host answered, else WRONG.
    """
    return console.SURROUNDINGS if any(each.report is None and each.host is None for each in answers) else console.WRONG


def _names(answers: Sequence[StatusAnswer]) -> str:
    return ", ".join(each.place.name for each in answers)
