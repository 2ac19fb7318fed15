"""Verdicts of a composition: every application of a fleet is proved alone, with the interface of what it imports.

A guarantee that one of its writers does not keep is dropped, and the applications in whose scope it is are proved again
without it. So an invariant is PROVED only if all guarantees that its proof assumes are PROVED in every application.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from koordgen.lang.ir.expr import Expr
from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import System
from koordgen.verify.prove.obligations.generate import obligation_groups
from koordgen.verify.prove.obligations.interface import in_scope
from koordgen.verify.prove.obligations.joint_assumptions import joint_obligations
from koordgen.verify.prove.report.show import Attacks, document, filled, report
from koordgen.verify.prove.report.verdict import InvariantVerdict, Question, consistency_of, prove
from koordgen.verify.prove.smt.emit import folder
from koordgen.verify.prove.smt.obligation import OF_INTERFACE
from koordgen.verify.prove.smt.smtlib import Line
from koordgen.verify.prove.smt.solve import CrossCheck, ObligationResult, Solver

Params = Mapping[str, Mapping[str, Expr]]  # application -> its fixed params


class ApplicationVerdicts(NamedTuple):
    """Verdicts about one application: its invariants and the guarantees in its scope."""

    application: str
    question: Question
    verdicts: list[InvariantVerdict]

    def counts(self) -> Counter[str]:
        """Return the numbers of the application's own obligations ("own") and of those of its interface."""
        kinds = [o.obligation.kind for verdict in self.verdicts for o in verdict.outcomes]
        return Counter("interface" if kind in OF_INTERFACE else "own" for kind in kinds)


class CompositionVerdicts(NamedTuple):
    """Verdicts about all applications of a fleet, in its order.

    `joint`: the obligations that the applications' assumptions hold together, which are those of the composition."""

    applications: tuple[ApplicationVerdicts, ...]
    joint: tuple[ObligationResult, ...]


def question_of(system: System, index: int, params: Params | None = None) -> Question:
    """Return the question about one application, for every number of robots that run it or an exporter.

    `params`: the fixed params of all applications."""
    application, given = system.applications[index], params or {}
    program, interface = in_scope(system, index)
    fixed = dict(given.get(application.name, {}))
    for imported in application.program.imports:
        exporter = system.applications[system.exporter(index, imported)]
        theirs = {f"{imported.name}.{name}": value for name, value in given.get(exporter.name, {}).items()}
        fixed.update({p.name: theirs[p.name] for p in program.params if p.name in theirs})
    return Question(program, None, fixed, interface)


def prove_application(
    system: System, index: int, solver: Solver | CrossCheck, params: Params | None = None
) -> list[InvariantVerdict]:
    """Return a verdict for each invariant of one application, and for each guarantee in its scope.

    The other applications are taken to keep the guarantees. Raises SolverMissing."""
    return prove(question_of(system, index, params), solver)


def prove_system(system: System, solver: Solver | CrossCheck, params: Params | None = None) -> CompositionVerdicts:
    """Return the verdicts about all applications of a system. Raises SolverMissing."""
    questions = [question_of(system, index, params) for index in range(len(system.applications))]
    latest: list[dict[str, InvariantVerdict]] = [{} for _ in questions]
    pending = list(range(len(questions)))
    dropped: dict[str, list[str]] = {}  # label of a guarantee -> the applications that do not keep it
    while pending:
        failed: dict[str, list[str]] = {}
        for index in pending:
            question = questions[index]._replace(interface=questions[index].interface.without(dropped))
            for verdict in prove(question, solver):
                latest[index][verdict.invariant] = verdict
                if _is_guarantee(verdict) and verdict.verdict != "PROVED":
                    failed.setdefault(verdict.invariant, []).append(system.applications[index].name)
        dropped.update(failed)
        labels = [{g.label for g in question.interface.guarantees} for question in questions]
        pending = [index for index, of in enumerate(labels) if of & failed.keys()]
    joint = tuple([ObligationResult(*each) for each in solver.ask_all(joint_obligations(system))])
    contradiction, doubt = consistency_of(joint, solver)
    found = []
    for index, question in enumerate(questions):
        name, scope = system.applications[index].name, {g.label for g in question.interface.guarantees}
        own = latest[index].values()
        verdicts = [_composed(verdict, name, scope, dropped, contradiction, doubt) for verdict in own]
        found.append(ApplicationVerdicts(name, question, verdicts))
    return CompositionVerdicts(tuple(found), joint)


