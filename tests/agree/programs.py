"""Random well-typed IR programs of the whole language, and random states. Equal seeds give equal programs."""

from __future__ import annotations

from random import Random
from typing import Literal

from koordgen.lang.ir import decl as d
from koordgen.lang.ir import expr as e
from koordgen.lang.ir import stmt as s
from koordgen.lang.ir.ports import NO_MEANING, usual
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import (
    BOOL,
    FLOAT,
    INT,
    PLANNER,
    POINT,
    SCAN,
    STREAM,
    STRING,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    TupleOf,
    Type,
    list_of,
)
from koordgen.lang.node import replace
from koordgen.lang.semantics import step
from koordgen.lang.semantics.state import Robot, State, Store
from koordgen.lang.semantics.values import Value
from tests.agree.expressions import Expressions
from tests.agree.general import PATH, Temp, compare
from tests.agree.kinds import AT, KEYS, TICKET, constant, random_type, random_value, sized, whole
from tests.agree.statements import Statements

N_SYS = 3
MODULE = "Motion"


def random_program(seed: int) -> d.Program:
    """Return a program of up to four events with its own declarations."""
    rng = Random(seed)
    records = _records(rng)
    types = [random_type(rng, 3, records) for _ in range(rng.randrange(3, 6))]
    types.append(rng.choice((Sequence("Set", rng.choice(KEYS), 64), MapOf(rng.choice(KEYS), rng.choice(types), 64))))
    types += [INT, FLOAT, BOOL, POINT, STRING, list_of(INT), rng.choice((PATH, list_of(TupleOf((POINT, SCAN)))))]
    program = d.Program(
        name="random",
        path="random.koord",
        records=tuple([d.Record(r, constants(rng, [field for _, field in r.fields]), AT) for r in records]),
        extern_types=(d.ExternTypeDef(str(TICKET), AT),),
        functions=(),
        externs=(),
        specs=(),
        params=(),
        modules=(_module(rng, types), d.Module("Log", (d.Port("stdout", STREAM, "stream", NO_MEANING, AT),), (), AT)),
        shared=(),
        locals=(),
        locks=(),
        init=(),
        events=(),
        properties=(),
    )
    program = replace(program, params=_params(rng, types))
    program = replace(program, shared=_shared(rng, types, program), locals=_locals(rng, types, program))
    program = replace(program, externs=_externs(rng, types, program))
    for index in range(rng.randrange(1, 4)):
        program = replace(program, functions=(*program.functions, _function(rng, types, program, index)))
    if rng.random() < 0.5:
        program = replace(program, init=Statements(rng, program, "init", "i").block(2, 2))
    return _locked(replace(program, events=_events(rng, program)), rng)


def constants(rng: Random, types: list[Type]) -> tuple[e.Expr, ...]:
    return tuple([constant(random_value(rng, type_), type_) for type_ in types])


def _records(rng: Random) -> tuple[RecordType, ...]:
    found: tuple[RecordType, ...] = ()
    for name in ("Task", "Crew", "Depot")[: rng.randrange(1, 4)]:
        fields = [sized(random_type(rng, 2, found), rng) for _ in range(rng.randrange(1, 4))]
        found = (*found, RecordType(name, tuple([(f"field{i}", field) for i, field in enumerate(fields)])))
    return found


def _module(rng: Random, types: list[Type]) -> d.Module:
    seen = sized(rng.choice(types), rng, tight=0)
    order = seen if rng.random() < 0.5 else sized(rng.choice(types), rng, tight=0)
    held = "seen" if order == seen and rng.random() < 0.7 else ""
    clears = tuple([name for name in ("near", "reached") if rng.random() < 0.5])
    ports = [
        d.Port("position", POINT, "sensor", NO_MEANING, AT),
        d.Port("reached", BOOL, "sensor", NO_MEANING, AT),
        d.Port("seen", seen, "sensor", NO_MEANING, AT),
        d.Port("near", BOOL, "sensor", NO_MEANING, AT),
        d.Port("target", POINT, "actuator", NO_MEANING, AT),
        d.Port("path", PATH, "actuator", NO_MEANING, AT),
        d.Port("order", order, "actuator", d.Meaning(False, held, clears), AT),
        d.Port("planner", PLANNER, "callable", NO_MEANING, AT),
    ]
    meant = [replace(p, meaning=usual(p, ports)) if p.meaning == NO_MEANING else p for p in ports]
    return d.Module(MODULE, tuple(meant), (), AT)


def _params(rng: Random, types: list[Type]) -> tuple[d.Param, ...]:
    chosen = rng.sample(types, 3)
    return tuple([d.Param(f"p{i}", t, constant(random_value(rng, t), t), AT) for i, t in enumerate(chosen)])


def _initial(rng: Random, type_: Type, program: d.Program) -> e.Expr:
    if rng.random() < 0.2:
        return Expressions(rng, program, "literal").expr(type_, 1)
    return constant(random_value(rng, type_, wild=False), type_)


