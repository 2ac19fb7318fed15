"""`koordgen collect`: fetches the traces and logs of all robots into one run folder."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

from koordgen.cli.base import console
from koordgen.cli.base.terminal import ProgressLine
from koordgen.cli.operate.fleet_commands import on_hosts
from koordgen.cli.operate.ssh import read_fleet, status_of
from koordgen.fleet.file import Fleet
from koordgen.lang import resources
from koordgen.operate.collect import CannotCollect, Collection, CollectionFolder, collect_all
from koordgen.operate.hosts import HostError
from koordgen.operate.physical import physical_robots
from koordgen.operate.run_folder import ROBOTS, flown, write_source, write_trace
from koordgen.runtime.trace.schema import BadTrace


def collect(options: Namespace) -> int:
    """Fetch the robots' files, then merge their traces.

    Returns exit status 0 if all files were fetched and the traces merged; raises Failure otherwise.
    """
    fleet, folder = read_fleet(options.fleet), Path(options.out)
    try:
        with CollectionFolder(folder) as into:
            found = _collected(options, fleet, into)
            _show(fleet, found)
            merged = _merged(folder, fleet, found)
    except CannotCollect as error:
        raise console.Failure(console.SURROUNDINGS, str(error), error.help) from None
    except OSError as error:
        raise console.Failure(console.SURROUNDINGS, f"{error.filename or folder}: {error.strerror or error}") from None
    if found.missed:
        errors = [error for error in found.missed.values() if isinstance(error, HostError)]
        names = [robot.name for robot in fleet.robots if robot.name in found.missed]
        said = "\n".join(f"  {_why(name, found)}" for name in names)
        help = "run the same command again; it fetches only the missing files"
        raise console.Failure(status_of(errors), f"not all files of {', '.join(names)} were collected\n{said}", help)
    if not merged:
        raise console.Failure(
            console.WRONG, f"{folder} has no merged trace", "each robot's own traces and log are complete"
        )
    print(f"run folder: {folder}; `koordgen report {folder}` shows the run")
    return console.HOLDS


def _collected(options: Namespace, fleet: Fleet, into: CollectionFolder) -> Collection:
    line, total = ProgressLine(sys.stderr), 0

    def progress(count: int) -> None:
        nonlocal total
        total += count
        if not options.quiet:
            line.show(f"{total / 1e6:.1f} MB")

    try:
        return on_hosts(
            options, fleet, physical_robots(fleet, options.fleet), lambda opened: collect_all(opened, into, progress)
        )
    finally:
        line.end()


def _show(fleet: Fleet, found: Collection) -> None:
    width = max(len(robot.name) for robot in fleet.robots)
    for robot in fleet.robots:
        if (each := found.robots.get(robot.name)) is not None:
            print(f"{each.robot:<{width}}  {each.files} files, {each.fetched / 1e6:.3f} MB fetched", flush=True)


def _merged(folder: Path, fleet: Fleet, found: Collection) -> bool:
    """Write the program and the merged trace; return False and print the reason if they cannot be merged."""
    sys.path.insert(0, str(resources.targets().parent))
    apart = f"`koordgen audit {folder / ROBOTS} --program APP.koord` reads the robots' own traces"
    try:
        whole = flown(folder)
        facts = write_source(folder, found.programs, whole.log.program_hash)
        if facts is None:
            console.notify(
                "warning: the traces are not merged: no release on the robots has the program that wrote them, whose "
                f"hash is {whole.log.program_hash}"
                f"\n  help: {apart}"
            )
            return False
        write_trace(folder, whole, facts, fleet)
    except BadTrace as error:
        console.notify(f"warning: the traces cannot be merged: {error}\n  help: {apart}")
        return False
    for note in whole.notes:
        console.notify(f"note: {note}")
    return True


def _why(name: str, found: Collection) -> str:
    error = found.missed[name]
    help = getattr(error, "help", "")
    message = error.message if isinstance(error, HostError) else str(error)
    return f"{name}: {message}" + (f"; {help}" if help else "")
