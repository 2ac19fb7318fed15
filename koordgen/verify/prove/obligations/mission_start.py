"""Mission start: variables have their initial values, actuators hold, then every robot runs `init`.

A mission begins after every robot's `init` has ended. If the semantics discards the `init` of a robot, no mission
begins. So invariants at the start are proved only for fleets in which every `init` has a result. The separate
obligation `(well-defined)` proves that no `init` is discarded.
"""

from __future__ import annotations

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.ports import clearable, clears, held, ports
from koordgen.lang.ir.tree import walk
from koordgen.verify.prove.encode.lists import default
from koordgen.verify.prove.encode.loop import temps_of, written
from koordgen.verify.prove.encode.scope import FleetScope
from koordgen.verify.prove.encode.state import ArbitraryState, Key, SymbolicState
from koordgen.verify.prove.encode.stmt import Env, SymbolicFrame
from koordgen.verify.prove.encode.values import Val, as_term, pick
from koordgen.verify.prove.obligations.part_encoder import PartEncoder
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Term


def cleared_sensors(program: decl.Program, writes: Env, state: SymbolicState, robot: Term) -> Env:
    """Return the sensors that the commands of an event may clear.

    A command clears a sensor by setting the sensor to false."""
    found: Env = {}
    commands: dict[Key, list[Term]] = {}
    for actuator, cleared in clears(program).items():
        if ("wrote", actuator) in writes:
            for sensor in cleared:
                commands.setdefault(("port", sensor), []).append(as_term(writes["wrote", actuator]))
    for key, wrote in commands.items():
        if (any_wrote := t.any_of(wrote)) is not t.FALSE:
            found[key] = pick(any_wrote, t.FALSE, state.of(key, robot))
    return found


class LaunchState:
    """State before any robot has run `init`.

    - A sensor that a command can clear is true. Every other sensor is arbitrary.
    - An actuator that holds at a sensor's value has this value. If the program does not declare the sensor, the
      actuator's value is arbitrary.
    - Every other actuator has its default value.
    - An imported variable is arbitrary: its first value is the exporter's. So is a robot's place among the exporter's
      members."""

    state_name = "@launch"

    def __init__(self, part_encoder: PartEncoder) -> None:
        self.part_encoder, self.types = part_encoder, part_encoder.problem.types
        self.sensed = ArbitraryState(part_encoder.context, self.types)
        program, nowhere = part_encoder.problem.program, FleetScope(self.sensed)
        value = part_encoder.encoder.value
        self.records: dict[str, Val] = {}
        for record in program.records:
            self.records[record.type.name] = tuple([value(d, nowhere) for d in record.defaults])
        self.first: dict[Key, Val] = {("local", v.name): value(v.initial, nowhere) for v in program.locals}
        imported = {name for each in program.imports for name in each.variables}
        for each in program.imports:
            del self.first["local", each.pid]
        for shared in [v for v in program.shared if v.name not in imported]:
            self.first["slot" if shared.kind == "allread" else "cell", shared.name] = value(shared.initial, nowhere)
        self.ports = {name: port for name, _, port in ports(program)}
        self.held, self.cleared = held(program), clearable(program)

    def of(self, key: Key, robot: Term) -> Val:
        if key in self.first:
            return self.first[key]
        name = key[1]
        if key[0] != "port":
            return self.sensed.of(key, robot)
        port = self.ports[name]
        if port.direction == "sensor":
            return t.TRUE if name in self.cleared else self.sensed.of(key, robot)
        if name in self.held:
            sensor = self.held[name]
            return self.sensed.of(("port", sensor if sensor in self.ports else name), robot)
        found = default(port.type, self.records)
        return self.sensed.of(key, robot) if found is None else found


