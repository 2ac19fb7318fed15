"""Trace of a run of a system (docs/reference/trace.md): for each step, one round record for each instance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from koordgen.build.emit.system import is_alone
from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.system import view
from koordgen.runtime.trace.schema import (
    FORMAT,
    LEFT_OUT,
    ApplicationRecord,
    Header,
    PoseRecord,
    RobotName,
    Round,
    SharedVariable,
    TraceRecord,
    Violation,
)
from koordgen.verify.explore.system.search import SystemRunState, SystemViolation
from koordgen.verify.prove.report.koord_text import to_koord
from koordgen.verify.prove.report.model import plain_value
from koordgen.verify.prove.report.reach import RunState
from koordgen.verify.prove.report.trace import NOBODY, RunOrigin, json_lines, step_records


def trace(found: SystemViolation, system: System, robots: Sequence[str], origins: Sequence[RunOrigin]) -> str:
    """Return the run to a violation as the text of a trace file.

    `robots`: the names of the robots. `origins`: the origin of each application's part of the run, with the hash of the
    system. A record's `pid` is the robot's place in the fleet file. Shared variables and params have the name of their
    application in front. With one application on all robots, the trace is that of its program."""
    header = _header(found, system, robots, origins[0].program_hash)
    records: list[TraceRecord] = [header, *_steps(found.run_states, system, origins)]
    line = found.failed.formula.span.line if found.failed else found.line
    detail = f"false: {to_koord(found.failed.formula)}" if found.failed else found.reason
    place = name = ""
    if found.application is not None:
        application = system.applications[found.application]
        place, name = f"{application.program.path}:{line}", application.name
    t, pid, event = float(found.run_states[-1].round), LEFT_OUT, LEFT_OUT
    if found.culprit is not None:
        pid, event = system.instances()[found.culprit[0]].robot, found.culprit[1]
    records.append(Violation(t, "property", tuple(robots), detail, found.name, place, LEFT_OUT, name, pid, event))
    return json_lines(records)


def _header(found: SystemViolation, system: System, robots: Sequence[str], hashed: str) -> Header:
    names, composed = tuple([application.name for application in system.applications]), not is_alone(system)
    params = zip(names, found.run_states[0].state.params, strict=True)
    before = [f"{name}." if composed else "" for name in names]
    composition = [
        ApplicationRecord(
            application.name,
            application.members,
            {v.name: f"{names[system.owner(index, v.name)]}.{v.name}" for v in application.program.shared},
        )
        for index, application in enumerate(system.applications)
    ]
    return Header(
        format=FORMAT,
        app="+".join(names) if composed else system.applications[0].program.name,
        program_hash=hashed,
        delta=1.0,
        seed=0,
        robots=tuple([RobotName(robot, place, "proof") for place, robot in enumerate(robots)]),
        duration=float(found.run_states[-1].round),
        shared=tuple([
            SharedVariable(f"{prefix}{variable.name}", variable.kind, str(variable.type))
            for index, prefix in enumerate(before)
            for variable in system.own(index)
        ]),
        applications=names,
        counterexample="run",
        params={
            f"{prefix}{param}": plain_value(value)
            for prefix, (_, given) in zip(before, params, strict=True)
            for param, value in given.items()
        },
        given=(),
        composition=tuple(composition) if composed else LEFT_OUT,
    )  # fmt: skip


def _steps(
    run_states: Sequence[SystemRunState], system: System, origins: Sequence[RunOrigin]
) -> Iterator[PoseRecord | Round]:
    runs = [_run_of(run_states, system, index) for index in range(len(system.applications))]
    for index in range(len(run_states)):
        placed = set[int]()
        for application, run, about in zip(system.applications, runs, origins, strict=True):
            for record in step_records(application.program, run, index, about, application.name, application.members):
                if isinstance(record, Round):
                    yield record
                elif record.pid not in placed:  # several applications may measure one position
                    placed.add(record.pid)
                    yield record


def _run_of(run_states: Sequence[SystemRunState], system: System, application: int) -> tuple[RunState, ...]:
    """Return a run of the system as one application sees it. In steps of other applications, nobody acts."""
    instances, found = system.instances(), []
    for state, event, number, round_ in run_states:
        pid = None
        if number is not None:
            pid = instances[number].pid if instances[number].application == application else NOBODY
        found.append(RunState(view(system, state, application), event, pid, round_))
    return tuple(found)
