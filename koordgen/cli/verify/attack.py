"""`koordgen prove`: the attack on verdicts before they are printed; `--attack-from`, which repeats it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from koordgen.cli.base.console import HOLDS, INCONCLUSIVE, INTERNAL, WRONG, Failure, notify

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Mapping

    from koordgen.lang.ir.decl import Program
    from koordgen.lang.ir.expr import Expr
    from koordgen.verify.attack.judge import Contradiction, Followed, Trial
    from koordgen.verify.prove.report.show import Attacks
    from koordgen.verify.prove.report.verdict import Verdict
    from koordgen.verify.prove.smt.solve import Both, Solver

LEAST = 0.001  # seconds for each number of robots that was asked for, however many there are


def attacked(
    program: Program, params: Mapping[str, Expr], found: list[list[Verdict]], solver: Solver | Both, options: Namespace
) -> list[Attacks]:
    """Attack the verdicts for each number of robots, for `--attack` seconds in all; return the numbers of states by
    obligation. A contradicted verdict becomes UNSOUND in `found`, and its state is written to a file."""
    left, made = options.attack, []
    for place, verdicts in enumerate(found):
        share = max(left / (len(found) - place), LEAST) if options.attack else 0.0
        attacks, contradiction, spent = _attacked(program, params, verdicts, solver, share)
        made.append(attacks)
        left -= spent
        if contradiction is not None:
            found[place] = _unsound(verdicts, contradiction)
            _report(program, options.program, verdicts, contradiction)
    return made


def _attacked(
    program: Program, params: Mapping[str, Expr], verdicts: list[Verdict], solver: Solver | Both, seconds: float
) -> tuple[Attacks, Contradiction | None, float]:
    """Attack the verdicts for one number of robots; return also the seconds that this took."""
    from koordgen.verify.prove.report.show import Attacked

    proved = [v.invariant for v in verdicts if v.verdict == "PROVED"]
    outcomes = [(v, o.obligation) for v in verdicts for o in v.outcomes]
    if not proved or not seconds:
        why = "the attack is switched off by `--attack 0`"
        unproved = "the verdict is not PROVED"
        return {o.name: Attacked(0, why if v.verdict == "PROVED" else unproved) for v, o in outcomes}, None, 0.0
    from koordgen.verify.attack.attack import attack

    said = attack(program, proved, verdicts[0].robots, params, solver, seconds)
    attacks = {
        o.name: Attacked(*said.of(o.event, o.invariant))
        if v.verdict == "PROVED"
        else Attacked(0, "the verdict is not PROVED")
        for v, o in outcomes
    }
    return attacks, said.contradiction, said.seconds


def _unsound(verdicts: list[Verdict], contradiction: Contradiction) -> list[Verdict]:
    """Return the verdicts that remain: those that rest on a contradicted one become UNKNOWN."""
    name, why = contradiction.breach
    reason = f"the prover said PROVED, and the executable semantics contradicts it: {_where(contradiction)}, {why}"
    found = []
    for verdict in verdicts:
        if verdict.verdict == "PROVED" and verdict.invariant == name:
            verdict = verdict._replace(verdict="UNSOUND", reason=reason)
        elif verdict.verdict == "PROVED" and name in verdict.rests_on:
            verdict = verdict._replace(verdict="UNKNOWN", reason=f"its proof rests on {name}, which is UNSOUND")
        found.append(verdict)
    return found


def _where(contradiction: Contradiction) -> str:
    act = contradiction.trial.acts[-1]
    robots = len(contradiction.before.robots)
    by = f" of robot {act.pid}" if act.pid is not None else ""
    step = "a step of the environment" if act.event.startswith("(") else f"{act.event}{by}"
    return f"after {step}, in a fleet of {robots}"


def _report(program: Program, path: str, verdicts: list[Verdict], contradiction: Contradiction) -> None:
    """Write the contradiction to a file, and ask for a report."""
    from koordgen.build.emit.program import program_hash
    from koordgen.verify.attack.file import written

    name = f"{program.name}.unsound.json"
    proved = [v.invariant for v in verdicts if v.verdict == "PROVED"]
    told = "this is a mistake of koordgen, not of your program"
    try:
        with open(name, "w", encoding="utf-8") as file:
            file.write(written(contradiction, proved, program_hash(program), program.path))
    except OSError as error:
        notify(f"error: {name}: {error.strerror or error}\n  help: {told}: please report {path}, with this command")
        return
    notify(
        f"error: the verdict about {contradiction.breach.invariant} is UNSOUND: {told}\n"
        f"  help: please report {name} together with {path};"
        f" `koordgen prove {path} --attack-from {name}` runs the state again"
    )


def again(options: Namespace) -> int:
    """`--attack-from`: run the state of a file again, and show what it does."""
    from koordgen.build.emit.program import program_hash
    from koordgen.build.pipeline import check_file
    from koordgen.lang.semantics.exact import exact
    from koordgen.verify.attack.file import MOST_BYTES, BadFile, read
    from koordgen.verify.attack.judge import Judge, Refused, Unusable

    program = check_file(options.program).program
    name = options.attack_from
    try:
        with open(name, "rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise Failure(WRONG, f"{name}: {error.strerror or error}", "name a file that exists") from None
    model = exact(program)
    try:
        given = read(data, model, program_hash(program))
        judge = Judge(model, given.proved, lambda *_: ())
        followed = judge.follow(given.trial)
    except BadFile as error:
        raise Failure(WRONG, f"{name}: {error}", error.help) from None
    except Refused as error:
        raise Failure(WRONG, f"{name} shows nothing: {error}", "no verdict speaks of such a state or step") from None
    except Unusable as error:
        raise Failure(
            INCONCLUSIVE, f"{name} cannot be run: {error}", "report the file together with its program"
        ) from None
    print("\n".join(_shown(model, given.trial, followed)))
    found = followed.contradiction
    if found is None:
        print(f"no contradiction: after the last step {', '.join(given.proved)} hold")
        return HOLDS
    print(f"UNSOUND: {found.breach.invariant}: {found.breach.why}, {_where(found)}")
    return INTERNAL


def _shown(program: Program, trial: Trial, followed: Followed) -> Iterator[str]:
    """The state, the steps and what each changes, which part of the invariant is false."""
    from koordgen.verify.prove.report.model import failing
    from koordgen.verify.prove.report.reach import Moment
    from koordgen.verify.prove.report.table import failed_lines, moment_lines

    first, *others = followed.states
    moments = [Moment(first, "", None, first.round)]
    for act, state in zip(trial.acts, others, strict=True):
        moments.append(Moment(state, act.event, act.pid, moments[-1].state.round))
    yield from moment_lines(moments)
    contradiction = followed.contradiction
    for property_ in program.properties:
        if contradiction is not None and (property_.kind, property_.name) == (
            "invariant",
            contradiction.breach.invariant,
        ):
            failed = failing(property_, program, contradiction.after)
            yield from failed_lines(failed, "", program.path) if failed is not None else ()