class InitRun:
    """Run of one robot's `init`.

    `env`: the values that `init` wrote.
    `writes`: the values that `init` wrote, and the sensors that the commands of `init` clear.
    `ended`: the condition that `init` reaches its end and all its operations have values."""

    def __init__(self, part_encoder: PartEncoder, launch: LaunchState, robot: Term) -> None:
        context, init = part_encoder.context, part_encoder.problem.program.init

        def ask(node: ir.PortCall, args: tuple[Val, ...]) -> Val:
            answer = context.any(f"{node.module}.{node.port}", node.type)
            part_encoder.answered(node, args, answer, robot, launch)
            return answer

        encoding = part_encoder.problem.loops.encoding
        self.frame = SymbolicFrame(
            part_encoder.encoder, robot, launch, launch, ask, temps_of(init), part_encoder.assume_at_head, encoding
        )
        self.frame.brief = part_encoder.brief
        with context.separate_demands() as self.demands, context.outermost(), context.about("init", 0):
            live = self.frame.block(init)
            self.env = self.frame.writes()
        over = t.any_of([live, *[t.all_of(e.path) for e in self.frame.exits]])
        self.ended = t.all_of([over, *[demand.term for demand in self.demands]])
        self.writes = {**self.env, **cleared_sensors(part_encoder.problem.program, self.env, launch, robot)}


class StartState:
    """State after every robot has run `init`.

    If several robots write the same allwrite variable, the variable has the value of the robot with the highest pid.
    What the `init` of another application may have changed, `moved`, is arbitrary."""

    state_name = "@ready"

    def __init__(self, part_encoder: PartEncoder, moved: frozenset[Key]) -> None:
        self.part_encoder, self.launch, self.moved = part_encoder, LaunchState(part_encoder), moved
        self.types = part_encoder.problem.types
        self.others = ArbitraryState(part_encoder.context, self.types, "@others")
        self.runs: dict[Term, InitRun] = {}
        self.cells: dict[Key, Val] = {}

    def run(self, robot: Term) -> InitRun:
        found = self.runs.get(robot)
        if found is None:
            found = self.runs[robot] = InitRun(self.part_encoder, self.launch, robot)
            context = self.part_encoder.context
            context.fact(t.implies(context.within(robot), found.ended), "every init ends", 0)
        return found

    def of(self, key: Key, robot: Term) -> Val:
        if key in self.moved:
            return self.others.of(key, robot)
        before = self.launch.of(key, robot)
        if not self.part_encoder.problem.program.init:
            return before
        if key[0] == "cell":
            if key not in self.cells:
                self.cells[key] = self._cell(key, before)
            return self.cells[key]
        return self.run(robot).writes.get(key, before)

    def _cell(self, key: Key, before: Val) -> Val:
        context, wrote = self.part_encoder.context, ("wrote", key[1])
        if key not in written(self.part_encoder.problem.program.init):
            return before
        some, last = context.new(f"wrote {key[1]}", t.BOOL), context.new(f"last to write {key[1]}", t.INT)

        def writes(robot: Term) -> Term:
            run = self.run(robot)
            return t.and_(context.within(robot), as_term(run.env.get(wrote, t.FALSE)))

        with context.about("the write of the highest pid counts", 0):
            context.robot(last)
            context.robot(t.integer(0))
            context.robot(t.subtract(context.size, t.integer(1)))
            for number in _named(self.part_encoder.problem.program.init):
                context.robot(t.integer(number))
            context.fact(t.implies(some, writes(last)))
            context.for_all(lambda index: t.implies(writes(index), t.and_(some, t.at_most(index, last))))
        return pick(some, self.run(last).env.get(key, before), before)


def _named(block: stmt.Block) -> set[int]:
    """Return the int literals with which a block compares `pid`."""
    pairs = [(n.left, n.right) for n in walk(block) if isinstance(n, ir.Compare)]
    pairs += [(right, left) for left, right in pairs]
    return {b.value for a, b in pairs if isinstance(a, ir.Pid) and isinstance(b, ir.Const) and isinstance(b.value, int)}


def assume_initially(part_encoder: PartEncoder, launch: LaunchState) -> None:
    """Assume the program's `initially` properties in the state before `init`."""
    part_encoder.holds(part_encoder.problem.initially, launch)
