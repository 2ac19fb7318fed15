"""Mutants of the prover, by the rule of docs/reference/semantics.md, "Verification conditions", that each breaks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from koordgen.verify.prove.encode import (
    builtins,
    context,
    expr,
    function,
    geometry,
    lists,
    loop,
    quantifier,
    state,
    stmt,
)
from koordgen.verify.prove.obligations import (
    generate,
    goal,
    guarantees,
    interface,
    interference,
    loops,
    mission_start,
    output,
    priority,
)
from koordgen.verify.prove.obligations.part_encoder import PartEncoder, ProofProblem
from koordgen.verify.prove.report import verdict
from koordgen.verify.prove.smt import term as t

SymbolicFrame, Turns = stmt.SymbolicFrame, stmt._Turns
UNSOUND, WEAKER = True, False


class Mutant(NamedTuple):
    """One changed line of the prover: `line` stands once in the source of `where`, and `instead` replaces it.

    `rule`: the rule that is broken; "values" for the encoding of values. `unsound`: with the mutant the prover says
    PROVED of what a run breaks; otherwise proofs fail, or a contradiction of assumptions is not seen. `program`: the
    one of `PROGRAMS` in programs.py that shows it."""

    rule: str
    unsound: bool
    where: Callable[..., Any]
    program: str
    line: str
    instead: str


MUTANTS: dict[str, Mutant] = {
    # V1: start
    "what init writes is not looked at": Mutant(
        "V1", UNSOUND, generate.base, "init",
        "goal(part_encoder, p, ready)) for", "goal(part_encoder, p, ready.launch)) for"),
    "an unset target is the origin": Mutant(
        "V1", UNSOUND, mission_start.LaunchState.of,
        "an unset target was the origin where the program does not read the position",
        "if name in self.held:", "if False:"),
    "of several writers in init the lowest pid counts": Mutant(
        "V1", UNSOUND, mission_start.StartState._cell, "init",
        "t.at_most(index, last)", "t.at_most(last, index)"),
    "robot 0 alone writes shared variables in init": Mutant(
        "V1", UNSOUND, mission_start.StartState._cell, "init",
        'context.new(f"last to write {key[1]}", t.INT)', "t.integer(0)"),
    "what holds initially is not known": Mutant(
        "V1", WEAKER, mission_start.assume_initially, "geofence",
        "part_encoder.problem.initially, launch", "(), launch"),
    "of other robots' init it is not known that it ended": Mutant(
        "V1", WEAKER, mission_start.StartState.run, "an init that ended",
        "t.implies(context.within(robot), found.ended)", "t.TRUE"),
    # V2: event
    "the invariants are known after the event": Mutant(
        "V2", UNSOUND, generate.of_event, "a conjunction",
        "part_encoder.holds(problem.invariants, now)", "part_encoder.holds(problem.invariants, after)"),
    "an invariant that speaks of shared variables is not asked of events": Mutant(
        "V2", UNSOUND, ProofProblem.changed, "another robot's `reached`",
        'if key[0] != "temp"}', 'if key[0] not in ("temp", "cell")}'),
    "an event writes the variables of all robots": Mutant(
        "V2", UNSOUND, state.UpdatedState.of, "frame",
        "own = self.context.same(robot, self.own)", "own = t.TRUE"),
    "an event writes the variables of no robot": Mutant(
        "V2", UNSOUND, state.UpdatedState.of, "a conjunction",
        "own = self.context.same(robot, self.own)", "own = t.FALSE"),
    "bystanders are never looked at": Mutant(
        "V2", UNSOUND, goal.goal, "exclusion with stale copies",
        "bystanders = cells or not", "bystanders = False and not"),
    "of a conjunction only the first part is shown": Mutant(
        "V2", UNSOUND, goal._Goals.add, "a conjunction",
        "self.add(right, guard, robots)", "pass"),
    "other robots change nothing in a round": Mutant(
        "V2", UNSOUND, interference.assume_interference, "another robot's `reached`",
        "parts.append(t.or_(same, *ran))", "parts.append(same)"),
    "another robot's `reached` at the round's start is what it is now": Mutant(
        "V2", UNSOUND, generate.of_event, "another robot's `reached`",
        "problem.sensors - problem.cleared", "problem.sensors"),
    "a command does not clear `reached`": Mutant(
        "V2", UNSOUND, mission_start.cleared_sensors, "a command",
        "if (any_wrote := t.any_of(wrote)) is not t.FALSE:", "if False:"),
    "an invariant that failed is relied upon": Mutant(
        "V2", UNSOUND, verdict.prove, "an invariant that rests on a false one",
        "if p not in without]", "if True]"),
    "shared variables at the round's start are those now": Mutant(
        "V2", UNSOUND, state.RoundStart.of, "exclusion with stale copies",
        "return self.other.of(key, robot)", "return self.now.of(key, robot)"),
    "a shared variable that a path does not write is as it was at the round's start": Mutant(
        "V2", UNSOUND, stmt.SymbolicFrame.changes,
        "a path that does not write a shared variable undid another robot's write",
        "self.seen is not self.now", "False"),
    "invariants are not known before an event": Mutant(
        "V2", WEAKER, generate.of_event, "priority",
        "part_encoder.holds(problem.invariants, now)", "pass"),
    "the guard is not known to hold": Mutant(
        "V2", WEAKER, generate.assume_guard, "geofence",
        "context.learn(parts[-1])\n    context.fact(", "pass\n    str("),
    # V21: commands
    "nobody commands the fleet": Mutant(
        "V21", UNSOUND, interface.Interface.with_commands, "a fleet that is commanded",
        "if commands else self", "if False else self"),
    "commands change nothing": Mutant(
        "V21", UNSOUND, guarantees.of_others, "a fleet that is commanded",
        '"@after"), interface.moved)', '"@after"), frozenset())'),
    # V3: environment
    "the environment does not move": Mutant(
        "V3", UNSOUND, state.HavockedState.of, "no bound on targets",
        "self.after if key in self.moved else self.before", "self.before"),
    "an invariant is known after the environment's step of itself": Mutant(
        "V3", UNSOUND, output.PartOutput.before, "no bound on targets",
        "names[names.index(wanted.invariant) :]", "names[names.index(wanted.invariant) + 1 :]"),
    "no invariant is asked of the environment's step": Mutant(
        "V3", UNSOUND, generate.environment, "no bound on targets",
        "problem.touched(problem.sensors)", "problem.touched(())"),
    "primed ports are those before the step": Mutant(
        "V3", UNSOUND, PartEncoder._each_robot, "rising",
        "RobotScope(before, after, robot, {})", "RobotScope(after, before, robot, {})"),
    "assumptions are not known": Mutant(
        "V3", WEAKER, PartEncoder._each_robot, "geofence",
        "if parts:", "if not parts:"),
    # V4: demands
    "of the operations of an event only the first needs a value": Mutant(
        "V4", UNSOUND, output.PartOutput.all, "two divisions",
        "Goal(WELL_DEFINED, parts)", "Goal(WELL_DEFINED, parts[:1])"),
    "no operation needs a value": Mutant(
        "V4", WEAKER, context.ProofContext.demand, "an init that ended",
        "if formula is not t.TRUE:", "if False:"),
    "a guard that holds shows that its own operations have a value": Mutant(
        "V4", UNSOUND, generate.assume_guard, "a guard that holds showed that its own operations have a value",
        "t.all_of([demand.term for demand in context.demands])", "t.TRUE"),
    "a contract shows that an operation before the call has a value": Mutant(
        "V4", UNSOUND, context.ProofContext.reached, "a contract behind a division",
        "[*self.path, *[demand.term for demand in self.demands]]", "self.path"),
    "operations of init need no value": Mutant(
        "V4", UNSOUND, generate.of_init, "an init that fails",
        "out.all(goals, run.demands, ())", "out.all(goals, (), ())"),
    "that an event has its values is known where it is to be shown": Mutant(
        "V4", UNSOUND, output.PartOutput.all, "a contract behind a division",
        '"well-defined", ()))', '"well-defined", ended))'),
    "an index may be one beyond the last": Mutant(
        "V4", UNSOUND, context.ProofContext.within, "init of others",
        "t.less(index, self.size)", "t.at_most(index, self.size)"),
    # V5: consistency
    "a step of the environment is never looked at for contradictions": Mutant(
        "V5", WEAKER, generate.consistent, "contradiction",
        "part_encoder.ports(now, after)", "pass"),
    "answers of ports are never looked at for contradictions": Mutant(
        "V5", WEAKER, generate.consistent, "contradicting plans",
        "part_encoder.any_answers(ArbitraryState(context, problem.types))", "pass"),
    "axioms are never looked at for contradictions": Mutant(
        "V5", WEAKER, generate.consistent, "contradicting axioms",
        "part_encoder.any_axioms()", "pass"),
    "contracts are never looked at for contradictions": Mutant(
        "V5", WEAKER, generate.consistent, "a contradicting contract",
        "part_encoder.any_contracts()", "pass"),
    "what an event calls is never looked at for contradictions": Mutant(
        "V5", WEAKER, generate.of_event, "a contract that contradicts itself for one argument",
        "if any(part_encoder.is_assumed_of_calls(fact) for fact in out.facts):", "if False:"),
    # V6: assignment
    "of two assignments the first counts": Mutant(
        "V6", UNSOUND, SymbolicFrame.put, "the last of three",
        "self.env[key] = value", "self.env.setdefault(key, value)"),
    "a read yields the value before the event": Mutant(
        "V6", UNSOUND, SymbolicFrame.own, "a loop that counts",
        "if key in self.env:", "if key in self.env and key[0] != 'local':"),
    "an allread variable as a whole is that before the event": Mutant(
        "V6", UNSOUND, SymbolicFrame.slots, "an allread variable as a whole",
        'for key, value in self.env.items() if key == ("slot", name)', "for key, value in ()"),
    "an assignment to a port is no command": Mutant(
        "V6", UNSOUND, SymbolicFrame.assign, "a command",
        'if key[0] in ("cell", "port"):', 'if key[0] == "cell":'),
    # V7: if
    "values after an `if` are those of the other branch": Mutant(
        "V7", UNSOUND, SymbolicFrame.merged, "the first of three",
        "found[key] = pick(condition, a, b)", "found[key] = pick(condition, b, a)"),
    "the second branch sees what the first one wrote": Mutant(
        "V7", UNSOUND, SymbolicFrame.branch, "a branch that reads",
        "self.restore(before)", "pass"),
    "of an `if` only the first branch counts": Mutant(
        "V7", UNSOUND, SymbolicFrame.branch, "a branch that reads",
        "self.merged(condition, after, self.snapshot())", "after"),
    "what stands in a branch is demanded always": Mutant(
        "V7", WEAKER, SymbolicFrame.branch, "frame",
        "with self.context.under(condition):", "with self.context.under():"),
    # V8: stop, break, continue, return
    "an event never ends with `stop`": Mutant(
        "V8", UNSOUND, generate.of_event, "stop",
        "t.any_of([live, *[t.all_of(e.path) for e in frame.exits]])", "live"),
    "what is written before a `stop` is lost": Mutant(
        "V8", UNSOUND, SymbolicFrame.writes, "stop",
        "for left in self.exits:", "for left in ():"),
    "a `break` keeps nothing of its turn": Mutant(
        "V8", UNSOUND, SymbolicFrame.loop, "break",
        "self.merged(condition, left.env, self.snapshot())", "self.snapshot()"),
    "a `continue` keeps nothing of its turn": Mutant(
        "V8", UNSOUND, SymbolicFrame.run, "continue",
        "self.merged(condition, left.env, self.snapshot())", "self.snapshot()"),
    "behind a `continue` there is no next turn": Mutant(
        "V8", UNSOUND, SymbolicFrame.run, "continue",
        "live = t.or_(live, condition)", "live = live"),
    # V9: atomic
    "a plain event reads what is now": Mutant(
        "V9", UNSOUND, generate.of_event, "another robot's `reached`",
        "round_start if event.lock is None else now", "now"),
    "a transaction's guard held at the round's start": Mutant(
        "V9", UNSOUND, interference._guard, "a transaction after the round's start",
        "if event.lock is None or all", "if True or all"),
    "a transaction reads the round's start": Mutant(
        "V9", WEAKER, generate.of_event, "mutual exclusion",
        "round_start if event.lock is None else now", "round_start"),
    # V10: function
    "operations of functions need no value": Mutant(
        "V10", UNSOUND, function.Functions.run, "a function that divides",
        "context.demand(demand.term, demand.label, demand.line)", "pass"),
    "a second call has the result of the first": Mutant(
        "V10", UNSOUND, function.Functions.run, "two calls",
        "(function.name, *map(_identity, args))", "(function.name,)"),
    "of several `return`s the last counts": Mutant(
        "V10", UNSOUND, function.Functions.result, "two returns",
        "pick(t.all_of(left.path[depth:]), ", "pick(t.FALSE, "),
    "a function that calls an extern function is run outside of all branches": Mutant(
        "V10", UNSOUND, function.Functions.is_closed, "a contract within a function",
        "all(f is not None and self.is_closed(f) for f in functions)", "True"),
    # V11: extern function
    "`requires` is not demanded": Mutant(
        "V11", UNSOUND, function.Functions.extern, "requires",
        "for formula in required:", "for formula in ():"),
    "`ensures` is known where no call is made": Mutant(
        "V11", UNSOUND, function.Functions.extern, "a contract behind a division",
        "self.context.fact_if_reached(", "self.context.fact("),
    "`ensures` is not known": Mutant(
        "V11", WEAKER, function.Functions.extern, "leaders",
        "for formula, line in ensured:", "for formula, line in ():"),
    # V12: port
    "a port answers each call alike": Mutant(
        "V12", UNSOUND, generate.of_event, "two plans",
        'context.any(f"{node.module}.{node.port}", node.type)',
        'context.function(f"{node.module}.{node.port}", (), node.type)'),
    "an assumption about a call holds where none is made": Mutant(
        "V12", UNSOUND, PartEncoder._of_answer, "a plan on one branch",
        "self.context.fact_if_reached(", "self.context.fact("),
    "an assumption about ports after the step holds before it": Mutant(
        "V12", UNSOUND, PartEncoder._of_answer, "a plan for the next level",
        'or any(n.primed for n in reads):', ":"),
    "of a port's answer nothing is known": Mutant(
        "V12", WEAKER, PartEncoder.answered, "contradicting plans",
        "for module in self.problem.program.modules:", "for module in ():"),
    # V13: priority
    "an earlier guard is false now, not at the round's start": Mutant(
        "V13", UNSOUND, priority.assume_priority, "priority at the round's start",
        "own, now, round_start, _no_port", "own, now, now, _no_port"),
    "guards of later events of the block are false, too": Mutant(
        "V13", UNSOUND, priority.assume_priority, "priority of the first",
        "part_encoder.problem.program.earlier(event)",
        "[e for e in part_encoder.problem.program.events if e is not event and e.priority == event.priority != None]"),
    "earlier guards are not known to be false": Mutant(
        "V13", WEAKER, priority.assume_priority, "priority",
        "context.fact(t.not_(guard))", "pass"),
    # V14: quantifiers
    "instances of what is shown need no value": Mutant(
        "V14", UNSOUND, quantifier.quantified, "a formula that has no value counted as true under a negation",
        "elif e.strict and _may_fail(e, node, scope):", "elif False:"),
    "what holds of robot 0 holds of all": Mutant(
        "V14", UNSOUND, quantifier.proxy, "a witness",
        "some = context.new(name, t.INT)", "some = t.integer(0)"),
    "where not all have it, none has it": Mutant(
        "V14", UNSOUND, quantifier.proxy, "an allread variable as a whole",
        "t.implies(found, instance(index))", "t.equals(found, instance(index))"),
    "of a formula with `forall` no witness is known": Mutant(
        "V14", WEAKER, quantifier.proxy, "others' parts",
        "context.fact(t.or_(found, t.not_(first)),", "str("),
    # V15: unrolled loop
    "the last element of a loop is left out": Mutant(
        "V15", UNSOUND, SymbolicFrame.unrolled, "the last of three",
        "for element in elements:", "for element in elements[:-1]:"),
    "turns behind a `break` are taken": Mutant(
        "V15", UNSOUND, SymbolicFrame.unrolled, "the first of three",
        "with self.context.under(live):", "with self.context.under():"),
    # V16: search
    "a search always finds something": Mutant(
        "V16", UNSOUND, SymbolicFrame.search, "a search for nothing",
        "t.implies(found, left)", "t.and_(found, left)"),
    "a search that finds nothing has values of its own": Mutant(
        "V16", UNSOUND, SymbolicFrame.demanded, "a search that fails",
        "t.implies(found, over.not_after(any_, first))", "t.and_(found, over.not_after(any_, first))"),
    "elements before the one that is found need no value": Mutant(
        "V16", UNSOUND, SymbolicFrame.search, "a search past a zero",
        "self.demanded(loop, over, found, first, start)", "pass"),
    "what a search leaves with is the last element": Mutant(
        "V16", UNSOUND, SymbolicFrame.search, "a search for the first",
        "over.not_after(first, index)", "over.not_after(index, first)"),
    "an element that leaves a search may be overlooked": Mutant(
        "V16", WEAKER, SymbolicFrame.search, "searching",
        "context.for_all(instance, over.robots, over.places)", "pass"),
    # V17: entry of a loop
    "nothing is shown where a loop begins": Mutant(
        "V17", UNSOUND, generate.at_heads, "an invariant that is false at entry",
        '[("entry", head.entry)]', "[]"),
    "where a loop begins, facts of its turns are used": Mutant(
        "V17", UNSOUND, output.PartOutput.before, "an invariant that is false at entry",
        "if f.position <= wanted.position and", "if"),
    # V18: turn of a loop
    "turns need not keep anything": Mutant(
        "V18", UNSOUND, generate.at_heads, "an invariant that a turn breaks",
        "if head.back is not None", "if False"),
    "after a turn, the head's values are shown again": Mutant(
        "V18", UNSOUND, generate.at_heads, "an invariant that a turn breaks",
        '[("turn", head.back)]', '[("turn", head.turn)]'),
    # V19: use of loop invariants
    "a loop leaves nothing behind": Mutant(
        "V19", UNSOUND, loop.loop_carried, "an invariant that is false at entry",
        "for key in _kept(loop.block)[0] if", "for key in () if"),
    "what a turn writes before it continues is lost": Mutant(
        "V19", UNSOUND, loop._kept, "what a turn writes before it continues was lost where another way leaves the loop",
        "return {**continued, **so_far}, False, True", "return {**continued}, False, True"),
    "what a turn writes before an `if` with a `continue` is lost": Mutant(
        "V19", UNSOUND, loop._kept, "written, then continued",
        "continued.update(so_far)", "pass"),
    "a loop writes no shared variable": Mutant(
        "V19", UNSOUND, SymbolicFrame.cut, "a shared variable",
        'self.env["wrote", key[1]] = context.new(f"wrote {key[1]}", t.BOOL)', 'self.env["wrote", key[1]] = t.FALSE'),
    "a loop's invariants hold where nothing gets to the loop": Mutant(
        "V19", UNSOUND, PartEncoder.assume_at_head, "a loop on one branch",
        "self.assume(formula, place.frame, reached)", "self.assume(formula, place.frame)"),
    "the program's invariants hold within loops without being shown": Mutant(
        "V19", UNSOUND, generate.at_heads, "a loop that counts",
        "in loops.candidates(head.loop):", "in ():"),
    "a loop's invariants are not used": Mutant(
        "V19", WEAKER, PartEncoder.assume_at_head, "a loop with an invariant",
        "self.assume(formula, place.frame, reached)", "pass"),
    # V20: loops of functions
    "loop invariants of functions are never shown": Mutant(
        "V20", UNSOUND, loops.functions_with_invariants, "a function with a false invariant",
        "for f in program.functions if", "for f in () if"),
    "loop invariants of functions are shown of first values": Mutant(
        "V20", UNSOUND, generate.of_function, "a function with an invariant of some arguments",
        'context.any(parameter.name.split("@")[0], parameter.type)',
        't.integer(0) if str(parameter.type) == "int" else context.any("argument", parameter.type)'),
    "a head is reached although an operation before it has no value": Mutant(
        "V20", UNSOUND, stmt.ProgramPoint.reached.fget, "a loop behind a division",  # type: ignore[attr-defined]
        "[self.path, *[demand.term for demand in self.demands]]", "[self.path]"),
    # T1: places
    "a `for` never comes to its end": Mutant(
        "T1", UNSOUND, Turns.places, "a loop that counts",
        "over.not_after(index, over.stop)", "over.ahead(index)"),
    "a `for` has taken a turn": Mutant(
        "T1", UNSOUND, Turns.places, "a loop that counts",
        "context.fact(over.not_after(over.start, index))", "context.fact(t.not_(t.equals(over.start, index)))"),
    # T2: written
    "a shared variable is as before the loop": Mutant(
        "T2", UNSOUND, Turns.written, "a shared variable",
        "t.or_(as_term(wrote), same)", "same"),
    # T3: counted
    "a counter is stepped in each turn, also under a condition": Mutant(
        "T3", UNSOUND, Turns.counted, "counted under a condition",
        "if writes[0].sure and not writes[0].guards:", "if writes[0].sure:"),
    "a counter is stepped in each turn, also behind a `continue`": Mutant(
        "T3", UNSOUND, Turns.counted, "counted behind a continue",
        "if writes[0].sure and not writes[0].guards:", "if not writes[0].guards:"),
    "what rises and falls is counted as rising": Mutant(
        "T3", UNSOUND, Turns.counted, "up and down",
        "or not (min(known) >= 0 or max(known) <= 0)", ""),
    "of two steps in a turn one counts": Mutant(
        "T3", UNSOUND, Turns.counted, "two steps",
        "or len(writes) > 1 or", "or"),
    "a step down is a step up": Mutant(
        "T3", UNSOUND, loop.step_of, "counting down",
        'by if op == "+" else -by', "by"),
    # T4: last written
    "some turn has written": Mutant(
        "T4", UNSOUND, Turns.last_written, "nothing found",
        "t.or_(t.all_of(kept), t.all_of(", "t.or_(t.FALSE, t.all_of("),
    "what a turn wrote is made of the values at entry": Mutant(
        "T4", UNSOUND, Turns.last_written, "the turn before",
        "[write for write in group if self.writes.is_fixed(write.value, write.lets)]", "list(group)"),
    "one of several statements is taken for the only one": Mutant(
        "T4", UNSOUND, loop.LoopWrites.only, "two values",
        "if len(found) == 1 else None", "if found else None"),
    "statements behind a `continue` run with those before it": Mutant(
        "T4", UNSOUND, loop.LoopWrites._walk, "one of two variables",
        "(id(block), segment)", "(id(block), 0)"),
    "a condition of the last turn is that at loop entry": Mutant(
        "T4", UNSOUND, Turns.guards, "a condition that changes",
        "[(guard, held) for guard, held in guards if self.writes.is_fixed(guard, lets)]", "list(guards)"),
    "what reads a variable that the loop writes depends on the element alone": Mutant(
        "T4", UNSOUND, loop.LoopWrites.is_fixed, "the turn before",
        "if key in self.changed:", "if False:"),
    # T5: bounded
    "a bound holds of turns in which its conditions did not": Mutant(
        "T5", UNSOUND, loop.running_extreme_of, "the least but one",
        "rest = write.guards[:place] + write.guards[place + 1 :]", "rest = ()"),
    "a bound holds of turns that were skipped": Mutant(
        "T5", UNSOUND, Turns.bounded, "the least of those not skipped",
        "if not write.sure or not all(", "if not all("),
    "a bound holds of the turn to come": Mutant(
        "T5", UNSOUND, quantifier.IterationDomain.passed, "the least so far",
        "t.less(index, head) if self.step > 0", "t.at_most(index, head) if self.step > 0"),
    "the least is the greatest": Mutant(
        "T5", UNSOUND, Turns.order, "the least",
        "t.at_most(now, other) if least else", "t.at_most(now, other) if not least else"),
    # T6: passed
    "a `while` never ends": Mutant(
        "T6", UNSOUND, Turns.passed, "an invariant that is false at entry",
        "held(t.subtract(now, t.integer(step)))", "held(now)"),
    "a condition was tested for values between steps": Mutant(
        "T6", UNSOUND, Turns.passed, "every second",
        "if abs(step) != 1:", "if False:"),
    "a condition was tested for the value that ended the loop": Mutant(
        "T6", UNSOUND, Turns.passed, "the first that is not",
        "t.less(value, now))\n", "t.at_most(value, now))\n"),
    # how values become terms (docs/explanation/prover.md)
    "less means at most": Mutant(
        "values", UNSOUND, t.less, "a loop that counts",
        '_op("<", BOOL, a, b)', '_op("<=", BOOL, a, b)'),
    "at most means less": Mutant(
        "values", UNSOUND, t.at_most, "an init that fails",
        '_op("<=", BOOL, a, b)', '_op("<", BOOL, a, b)'),
    "every robot is the acting one": Mutant(
        "values", UNSOUND, context.ProofContext.same, "another robot's `reached`",
        "t.equals(robot, own)", "t.TRUE"),
    "no robot is the acting one": Mutant(
        "values", UNSOUND, context.ProofContext.same, "a conjunction",
        "t.equals(robot, own)", "t.FALSE"),
    "what a guard tells of a bool is the contrary": Mutant(
        "values", UNSOUND, context.ProofContext.learn, "a guard",
        "self.known[part] = t.TRUE", "self.known[part] = t.FALSE"),
    "a list does not grow": Mutant(
        "values", UNSOUND, lists.Lists._length, "lists",
        "t.integer(_STEPS[update])", "t.integer(min(_STEPS[update], 0))"),
    "a list does not shrink": Mutant(
        "values", UNSOUND, lists.Lists._length, "a shorter list",
        "t.integer(_STEPS[update])", "t.integer(max(_STEPS[update], 0))"),
    "points are equal": Mutant(
        "values", UNSOUND, lists.Lists.same, "two points",
        "return t.all_of([self.same(x, y) for x, y in zip(a, b, strict=True)])", "return t.TRUE"),
    "bools begin with true": Mutant(
        "values", UNSOUND, lists.default, "an actuator at the start",
        "t.BOOL: t.FALSE", "t.BOOL: t.TRUE"),
    "sums are zero": Mutant(
        "values", UNSOUND, builtins.sum_over_robots, "a sum",
        "found = t.add(rest, part(value))", "found = zero"),
    "nobody is in a fleet": Mutant(
        "values", UNSOUND, quantifier.in_fleet, "an allread variable as a whole",
        "t.not_(context.absent[key])", "t.FALSE"),
    "paths do not come near one another": Mutant(
        "values", UNSOUND, geometry.Geometry.path_distance, "two paths",
        "p, q = self._point(a), self._point(b)", "return t.real(1000)"),
    "remainders are the dividend": Mutant(
        "values", UNSOUND, t.remainder, "a remainder",
        '_op("mod", INT, a, b)', "a"),
    "quotients are the dividend": Mutant(
        "values", UNSOUND, t.floor_divide, "a quotient",
        '_op("div", INT, a, b)\n    other', "a\n    other"),
    "a product is a sum": Mutant(
        "values", UNSOUND, expr._number, "a product",
        't.multiply(a, b)\n        case "/"', 't.add(a, b)\n        case "/"'),
    "a box is its first half": Mutant(
        "values", WEAKER, expr._between, "geofence",
        "t.or_(t.and_(t.at_most(a, x), t.at_most(x, b)),", "t.or_(t.FALSE,"),
    "of sums no bounds are known": Mutant(
        "values", WEAKER, builtins._bounded, "sums",
        "for holds, wrong in wrongs:", "for holds, wrong in ():"),
    "of paths no lemma is known": Mutant(
        "values", WEAKER, geometry.Geometry.lemmas, "apart",
        "in list(self.paths.items()):", "in ():"),
}  # fmt: skip