def _shared(rng: Random, types: list[Type], program: d.Program) -> tuple[d.Shared, ...]:
    found = []
    for i, type_ in enumerate([INT, POINT, PATH, *rng.sample(types, 4)]):
        kind: Literal["allread", "allwrite"] = "allread" if rng.random() < 0.5 else "allwrite"
        type_ = sized(type_, rng) if i > 2 else type_
        found.append(d.Shared(f"s{i}", kind, type_, _initial(rng, type_, program), AT))
    return tuple(found)


def _locals(rng: Random, types: list[Type], program: d.Program) -> tuple[d.Local, ...]:
    sizes = [sized(type_, rng) for type_ in types]
    return tuple([d.Local(f"v{i}", t, _initial(rng, t, program), AT) for i, t in enumerate(sizes)])


def _parameters(rng: Random, types: list[Type], program: d.Program, prefix: str) -> tuple[d.Parameter, ...]:
    chosen = rng.sample(types, rng.randrange(1, 4))
    slots = [v.type for v in program.shared if v.kind == "allread"]
    if slots and rng.random() < 0.4:
        chosen.append(PerRobot(rng.choice(slots)))
    return tuple([d.Parameter(f"{prefix}{i}", t) for i, t in enumerate(chosen)])


def _externs(rng: Random, types: list[Type], program: d.Program) -> tuple[d.ExternFunction, ...]:
    found = []
    for index in range(rng.randrange(1, 3)):
        parameters = _parameters(rng, types, program, "a")
        result = rng.choice((*types, TICKET))
        formulas = Expressions(rng, program, "contract")
        formulas.temps = [Temp(p.name, p.type, False) for p in parameters]
        requires = tuple([_mostly(formulas, rng) for _ in range(rng.randrange(2))])
        formulas.temps.append(Temp("result", result, False))
        ensures = tuple([_mostly(formulas, rng) for _ in range(rng.randrange(2))])
        found.append(d.ExternFunction(f"outside{index}", parameters, result, requires, ensures, AT))
    return tuple(found)


def _mostly(formulas: Expressions, rng: Random) -> e.Expr:
    """Return a condition that is mostly true."""
    found = formulas.expr(BOOL, 2)
    often = compare("<", formulas.leaf(INT), whole(5))
    return found if rng.random() < 0.2 else e.Logic("or", found, often, BOOL, AT)


def _function(rng: Random, types: list[Type], program: d.Program, index: int) -> d.Function:
    statements = Statements(rng, program, "function", "l")
    parameters = _parameters(rng, types, program, "q")
    statements.temps = [Temp(p.name, p.type, not isinstance(p.type, PerRobot)) for p in parameters]
    statements.result = rng.choice((*types, INT, BOOL))
    block = (*statements.block(2, 3), s.Return(statements.expr(statements.result, 2), AT))
    return d.Function(f"inside{index}", parameters, statements.result, block, AT)


def _events(rng: Random, program: d.Program) -> tuple[d.Event, ...]:
    found = []
    count = rng.randrange(2, 5)
    for i in range(count):
        guard: e.Expr = e.Const(True, BOOL, AT)
        if i < count - 1:
            guard = Expressions(rng, program, "guard").expr(BOOL, 3)
        effect = Statements(rng, program, "effect", "t").block(2, rng.randrange(3, 7))
        found.append(d.Event(f"Event{i}", guard, effect, None, None, AT))
    return tuple(found)


def _locked(program: d.Program, rng: Random) -> d.Program:
    """Return the program with some events atomic: shared variables of one transaction are in one group."""
    used = {}
    for event in program.events:
        kinds = (e.SlotRead, e.SlotsRead, e.SharedRead, s.OwnSlot, s.SharedPlace)
        names = {node.name for node in walk((event.guard, event.effect)) if isinstance(node, kinds)}
        if names and rng.random() < 0.3:
            used[event.name] = names
    groups: list[set[str]] = []
    for names in used.values():
        meeting = [group for group in groups if group & names]
        groups = [group for group in groups if group not in meeting] + [names.union(*meeting)]
    lock = {name: next(i for i, g in enumerate(groups) if names & g) for name, names in used.items()}
    events = tuple([replace(event, lock=lock.get(event.name)) for event in program.events])
    return replace(program, events=events, locks=tuple([tuple(sorted(group)) for group in groups]))


def random_state(rng: Random, program: d.Program) -> State:
    """Return a state at the start of a round with random values."""
    start = step.initial(program, N_SYS)
    ports = [(f"{m.name}.{p.name}", p) for m in program.modules for p in m.ports]
    robots = tuple(
        Robot(
            {v.name: random_value(rng, v.type) for v in program.locals},
            {name: random_value(rng, p.type) for name, p in ports if p.direction in ("sensor", "actuator")},
            False,
        )
        for _ in range(N_SYS)
    )
    slots: dict[str, tuple[Value, ...]] = {
        v.name: tuple([random_value(rng, v.type) for _ in range(N_SYS)]) for v in program.shared if v.kind == "allread"
    }
    cells = {v.name: random_value(rng, v.type) for v in program.shared if v.kind == "allwrite"}
    return start._replace(robots=robots, store=Store(slots, cells), round=1)
