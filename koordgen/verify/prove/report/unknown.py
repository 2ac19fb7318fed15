"""Reasons for the verdict UNKNOWN: the hard parts of the program, with possible remedies."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.verify.prove.report.koord_text import to_koord
from koordgen.verify.prove.report.ledger import LEMMAS
from koordgen.verify.prove.smt.obligation import LabelledFormula, Obligation
from koordgen.verify.prove.smt.solve import SolverAnswer
from koordgen.verify.prove.smt.term import NONLINEAR

MAX_NAMED = 3  # largest number of expressions or approximations that one message names


def unknown_reason(program: decl.Program, obligation: Obligation, answer: SolverAnswer, unshown: str) -> str:
    """Return sentences that name an undecided obligation, the reason, and a next step for the user.

    `unshown`: the reason why the solver's counterexample cannot be shown, if the solver reports one."""
    where = f"{obligation.name} ({obligation.file}:{obligation.line})"
    if answer.result == "unknown":
        hard = list(dict.fromkeys(_products(program, obligation)))[:MAX_NAMED]
        if not hard:
            return f"{where}: {answer.reason}{_many(obligation) if is_exhausted(answer) else ''}"
        many = "products or quotients" if len(hard) > 1 else "a product or quotient"
        terms = f"{many} of unknown values: {', '.join(hard)}"
        helps = "; values for params (--param) may help" if program.params else ""
        return f"{where}: {answer.reason}. The obligation is hard because of {terms}{helps}"
    less = [note for note in obligation.notes if note not in LEMMAS][:MAX_NAMED]
    known = f". The prover approximates: {'; '.join(less)}" if less else ""
    loops = any("values that the loop writes" in note for note in obligation.notes)
    say = "an invariant of the loop, an invariant" if loops else "an invariant"
    return f"{where}: {unshown}{known}. Add facts to {say}, a contract or an axiom"


def is_exhausted(answer: SolverAnswer) -> bool:
    """Return whether a solver ran out of time or memory; False if the solver crashed or gave up."""
    return any(word in answer.reason for word in ("--timeout", "memory"))


def _many(obligation: Obligation) -> str:
    """Return a sentence with the size of a linear obligation and the most frequent label of its facts."""
    (label, count), *_ = Counter(fact.label for fact in obligation.facts).most_common(1) or [("", 0)]
    if not count:
        return ""
    return f". The obligation is linear but large: {len(obligation.facts)} facts, {count} of them from `{label}`"


def _products(program: decl.Program, obligation: Obligation) -> Iterator[str]:
    """Yield the program's expressions that make an obligation nonlinear, with their lines."""
    facts: list[LabelledFormula] = [*obligation.facts, *([obligation.goal] if obligation.goal is not None else [])]
    if not any(fact.term.traits & NONLINEAR for fact in facts):
        return
    events = tuple([event for event in program.events if event.name == obligation.event])
    for part in (events, program.init, program.functions, program.properties, program.modules):
        within: set[ir.Expr] = set()  # binary operations inside expressions that were yielded before
        for node in walk(part):
            match node:
                case ir.Binary("*" | "/" | "//" | "%", left, right) if not (_literal(left) or _literal(right)):
                    if node not in within:
                        yield f"`{to_koord(node)}` (line {node.span.line})"
                    within.update(n for n in walk(node) if isinstance(n, ir.Binary))
    if any(fact.label == "distance of two points" and not fact.line for fact in facts):
        yield "distances by the squares of coordinates"


def _literal(node: ir.Expr) -> bool:
    match node:
        case ir.Const():
            return True
        case ir.Unary(_, operand) | ir.Widen(operand):
            return _literal(operand)
        case _:
            return False
