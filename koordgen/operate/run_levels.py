"""Run folder of a fleet with squads: traces and programs of both levels.

The layout is that of a simulated run: `trace.jsonl` is the trace of the outer fleet, and SQUAD/trace.jsonl that of the
fleet of a squad. Each robot of a squad has its own trace in robots/SQUAD.ROBOT, and in `outer` below it the traces of
the squad from the times at which it hosted the squad. These become the trace of the squad, robots/SQUAD.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from koordgen.build.bundle.plan import SOURCE
from koordgen.build.bundle.plan_squads import used_ports
from koordgen.build.bundle.squad_budget import OUTER
from koordgen.build.pipeline import check_file, check_part
from koordgen.fleet.file import Fleet
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.expr import SharedRead
from koordgen.lang.node import Node
from koordgen.operate.run_folder import ROBOTS, TRACE, write_source
from koordgen.runtime.trace.parts import base_of
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.audit.history import FleetMission, mission
from koordgen.verify.audit.trace_files import TraceFile, read_trace_file, trace_files

HOSTED = "outer"  # folder of the traces that a robot wrote as the host of its squad
Programs = Iterable[Mapping[str, bytes]]  # for each release: the files of its programs, by path


class HostedPart(Node):
    """Part of a squad's trace, which one host wrote. `first`, `last`: its first and last round; 0 is `init`."""

    log: TraceFile
    first: float
    last: float


def flown_level(folder: Path, fleet: Fleet, squad: str) -> FleetMission:
    """Return the last mission of one level, from the traces of its robots. Raises BadTrace; OSError.

    fleet: fleet of the level. squad: the squad whose fleet it is; "" for the outer fleet. Its squads' own traces are
    written first.
    """
    paths: list[Path] = []
    for robot in fleet.robots:
        if robot.inner is not None:
            join_hosts(folder, robot.name)
        name = f"{squad}.{robot.name}" if squad else robot.name
        paths += _traces(folder / ROBOTS / name)
    if not paths:
        raise BadTrace(f"{folder / ROBOTS}: there is no trace of a robot of the {squad or 'outer'} fleet")
    return mission([read_trace_file(path) for path in paths])


def _traces(folder: Path) -> list[Path]:
    """Return the traces of one robot; none if the folder has no trace."""
    with suppress(BadTrace):
        return [path for path in trace_files(folder) if path.parent == folder]
    return []


def join_hosts(folder: Path, squad: str) -> None:
    """Write the trace of a squad into robots/SQUAD, with one file for each part that a host wrote. Raises OSError.

    Of a round that several hosts recorded, only the records of the last host are kept; see targets/sim/trace/hosted.py.
    """
    from targets.sim.trace.hosted import replaced_from

    files = [path for place in sorted((folder / ROBOTS).glob(f"{squad}.*")) for path in _traces(place / HOSTED)]
    files.sort(key=lambda path: (path.parent, base_of(path)[1] is None, base_of(path)[1] or 0))
    parts = sorted(_hosted(map(read_trace_file, files)), key=lambda part: (part.first, part.last))
    place = folder / ROBOTS / squad
    shutil.rmtree(place, ignore_errors=True)
    if parts:
        place.mkdir()
    ends = replaced_from([(part.first, part.last) for part in parts])
    for number, (part, until) in enumerate(zip(parts, ends, strict=True), 1):
        name = Path(TRACE) if number == len(parts) else Path(f"{Path(TRACE).stem}-{number}.jsonl")
        (place / name).write_bytes(b"".join(_lines_until(part.log, until)))


def _hosted(logs: Iterable[TraceFile]) -> Iterator[HostedPart]:
    """Yield the parts that have rounds."""
    for log in logs:
        records = [line.record for line in log.lines]
        rounds = [r.get("round", 0) for r in records if r["kind"] in ("init", "round")]
        if rounds:
            yield HostedPart(log, min(rounds), max(rounds))


def _lines_until(log: TraceFile, until: float) -> Iterator[bytes]:
    """Yield the lines of a trace file without the records of rounds from `until` on."""
    dropped = {
        line.number
        for line in log.lines
        if line.record["kind"] in ("init", "round") and line.record.get("round", 0) >= until
    }
    with log.path.open("rb") as file:
        for number, line in enumerate(file, 1):
            if number not in dropped and line.endswith(b"\n"):
                yield line


def write_outer_source(folder: Path, programs: Programs, wanted: str) -> dict[str, Any] | None:
    """Write the outer program; see write_source. `programs`: those of bundles of any level. Raises OSError."""
    outer = [{path: data for path, data in files.items() if not path.startswith(f"{SOURCE}/")} for files in programs]
    return write_source(folder, outer, wanted)


def write_inner_source(folder: Path, programs: Programs, wanted: str, outer: str) -> dict[str, Any] | None:
    """Write the programs of a squad's fleet into its folder SQUAD/source. Return its entries for a trace's header.

    Raises OSError.

    folder: SQUAD in the run folder, which has the outer program already. programs: those of bundles of the squad.
    wanted: hash in the traces of the squad's robots. outer: hash of the outer program.
    Returns None if no candidate has the hash.
    """
    folder.mkdir(exist_ok=True)
    inner = [{path: data for path, data in files.items() if path.startswith(f"{SOURCE}/")} for files in programs]
    facts = write_source(folder, inner, wanted, outer)
    if facts is None:
        return None
    (program,) = (folder.parent / SOURCE).glob("*.koord")
    host = {
        "name": OUTER,
        "members": sorted({member for part in facts["composition"] for member in part["members"]}),
        "variables": _commanded(folder / SOURCE, facts["composition"], check_file(str(program)).program),
    }
    return {
        **facts, "applications": [*facts["applications"], OUTER], "composition": [*facts["composition"], host],
    }  # fmt: skip


def _commanded(source: Path, composition: Iterable[Mapping[str, Any]], outer: Program) -> dict[str, str]:
    """Return the variables of the inner program that the outer program writes, with their names in the store."""
    found = {}
    for part in composition:
        (path,) = (source / part["name"]).glob("*.koord")
        for _, provided in used_ports(outer, check_part(str(path)).program):
            if provided.port.direction == "actuator" and isinstance(provided.value, SharedRead):
                found[provided.value.name] = part["variables"][provided.value.name]
    return found
