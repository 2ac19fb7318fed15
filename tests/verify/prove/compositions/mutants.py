"""Mutants of the proof of compositions: each breaks one of the rules B, E, I, P and A in one line.

An unsound mutant says PROVED of what a run contradicts. Any other changes the known verdict of a composition.
"""

from __future__ import annotations

from koordgen.verify.prove.obligations import generate, guarantees, interface, joint_assumptions
from koordgen.verify.prove.report import composition
from tests.verify.prove.mutants.catalogue import UNSOUND, WEAKER, Mutant

MUTANTS: dict[str, Mutant] = {
    "first values need not satisfy guarantees": Mutant(
        "B", UNSOUND, generate.interface_parts, "first values that do not satisfy a guarantee",
        "first = own_state_guarantees(problem)", "first = []"),
    "an init need not establish guarantees": Mutant(
        "B", UNSOUND, generate.interface_parts, "an importer's init that breaks a guarantee",
        "after_init = init_guarantees(problem)", "after_init = []"),
    "no other application writes in its init": Mutant(
        "B", UNSOUND, generate.base, "an importer's init breaks an invariant",
        "StartState(part_encoder, problem.interface.moved - problem.interface.commands)",
        "StartState(part_encoder, frozenset())"),
    "guarantees are not known after init": Mutant(
        "B", WEAKER, generate.base, "an invariant that a state guarantee protects at the start",
        'assume_state(part_encoder, ready, problem.interface.foreign, " after init")', "pass"),
    "events need not keep guarantees": Mutant(
        "E", UNSOUND, generate.of_event, "an importer's event that breaks a guarantee",
        "goals += goals_of_step(part_encoder, problem.changed(event), now, after)", "pass"),
    "only exporters keep guarantees": Mutant(
        "E", UNSOUND, interface._MovedGuarantees.guarantees, "an importer's event that breaks a guarantee",
        "if export.variable in self.imported.variables", "if False"),
    "a step guarantee holds since the round's start": Mutant(
        "E", UNSOUND, generate.of_event, "a plain write breaks a step guarantee",
        "problem.changed(event), now, after)", "problem.changed(event), round_start, after)"),
    "a guarantee is known after the step that must keep it": Mutant(
        "E", UNSOUND, generate.of_event, "an importer's event that breaks a guarantee",
        "assume_state(part_encoder, now)", "assume_state(part_encoder, after)"),
    "guarantees are not known before an event": Mutant(
        "E", WEAKER, generate.of_event, "a transaction keeps both guarantees",
        "assume_state(part_encoder, now)", "pass"),
    "nothing is known of other applications since the round's start": Mutant(
        "E", WEAKER, generate.of_event, "a value that was seen is still below",
        "assume_since_start(part_encoder, round_start, now)", "pass"),
    "a guarantee that one application breaks is proved of the others": Mutant(
        "E", WEAKER, composition._composed, "an importer's event that breaks a guarantee",
        'if verdict.verdict == "PROVED" and others:', "if False:"),
    "no invariant is asked of the steps of others": Mutant(
        "I", UNSOUND, generate.interface_parts, "an importer's invariant that the exporter breaks",
        "problem.touched(problem.interface.moved)", "problem.touched(())"),
    "others write nothing that is exported": Mutant(
        "I", UNSOUND, interface.in_scope, "an exporter's invariant that an importer breaks",
        "if export.is_written}", "if False}"),
    "others do not write what is imported": Mutant(
        "I", UNSOUND, interface.in_scope, "an importer's invariant that the exporter breaks",
        'foreign |= {("cell", name) for name in imported.variables}', "pass"),
    "others clear no sensors": Mutant(
        "I", UNSOUND, interface._foreign_ports, "a sensor that another application clears",
        "for _, name in writes for sensor in", "for _, name in () for sensor in"),
    "nothing is known of what others write": Mutant(
        "I", WEAKER, guarantees.of_others, "an exporter's invariant that a guarantee protects",
        "assume_state(part_encoder, after, interface.foreign, AFTERWARDS)", "pass"),
    "nothing is known of how others write": Mutant(
        "I", WEAKER, guarantees.of_others, "a value that was seen is still below",
        'assume_step(part_encoder, now, after, interface.foreign, " by another application")', "pass"),
    "a step guarantee need not be transitive": Mutant(
        "P", UNSOUND, generate.interface_parts, "a guarantee that is not transitive",
        ", (TRANSITIVE, of_transitivity)", ","),
    "a step guarantee need not be reflexive": Mutant(
        "P", UNSOUND, generate.interface_parts, "a guarantee that is not reflexive",
        "(REFLEXIVE, of_reflexivity)", "*()"),
    "what must be transitive is known of both ends": Mutant(
        "P", UNSOUND, guarantees.of_transitivity, "a guarantee that is not transitive",
        "((first, second), (second, third))", "((first, second), (first, third))"),
    "no two applications speak of the same things": Mutant(
        "A", WEAKER, joint_assumptions.connected, "assumptions that contradict one another",
        "if len(cluster.applications) > 1", "if len(cluster.applications) > 9"),
    "the assumptions of one application are left out": Mutant(
        "A", WEAKER, joint_assumptions.merged, "assumptions that contradict one another",
        'modules=_agreeing(all_of("modules"))', "modules=first.modules"),
    "a contradiction of the composition is not reported": Mutant(
        "A", WEAKER, composition._composed, "assumptions that contradict one another",
        'if contradiction and verdict.verdict == "PROVED":', "if False:"),
    "pids are those of the fleet": Mutant(
        "A", WEAKER, joint_assumptions._Renamed.pid, "assumptions that contradict one another on one robot",
        "if self.is_everywhere:", "if True:"),
}  # fmt: skip
