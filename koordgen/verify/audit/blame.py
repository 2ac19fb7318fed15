"""Blame: finds the broken assumptions that can explain a violated invariant.

An assumption counts if it was broken no later than the invariant. No solver is called: the obligations of an invariant
contain all assumptions that a proof of the invariant would use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from koordgen.verify.audit.result import PropertyResult
from koordgen.verify.prove.obligations.generate import obligations
from koordgen.verify.prove.report.ledger import Ledger, LedgerEntry
from koordgen.verify.prove.report.verdict import Question

_KINDS = {"port assumption": "assume", "initially": "initially", "contract": "contract"}


@dataclass(frozen=True, slots=True)
class Blame:
    """Assumptions of the proof of a violated invariant.

    `rests`: all assumptions that the proof uses.
    `broke`: the assumptions that were broken no later than the invariant, the earliest first.
    `unseen`: the assumptions that may have been broken unnoticed, since the traces do not always show whether they
        held.
    `guarantees`: labels of the guarantees of exported variables that the proof uses, such as "guarantee
        mapping.Kept"."""

    invariant: PropertyResult
    rests: tuple[LedgerEntry, ...]
    broke: tuple[tuple[LedgerEntry, PropertyResult], ...]
    unseen: tuple[LedgerEntry, ...]
    guarantees: tuple[str, ...] = ()


def blames(question: Question, results: Sequence[PropertyResult]) -> list[Blame]:
    """Return one Blame for each invariant that was violated or had no value in some round.

    `question`: what is asked of the prover about the program, with the interface to other applications."""
    program = question.program
    violated = [f for f in results if f.of == "invariant" and f.first is not None]
    if not violated:
        return []
    shown = obligations(program, params=question.params, interface=question.interface)
    spans = {p.name: range(p.span.line, p.span.end_line + 1) for p in program.properties if p.kind == "invariant"}
    found, ledger = [], Ledger(program)
    for invariant in violated:
        names = [invariant.name]
        # the loop body appends all invariants to `names` that the proof assumes, directly or indirectly
        for name in names:
            lines = {fact.line for o in shown if o.invariant == name for fact in o.facts if fact.file == program.path}
            names += [other for other, span in spans.items() if other not in names and lines.intersection(span)]
        used = [o for o in shown if o.invariant in names]
        labels = {fact.label for o in used for fact in o.facts}
        assumed = [
            guarantee.label
            for guarantee in question.interface.guarantees
            if any(label == guarantee.label or label.startswith(f"{guarantee.label} ") for label in labels)
        ]
        found.append(replace(_blame(invariant, ledger.of(used), results), guarantees=tuple(assumed)))
    return found


def _blame(invariant: PropertyResult, rests: tuple[LedgerEntry, ...], results: Sequence[PropertyResult]) -> Blame:
    assert invariant.first is not None
    broke, unseen = [], []
    for entry in rests:
        result = next((f for f in results if f.line == entry.line and f.of == _KINDS.get(entry.kind)), None)
        if result is not None and result.first is not None and result.first.observation <= invariant.first.observation:
            broke.append((entry, result))
        elif entry.kind == "axiom" or (result is not None and (result.unknown or not result.rounds)):
            unseen.append(entry)
    broke.sort(key=lambda each: each[1].first.observation if each[1].first is not None else invariant.first.observation)  # type: ignore[union-attr]
    return Blame(invariant, rests, tuple(broke), tuple(unseen))
