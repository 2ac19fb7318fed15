"""`koordgen collect`: fetches the traces and logs of all robots into one run folder."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

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
from koordgen.operate.run_levels import flown_level, write_inner_source, write_outer_source
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.audit.history import FleetMission


def collect(options: Namespace) -> int:
    """Fetch the robots' files, then merge their traces.

    Returns exit status 0 if all files were fetched and the traces merged; raises Failure otherwise.
    """
    fleet, folder = read_fleet(options.fleet), Path(options.out)
    try:
        with CollectionFolder(folder) as into:
            found = _collected(options, fleet, into)
            _show([robot.name for robot in physical_robots(fleet, options.fleet)], found)
            merged = _merged(folder, fleet, found)
    except CannotCollect as error:
        raise console.Failure(console.SURROUNDINGS, str(error), error.help) from None
    except OSError as error:
        raise console.Failure(console.SURROUNDINGS, f"{error.filename or folder}: {error.strerror or error}") from None
    if found.missed:
        errors = [error for error in found.missed.values() if isinstance(error, HostError)]
        names = [robot.name for robot in physical_robots(fleet, options.fleet) if robot.name in found.missed]
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


def _show(robots: Sequence[str], found: Collection) -> None:
    width = max(map(len, robots))
    for robot in robots:
        if (each := found.robots.get(robot)) is not None:
            print(f"{each.robot:<{width}}  {each.files} files, {each.fetched / 1e6:.3f} MB fetched", flush=True)


def _merged(folder: Path, fleet: Fleet, found: Collection) -> bool:
    """Write the program and the merged trace; return False and print the reason if they cannot be merged.

    A fleet with squads has programs and a merged trace for each level.
    """
    sys.path.insert(0, str(resources.targets().parent))
    if not fleet.squads:
        apart = f"`koordgen audit {folder / ROBOTS} --program APP.koord` reads the robots' own traces"
        programs = found.programs.get("", [])
        return _merged_level(
            folder, fleet, apart, lambda: flown(folder), lambda wanted: write_source(folder, programs, wanted)
        ) is not None  # fmt: skip
    apart = f"each robot's own trace is in {folder / ROBOTS}"
    programs = [files for each in found.programs.values() for files in each]
    outer = _merged_level(
        folder, fleet, apart, lambda: flown_level(folder, fleet, ""),
        lambda wanted: write_outer_source(folder, programs, wanted),
    )  # fmt: skip
    if outer is None:
        return False
    merged = [
        _merged_level(
            folder / squad, inner, apart, partial(flown_level, folder, inner, squad),
            partial(write_inner_source, folder / squad, found.programs.get(squad, []), outer=outer),
        )
        for squad, inner in fleet.inner_fleets.items()
    ]  # fmt: skip
    return None not in merged


def _merged_level(
    folder: Path,
    fleet: Fleet,
    apart: str,
    flown: Callable[[], FleetMission],
    write_source: Callable[[str], dict[str, Any] | None],
) -> str | None:
    """Write the program and the merged trace of one fleet. Return the hash of its program.

    Return None and print the reason if its traces cannot be merged. `apart`: what to do then.
    """
    try:
        whole = flown()
        wanted = whole.log.program_hash
        facts = write_source(wanted)
        if facts is None:
            console.notify(
                "warning: the traces are not merged: no release on the robots has the program that wrote them, whose "
                f"hash is {wanted}"
                f"\n  help: {apart}"
            )
            return None
        write_trace(folder, whole, facts, fleet)
    except BadTrace as error:
        console.notify(f"warning: the traces cannot be merged: {error}\n  help: {apart}")
        return None
    for note in whole.notes:
        console.notify(f"note: {note}")
    return wanted


def _why(name: str, found: Collection) -> str:
    error = found.missed[name]
    help = getattr(error, "help", "")
    message = error.message if isinstance(error, HostError) else str(error)
    return f"{name}: {message}" + (f"; {help}" if help else "")
