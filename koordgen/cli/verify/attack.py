"""`koordgen prove`: the attack on PROVED verdicts, and `--attack-from`, which repeats an attack."""

from __future__ import annotations

from typing import TYPE_CHECKING

from koordgen.cli.base.console import HOLDS, INCONCLUSIVE, INTERNAL, WRONG, Failure, notify

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Mapping

    from koordgen.lang.ir.decl import Program
    from koordgen.lang.ir.expr import Expr
    from koordgen.verify.attack.judge import Contradiction, ReplayedTrial, Trial
    from koordgen.verify.prove.report.show import Attacks
    from koordgen.verify.prove.report.verdict import InvariantVerdict
    from koordgen.verify.prove.smt.solve import CrossCheck, Solver

LEAST = 0.001  # least seconds of attack for each number of robots


def attack_verdicts(
    program: Program,
    params: Mapping[str, Expr],
    found: list[list[InvariantVerdict]],
    solver: Solver | CrossCheck,
    options: Namespace,
) -> list[Attacks]:
    """Attack the PROVED verdicts for each number of robots, for about `--attack` seconds in total.

    Return the number of attacked states for each obligation. If a state contradicts a verdict, the verdict becomes
    UNSOUND in `found`, and the state is written to a file."""
    left, made = options.attack, []
    for place, verdicts in enumerate(found):
        share = max(left / (len(found) - place), LEAST) if options.attack else 0.0
        attacks, contradiction, spent = _attack_one(program, params, verdicts, solver, share)
        made.append(attacks)
        left -= spent
        if contradiction is not None:
            found[place] = _unsound(verdicts, contradiction)
            _report(program, options.program, verdicts, contradiction)
    return made


def _attack_one(
    program: Program,
    params: Mapping[str, Expr],
    verdicts: list[InvariantVerdict],
    solver: Solver | CrossCheck,
    seconds: float,
) -> tuple[Attacks, Contradiction | None, float]:
    """Attack the PROVED verdicts for one number of robots.

    Return the numbers of attacked states, a contradiction or None, and the seconds that the attack took."""
    from koordgen.verify.prove.report.show import AttackCount

    proved = [v.invariant for v in verdicts if v.verdict == "PROVED"]
    outcomes = [(v, o.obligation) for v in verdicts for o in v.outcomes]
    if not proved or not seconds:
        why = "the attack is switched off by `--attack 0`"
        unproved = "the verdict is not PROVED"
        return {o.name: AttackCount(0, why if v.verdict == "PROVED" else unproved) for v, o in outcomes}, None, 0.0
    from koordgen.verify.attack.attack import attack

    said = attack(program, proved, verdicts[0].robots, params, solver, seconds)
    attacks = {
        o.name: AttackCount(*said.of(o.event, o.invariant))
        if v.verdict == "PROVED"
        else AttackCount(0, "the verdict is not PROVED")
        for v, o in outcomes
    }
    return attacks, said.contradiction, said.seconds


def _unsound(verdicts: list[InvariantVerdict], contradiction: Contradiction) -> list[InvariantVerdict]:
    """Return the verdicts after a contradiction.

    The contradicted verdict becomes UNSOUND. Verdicts whose proofs rest on the contradicted invariant become UNKNOWN.
    """
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


def _report(program: Program, path: str, verdicts: list[InvariantVerdict], contradiction: Contradiction) -> None:
    """Write the contradiction of a verdict to a file, and ask the user to report the file."""
    from koordgen.build.emit.program import program_hash
    from koordgen.verify.attack.file import to_text

    name = f"{program.name}.unsound.json"
    proved = [v.invariant for v in verdicts if v.verdict == "PROVED"]
    blamed = "this is a mistake of koordgen, not of your program"
    try:
        with open(name, "w", encoding="utf-8") as file:
            file.write(to_text(contradiction, proved, program_hash(program), program.path))
    except OSError as error:
        notify(f"error: {name}: {error.strerror or error}\n  help: {blamed}: please report {path} with this command")
        return
    notify(
        f"error: the verdict about {contradiction.breach.invariant} is UNSOUND: {blamed}\n"
        f"  help: please report {name} together with {path};"
        f" `koordgen prove {path} --attack-from {name}` runs the state again"
    )


def attack_from_file(options: Namespace) -> int:
    """Run `--attack-from`: repeat the attack that a file describes, and print the steps of the program."""
    from koordgen.build.emit.program import program_hash
    from koordgen.build.pipeline import check_file
    from koordgen.lang.semantics.exact import exact
    from koordgen.verify.attack.file import MOST_BYTES, BadFile, read_trial
    from koordgen.verify.attack.judge import TrialJudge, TrialNotCovered, UnusableStep

    program = check_file(options.program).program
    name = options.attack_from
    try:
        with open(name, "rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise Failure(WRONG, f"{name}: {error.strerror or error}", "give --attack-from a file that exists") from None
    model = exact(program)
    try:
        given = read_trial(data, model, program_hash(program))
        judge = TrialJudge(model, given.proved, lambda *_: ())
        replayed = judge.replay(given.trial)
    except BadFile as error:
        raise Failure(WRONG, f"{name}: {error}", error.help) from None
    except TrialNotCovered as error:
        raise Failure(
            WRONG, f"{name} contradicts no verdict: {error}", "no verdict of `koordgen prove` covers this state or step"
        ) from None
    except UnusableStep as error:
        raise Failure(
            INCONCLUSIVE, f"{name} cannot be run: {error}", "please report the file together with the program"
        ) from None
    print("\n".join(_shown(model, given.trial, replayed)))
    found = replayed.contradiction
    if found is None:
        print(f"no contradiction: after the last step {', '.join(given.proved)} hold")
        return HOLDS
    print(f"UNSOUND: {found.breach.invariant}: {found.breach.why}, {_where(found)}")
    return INTERNAL


def _shown(program: Program, trial: Trial, replayed: ReplayedTrial) -> Iterator[str]:
    """Yield lines of text: the first state, each step with its changes, and the false conjunct."""
    from koordgen.verify.prove.report.model import failing_conjunct
    from koordgen.verify.prove.report.reach import RunState
    from koordgen.verify.prove.report.table import failed_lines, run_state_lines

    first, *others = replayed.states
    run_states = [RunState(first, "", None, first.round)]
    for act, state in zip(trial.acts, others, strict=True):
        run_states.append(RunState(state, act.event, act.pid, run_states[-1].state.round))
    yield from run_state_lines(run_states)
    contradiction = replayed.contradiction
    for property_ in program.properties:
        if contradiction is not None and (property_.kind, property_.name) == (
            "invariant",
            contradiction.breach.invariant,
        ):
            failed = failing_conjunct(property_, program, contradiction.after)
            yield from failed_lines(failed, "", program.path) if failed is not None else ()