def _is_guarantee(verdict: InvariantVerdict) -> bool:
    return verdict.invariant.startswith("guarantee ")


def _composed(
    verdict: InvariantVerdict, application: str, scope: Collection[str], dropped: Mapping[str, Sequence[str]],
    contradiction: str, doubt: str,
) -> InvariantVerdict:  # fmt: skip
    """Return the verdict of one application in the composition. `scope`: the labels of the guarantees in its scope."""
    if verdict.verdict in ("FALSIFIED", "NOT INDUCTIVE", "UNKNOWN") and not verdict.reason:
        lost = [f"{label} ({' and '.join(names)})" for label, names in dropped.items() if label in scope]
        if lost and not _is_guarantee(verdict):
            return verdict._replace(reason=f"not assumed, because an application does not keep it: {', '.join(lost)}")
    others = [name for name in dropped.get(verdict.invariant, ()) if name != application]
    if verdict.verdict == "PROVED" and others:
        reason = f"{application} keeps the guarantee; of {' and '.join(others)} this is not proved"
        verdict = verdict._replace(verdict="UNKNOWN", reason=reason, rests_on=())
    if contradiction and verdict.verdict == "PROVED":
        return verdict._replace(verdict="VACUOUS", reason=contradiction, rests_on=())
    if doubt and verdict.verdict == "PROVED":
        return verdict._replace(verdict="UNKNOWN", reason=doubt, rests_on=())
    return verdict


def text_of(found: CompositionVerdicts, attacks: Sequence[Attacks]) -> str:
    """Return the verdicts of a composition as text, application by application.

    `attacks`: how each application's obligations were attacked."""
    parts = []
    for part, made in zip(found.applications, attacks, strict=True):
        counts = part.counts()
        text = report(part.verdicts, f"{part.application}: {part.question.program.path}", made)
        said = f"{_many(counts['own'])} of its own, {counts['interface']} of its exports and imports"
        parts.append(f"{text}\n{said}\n")
    return "\n".join([*parts, *filled(_of_composition(found), "", "  ")]) + "\n"


def _of_composition(found: CompositionVerdicts) -> str:
    if not found.joint:
        return (
            "composition: no obligations, because no two applications assume anything about the same sensor, "
            "spec function or variable"
        )
    held = sum(outcome.holds for outcome in found.joint)
    return (
        f"composition: {_many(len(found.joint))} that no application has alone, {held} shown: what the applications "
        "assume holds together"
    )


def _many(count: int) -> str:
    return f"{count} obligation{'s' * (count != 1)}"


def document_of(found: CompositionVerdicts, attacks: Sequence[Attacks]) -> dict[str, Any]:
    """Return the verdicts of a composition as data for JSON: all invariants, each with its application."""
    invariants: list[dict[str, Any]] = []
    for part, made in zip(found.applications, attacks, strict=True):
        of_interface = {
            o.obligation.name for v in part.verdicts for o in v.outcomes if o.obligation.kind in OF_INTERFACE
        }
        for entry in document([(part.verdicts, made)])["invariants"]:
            for obligation in entry["obligations"]:
                obligation["of"] = "interface" if obligation["name"] in of_interface else "application"
            invariants.append({"application": part.application, **entry})
    joint = [
        {"name": o.obligation.name, "result": o.answer.result, "seconds": round(o.answer.seconds, 6)}
        for o in found.joint
    ]
    return {"invariants": invariants, "composition": joint}


def files_of(found: CompositionVerdicts, line: Line) -> dict[str, bytes]:
    """Return the SMT-LIB files of a composition: name -> content. Each name begins with that of its application.

    Each obligation has the form of its last query to the solver. `line`: returns the text of a line of a file."""
    made = [outcome.obligation for outcome in found.joint]
    for part in found.applications:
        last = {o.obligation.name: o.obligation for v in part.verdicts for o in v.outcomes}
        for group in obligation_groups(part.question.program, None, part.question.params, "usual", frozenset(), None,
                                       part.question.interface):  # fmt: skip
            for o in group:
                if o.at is None or o.name in last:
                    asked = replace(last.get(o.name, o), cells=o.cells)
                    made.append(replace(asked, name=f"{part.application}-{o.name}"))
    return folder(made, line)
