"""Verdicts as text of at most 100 columns, and as data for JSON."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from koordgen.verify.prove.report.ledger import LedgerEntry
from koordgen.verify.prove.report.verdict import WELL_DEFINED, InvariantVerdict

if TYPE_CHECKING:  # imported only for type checking, since a proof needs no code that shows counterexamples
    from koordgen.verify.prove.report.explain import FailureExplanation

WIDTH = 100


class AttackCount(NamedTuple):
    """Number of states with which one obligation was attacked.

    `reason`: the reason why there are no states, if the number is 0."""

    states: int
    reason: str


Attacks = Mapping[str, AttackCount]  # name of an obligation -> number of states with which it was attacked


def report(verdicts: Sequence[InvariantVerdict], path: str, attacks: Attacks) -> str:
    """Return the text of all verdicts, followed by the assumptions of the verdicts."""
    robots = verdicts[0].robots if verdicts else None
    fleet = "every number of robots" if robots is None else f"{robots} robot{'s' * (robots != 1)}"
    lines = [f"{path}, for {fleet}", ""]
    for verdict in verdicts:
        lines += [*_verdict(verdict, attacks), ""]
    if not verdicts:
        lines.append("the program has no invariants: there is nothing to prove")
    lines += _ledger(verdicts)
    return "\n".join(line.rstrip() for line in lines).rstrip() + "\n"


def _verdict(verdict: InvariantVerdict, attacks: Attacks) -> Iterator[str]:
    count = len(verdict.outcomes)
    seconds = sum(o.answer.seconds for o in verdict.outcomes)
    measured = f"{count} obligation{'s' * (count != 1)}, {1000 * seconds:.0f} ms"
    if verdict.verdict == "PROVED":
        states = attacked_states(verdict, attacks)
        measured += f"; attacked with {states} state{'s' * (states != 1)}"
    yield f"{verdict.verdict:<14} {verdict.invariant}  ({measured})"
    if verdict.verdict == "PROVED":
        yield from _unattacked(verdict, attacks)
    if verdict.rests_on:
        yield from wrapped(f"rests on {', '.join(verdict.rests_on)}")
    if verdict.reason:
        yield from wrapped(verdict.reason)
    explanation = verdict.explanation
    if explanation is None:
        return
    if explanation.counterexample is None:
        return
    from koordgen.verify.prove.report.table import counterexample, run_lines

    if explanation.run is not None:
        yield from wrapped("a run of the executable semantics from an initial state makes the invariant false:")
        yield from run_lines(explanation.run, explanation.counterexample)
        if suggestion(verdict):
            yield from wrapped(suggestion(verdict))
        return
    yield from counterexample(explanation.counterexample)
    guarded = "guard the operation, or state in an invariant that it always has a value"
    untold = guarded if verdict.invariant == WELL_DEFINED else "none of the tried conjuncts completes the proof"
    if verdict.invariant.startswith("guarantee "):
        untold = "change the event or the guarantee, or state in an invariant why the guarantee is kept"
    yield from wrapped(suggestion(verdict) or untold)


def attacked_states(verdict: InvariantVerdict, attacks: Attacks) -> int:
    """Return the number of states with which an invariant was attacked.

    The obligations of one step share the same states, so these states count once."""
    steps = {o.obligation.event: attacks[o.obligation.name].states for o in verdict.outcomes}
    return sum(steps.values())


def _unattacked(verdict: InvariantVerdict, attacks: Attacks) -> Iterator[str]:
    """Yield the obligations that were not attacked, grouped by the reason."""
    names: dict[str, list[str]] = {}
    for outcome in verdict.outcomes:
        states, reason = attacks[outcome.obligation.name]
        if not states:
            names.setdefault(reason, []).append(outcome.obligation.name)
    for reason, group in names.items():
        which = "" if len(group) == len(verdict.outcomes) else f" {', '.join(group)}"
        yield from wrapped(f"not attacked{which}: {reason}")


def wrapped(text: str) -> list[str]:
    """Return a sentence, broken into lines that fit the text's width."""
    return filled(text, "  ", "  ")


