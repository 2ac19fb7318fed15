"""Run folder of a mission: the robots' own traces, one trace merged from them, and the program.

The commands `report`, `replay`, `export` and `audit` accept it like a run folder of `koordgen sim`.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from koordgen.build.bundle.functions import functions_file
from koordgen.build.bundle.plan import COMPOSITION, PARAMS, SOURCE, store_facts
from koordgen.build.emit.program import program_hash
from koordgen.build.pipeline import Rejected, check_file
from koordgen.fleet.file import Fleet
from koordgen.lang.analyze.params import BadParam, with_params
from koordgen.runtime.trace.schema import FORMAT, BadTrace
from koordgen.verify.audit.history import FleetMission, mission
from koordgen.verify.audit.trace_files import read_trace_file, trace_files
from koordgen.verify.replay.hosted import joined_hash

ROBOTS, TRACE = "robots", "trace.jsonl"
SQUAD = "squad"  # target of a robot that is a squad, in a trace; equal to that of simulated runs (tested)


def flown(folder: Path) -> FleetMission:
    """Return the last mission in which all robots of a run folder took part, from their traces.

    Raises BadTrace.
    """
    return mission([read_trace_file(path) for path in trace_files(folder / ROBOTS)])


def write_source(
    folder: Path, programs: Iterable[Mapping[str, bytes]], wanted: str, outer: str = ""
) -> dict[str, Any] | None:
    """Write the program with the hash `wanted` into a run folder's `source/`. Return its entries for a trace's header.

    Raises OSError.

    folder: the run folder. If its `source/` holds the wanted program already, nothing is written.
    programs: candidates, each as its files by path. Several applications are one candidate.
    outer: for the fleet of a squad, the hash of the outer program; `wanted` is then the hash of both levels.
    Returns None if no candidate has the hash.
    """
    source, made = folder / SOURCE, folder / f".{SOURCE}"
    if (facts := _fitting(source, wanted, outer)) is not None:
        return facts
    for files in programs:
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir()
        for name, data in files.items():
            path = made / name.removeprefix(f"{SOURCE}/")
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(data)
        if (facts := _fitting(made, wanted, outer)) is not None:
            shutil.rmtree(source, ignore_errors=True)
            made.rename(source)
            return facts
    shutil.rmtree(made, ignore_errors=True)
    return None


def _fitting(source: Path, wanted: str, outer: str) -> dict[str, Any] | None:
    """Return what a trace says of the program in a folder `source/` if it has the hash `wanted`."""
    if (source / COMPOSITION).is_file():
        return _composition(source / COMPOSITION, wanted, outer)
    programs = sorted(source.glob("*.koord"))
    if len(programs) != 1:
        return None
    try:
        params = source / PARAMS
        given = dict(json.loads(params.read_bytes())) if params.is_file() else {}
        program = with_params(check_file(str(programs[0])).program, given)
    except (Rejected, BadParam, ValueError):  # for example, the program is written for another version of the language
        return None
    functions = functions_file(program, source, None)
    its = program_hash(program, functions.read_bytes() if functions and functions.is_file() else b"")
    return store_facts(program) if its == wanted else None


def _composition(path: Path, wanted: str, outer: str) -> dict[str, Any] | None:
    """Return what a trace says of several applications if they have the hash `wanted`."""
    try:
        found = json.loads(path.read_bytes())
        names = [each["name"] for each in found["applications"]]
        own = str(found["program_hash"])
        if (joined_hash(own, outer) if outer else own) != wanted:
            return None
        stored = {name: found[name] for name in ("shared", "records")}
        facts = {**stored, "applications": names, "composition": found["applications"]}
        return {**facts, "app": "+".join(names), "program_hash": own} if outer else facts
    except (ValueError, LookupError, TypeError):  # the file is damaged
        return None


def write_trace(folder: Path, whole: FleetMission, facts: Mapping[str, Any], fleet: Fleet) -> None:
    """Write the merged trace of a mission into its run folder.

    facts: entries of the header about the program; see write_source.
    An existing trace is replaced only after the new one is complete. Raises BadTrace if the traces are of another
    fleet; OSError.
    """
    from targets.sim.trace.collected import merge

    names = [robot.name for robot in fleet.robots]
    flew = [history.name if history.lives else name for history, name in zip(whole.histories, names, strict=False)]
    if flew != names:
        raise BadTrace(f"the traces are of the robots {', '.join(flew)}, but the fleet file lists {', '.join(names)}")
    end = whole.last * whole.delta
    header = _header(whole, facts, fleet, end)
    made = folder / f".{TRACE}"
    merge(made, header, [_files(whole, pid) for pid in range(len(names))], end)
    made.replace(folder / TRACE)


def _files(whole: FleetMission, pid: int) -> Sequence[Path]:
    """Return one robot's trace files that record rounds of the mission, in the order of the rounds."""
    return list(dict.fromkeys(life.log.path for life in whole.histories[pid].lives if life.has_rounds))


def _header(whole: FleetMission, facts: Mapping[str, Any], fleet: Fleet, end: float) -> dict[str, Any]:
    return {
        "kind": "header",
        "format": FORMAT,
        "app": whole.app,
        "applications": [whole.app],
        "program_hash": whole.log.program_hash,
        "delta": whole.delta,
        "seed": 0,
        "robots": [{"name": robot.name, "pid": robot.pid, "target": robot.target or SQUAD} for robot in fleet.robots],
        "duration": end,
        "min_separation": max((each.get("min_separation", 0.0) for each in fleet.harness.values()), default=0.0),
        "geofence": [fleet.geofence["lo"], fleet.geofence["hi"]],
        "obstacles": fleet.obstacles,
        "world": fleet.world.facts,
        **facts,
    }
