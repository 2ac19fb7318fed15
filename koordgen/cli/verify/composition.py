"""`koordgen prove fleet.yaml`: the proof of all applications of a fleet."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from koordgen.cli.base.console import INCONCLUSIVE, USAGE, Failure, notify, print_diagnostics

if TYPE_CHECKING:
    from argparse import Namespace

    from koordgen.build.pipeline import CheckedSystem
    from koordgen.lang.semantics.composition import System
    from koordgen.verify.attack.system_runs import SystemContradiction
    from koordgen.verify.prove.report.composition import CompositionVerdicts, Params
    from koordgen.verify.prove.report.show import Attacks
    from koordgen.verify.prove.report.verdict import InvariantVerdict
    from koordgen.verify.prove.smt.solve import CrossCheck, Solver


def prove_fleet(
    options: Namespace, solver: Solver | CrossCheck, seconds: float
) -> tuple[list[list[InvariantVerdict]], dict[str, bytes]]:
    """Prove all applications of a fleet file in at most `seconds`, and print the results.

    Return the verdicts about each application, and the files for `--emit`. Raises Failure, Rejected, SolverMissing."""
    from koordgen.build.pipeline import check_system
    from koordgen.cli.base.alarm import alarm
    from koordgen.lang.semantics.deadline import OutOfTime
    from koordgen.verify.prove.report.composition import files_of, prove_system

    _only_for_programs(options)
    checked = check_system(options.program)
    if options.format == "text":
        once = {part.source.path: part for part in checked.parts}
        print_diagnostics([(part.source, d) for part in once.values() for d in part.diagnostics], options)
    began, params = time.monotonic(), _params(checked)
    try:
        with alarm(seconds):
            found = prove_system(checked.system, solver, params)
    except OutOfTime:
        message = f"the time limit of {seconds:g} s for the whole command is over, and nothing is proved"
        raise Failure(INCONCLUSIVE, message, "try a longer --timeout") from None
    left = max(0.0, seconds - (time.monotonic() - began))
    found, attacks = attacked(checked.system, found, min(options.attack, left))
    solver.stop()
    _print(options, found, attacks)
    verdicts = [part.verdicts for part in found.applications]
    if options.emit is None:
        return verdicts, {}
    lines = {part.source.path.rpartition("/")[2]: part.source for part in checked.parts}
    return verdicts, files_of(found, lambda file, line: lines[file].line(line) if file in lines else "")


def _only_for_programs(options: Namespace) -> None:
    """Refuse options that have a meaning only for one program. Raises Failure."""
    given = {
        "--robots": options.robots != [None],
        "--fleet": options.fleet is not None,
        "--param": bool(options.param),
        "--trace": options.trace is not None,
        "--inner": options.inner is not None,
    }
    for option, is_given in given.items():
        if is_given:
            message = f"{option} is for a single program, and {options.program} names the programs of a fleet"
            help = "a fleet is proved for every number of robots, with the params of the fleet file"
            raise Failure(USAGE, message, help)


def _params(checked: CheckedSystem) -> Params:
    """Return the params that the fleet file gives, as constants; a proof treats all others as arbitrary."""
    given = {settings.name: settings.params for settings in checked.fleet.applications}
    return {
        application.name: {p.name: p.default for p in application.program.params if p.name in given[application.name]}
        for application in checked.system.applications
    }


def attacked(system: System, found: CompositionVerdicts, seconds: float) -> tuple[CompositionVerdicts, list[Attacks]]:
    """Attack the PROVED verdicts by random runs of the fleet, for about `seconds`.

    Return the verdicts, of which a contradicted one is UNSOUND, and the attacked states of each obligation."""
    from koordgen.verify.attack.system_runs import attack_system
    from koordgen.verify.prove.report.show import AttackCount

    proved = [{v.invariant for v in part.verdicts if v.verdict == "PROVED"} for part in found.applications]
    outcomes = [[(v, o.obligation) for v in part.verdicts for o in v.outcomes] for part in found.applications]
    if not seconds or not any(proved):
        why = "the attack is switched off by `--attack 0`"
        return found, [{o.name: AttackCount(0, why) for _, o in each} for each in outcomes]
    said = attack_system(system, proved, seconds)
    attacks: list[Attacks] = []
    for index, each in enumerate(outcomes):
        attacks.append(
            {
                o.name: AttackCount(*said.of_obligation(index, o))
                if v.verdict == "PROVED"
                else AttackCount(0, "the verdict is not PROVED")
                for v, o in each
            }
        )
    if said.contradiction is not None:
        found = _contradicted(found, said.contradiction)
    return found, attacks


def _contradicted(found: CompositionVerdicts, contradiction: SystemContradiction) -> CompositionVerdicts:
    """Return the verdicts after a contradiction: the contradicted one is UNSOUND, and no other is relied upon."""
    run = "; ".join(contradiction.steps)
    reason = f"the prover said PROVED, and a run of {contradiction.robots} robots contradicts it: {run}"
    why = (
        f"{contradiction.name} of {contradiction.application} is UNSOUND, so no proof of this fleet can be relied upon"
    )
    parts = []
    for part in found.applications:
        verdicts: list[InvariantVerdict] = []
        for verdict in part.verdicts:
            is_it = verdict.invariant == contradiction.name
            if verdict.verdict == "PROVED" and is_it and part.application == contradiction.application:
                verdict = verdict._replace(verdict="UNSOUND", reason=reason)
            elif verdict.verdict == "PROVED":
                verdict = verdict._replace(verdict="UNKNOWN", reason=why)
            verdicts.append(verdict)
        parts.append(part._replace(verdicts=verdicts))
    notify(
        f"error: the verdict about {contradiction.name} is UNSOUND: this is a mistake of koordgen, not of your"
        " programs\n  help: please report the fleet file and its programs with this command"
    )
    return found._replace(applications=tuple(parts))


def _print(options: Namespace, found: CompositionVerdicts, attacks: list[Attacks]) -> None:
    from koordgen.cli.base.terminal import coloured_verdicts
    from koordgen.verify.prove.report.composition import document_of, text_of

    if options.format == "json":
        import json

        print(json.dumps(document_of(found, attacks), indent=2), flush=True)
        return
    sys.stdout.write(coloured_verdicts(text_of(found, attacks), sys.stdout))