def filled(text: str, first: str, later: str) -> list[str]:
    """Break a text into lines of at most WIDTH columns.

    `first`: the prefix of the first line.
    `later`: the prefix of every other line.

    The module textwrap is not used, because its import takes 0.7 ms."""
    lines, line = [], ""
    for word in text.split():
        if line and len(line) + 1 + len(word) > WIDTH:
            lines.append(line)
            line = ""
        line = f"{line} {word}" if line else (later if lines else first) + word
    return [*lines, line]


def suggestion(verdict: InvariantVerdict) -> str:
    """Return a sentence that explains how to complete the proof; empty if no explanation is known."""
    explanation = verdict.explanation
    if explanation is not None and explanation.with_defaults:
        return (
            f"{verdict.invariant} is PROVED with the params' default values: state in `initially` what the params must "
            "satisfy, or fix them by --param"
        )
    if explanation is None:
        return ""
    if explanation.hint:
        return explanation.hint
    added = " and ".join(f"`{conjunct}`" for conjunct in explanation.lacking)
    if explanation.unassumed:
        said = f"nothing is assumed about {' and '.join(explanation.unassumed)} after a step, so any value is possible"
        if not explanation.supposed:
            return f"{said}; add an `assume` about the sensor to its module"
        supposed = " and ".join(f"`{assumption}`" for assumption in explanation.supposed)
        more = f", and {added} in {verdict.invariant}" if added else ""
        return f"{said}; with {supposed}{more} the invariant is PROVED"
    return f"add {added} to {verdict.invariant}: then it is PROVED" if added else ""


def _ledger(verdicts: Iterable[InvariantVerdict]) -> Iterator[str]:
    entries = dict.fromkeys(entry for verdict in verdicts for entry in verdict.assumptions)
    if entries:
        yield "assumed:"
        yield from ledger_lines(entries)


def ledger_lines(entries: Iterable[LedgerEntry]) -> Iterator[str]:
    """Yield a list of assumptions, each with its place and the component that checks it."""
    for entry in entries:
        place = f" ({entry.file}:{entry.line})" if entry.line else ""
        checked = f"checked: {entry.checked}" if entry.checked else "unchecked"
        yield from filled(f"{entry.kind}: {entry.text}{place}; {checked}", "  - ", "    ")


def document(found: Iterable[tuple[Sequence[InvariantVerdict], Attacks]]) -> dict[str, Any]:
    """Return all verdicts and attacks as data for JSON, one entry for each number of robots."""
    return {"invariants": [_json(verdict, attacks) for verdicts, attacks in found for verdict in verdicts]}


def _json(verdict: InvariantVerdict, attacks: Attacks) -> dict[str, Any]:
    explanation = verdict.explanation
    obligations = [
        {
            "name": o.obligation.name,
            "file": o.obligation.file,
            "line": o.obligation.line,
            "result": o.answer.result,
            "seconds": round(o.answer.seconds, 6),
            **_attacked(attacks[o.obligation.name]),
        }
        for o in verdict.outcomes
    ]
    rests = [
        {
            "kind": "guarantee" if name.startswith("guarantee ") else "invariant",
            "text": name.removeprefix("guarantee "),
            "file": "",
            "line": 0,
            "checked": "PROVED here",
        }
        for name in verdict.rests_on
    ]
    return {
        "name": verdict.invariant,
        "verdict": verdict.verdict,
        "robots": "any" if verdict.robots is None else verdict.robots,
        "obligations": obligations,
        "counterexample": _found(explanation) if explanation is not None else None,
        "suggestion": suggestion(verdict) or verdict.reason or None,
        "assumptions": [*rests, *(entry._asdict() for entry in verdict.assumptions)],
    }


def _attacked(attacked: AttackCount) -> dict[str, Any]:
    states, reason = attacked
    return {"attacked": states} if states else {"attacked": 0, "not_attacked": reason}


def _found(explanation: FailureExplanation) -> dict[str, Any] | None:
    if explanation.counterexample is None:
        return None
    from koordgen.verify.prove.report.table import data

    return data(explanation.counterexample, explanation.run)
