"""What a program means: states, one event of one robot, a round, init. Pure; what the agents do is compared with it.

Of the rounds that the language allows, `round_` is the one that agents take: each robot runs the first event in text
order whose guard holds, on the shared store as it was at the round's start, by ascending pid. What it wrote takes
effect together; of several writers of an allwrite variable the highest pid wins.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple, assert_never

from koordgen.ir import decl, stmt
from koordgen.semantics.eval import Discarded, Value, View, default, evaluate, holds, may_leave, may_stay
from koordgen.source import Span


class Robot(NamedTuple):
    """One robot's own: `ports` by "Module.port", sensors and actuators alike."""

    locals: Mapping[str, Value]
    ports: Mapping[str, Value]
    stopped: bool


class Store(NamedTuple):
    """The shared variables: allread ones by name and pid, allwrite ones by name."""

    slots: Mapping[str, tuple[Value, ...]]
    cells: Mapping[str, Value]


class State(NamedTuple):
    """A fleet at a round's start; every robot's copy of the store is then the store itself. `round` is the number of
    the round to come, 0 when init has not run."""

    params: Mapping[str, Value]
    robots: tuple[Robot, ...]
    store: Store
    round: int


class Writes(NamedTuple):
    """What an event did: all its robot's locals afterwards; own slots, cells and actuators only where written."""

    locals: Mapping[str, Value]
    slots: Mapping[str, Value]
    cells: Mapping[str, Value]
    ports: Mapping[str, Value]
    stopped: bool


class Step(NamedTuple):
    """What one robot did in a round: the event chosen (None: init, or no guard held) and its outcome."""

    pid: int
    event: str | None
    outcome: Writes | Discarded | None


def initial(program: decl.Program, n_sys: int, sensors: Sequence[Mapping[str, Value]] = ()) -> State:
    """Before init: initial values everywhere, actuators unset, sensors as given by robot and "Module.port"."""
    constants = View(0, n_sys, {}, {}, {}, {}, {}, {})
    params = {p.name: evaluate(p.default, constants) for p in program.params}
    constants = constants._replace(params=params)
    variables: list[decl.Local | decl.Shared] = [*program.locals, *program.shared]
    first = {v.name: evaluate(v.initial, constants) for v in variables}
    locals_ = {v.name: first[v.name] for v in program.locals}
    slots = {v.name: (first[v.name],) * n_sys for v in program.shared if v.kind == "allread"}
    cells = {v.name: first[v.name] for v in program.shared if v.kind == "allwrite"}
    unset = {f"{m.name}.{p.name}": default(p.type) for m in program.modules for p in m.ports}
    robots = tuple(
        Robot(locals_, {**unset, **(sensors[pid] if pid < len(sensors) else {})}, False) for pid in range(n_sys)
    )
    return State(params, robots, Store(slots, cells), 0)


def run_init(program: decl.Program, state: State) -> tuple[State, list[Step]]:
    """Every robot's init, each on the store before it; round 1 comes next."""
    steps = [Step(pid, None, run(program.init, state, pid)) for pid in range(len(state.robots))]
    return _committed(state, steps)._replace(round=1), steps


def round_(program: decl.Program, state: State, skipping: Collection[int] = ()) -> tuple[State, list[Step]]:
    """The program's step of one round; robots in `skipping`, those that stopped and those of which no guard holds do
    nothing. The environment's step (`sense`) comes after it."""
    steps = []
    for pid, robot in enumerate(state.robots):
        if robot.stopped or pid in skipping:
            continue
        steps.append(_turn(program, state, pid))
    return _committed(state, steps)._replace(round=state.round + 1), steps


def sense(state: State, sensors: Sequence[Mapping[str, Value]]) -> State:
    """The environment's step: new sensor values, by robot and "Module.port"; those not named stay."""
    robots = tuple(r._replace(ports={**r.ports, **new}) for r, new in zip(state.robots, sensors, strict=True))
    return state._replace(robots=robots)


def enabled(event: decl.Event, state: State, pid: int) -> bool:
    """Whether an event's guard holds for a robot at a round's start. Raises Discarded."""
    return holds(event.guard, _view(state, pid))


def _turn(program: decl.Program, state: State, pid: int) -> Step:
    for event in program.events:
        try:
            if not enabled(event, state, pid):
                continue
        except Discarded as discarded:
            return Step(pid, event.name, discarded)
        return Step(pid, event.name, run(event.effect, state, pid))
    return Step(pid, None, None)


def run(block: stmt.Block, state: State, pid: int) -> Writes | Discarded:
    """An effect (or init) of one robot on the state of the round's start: its writes, or why none of them counts."""
    working = _Working(_view(state, pid))
    try:
        working.block(block)
    except Discarded as discarded:
        return discarded
    return working.writes()


def _view(state: State, pid: int) -> View:
    robot = state.robots[pid]
    return View(
        pid, len(state.robots), state.params, robot.locals, {}, state.store.slots, state.store.cells, robot.ports
    )


def _committed(state: State, steps: Sequence[Step]) -> State:
    """All writes of a round together, in ascending order of pid."""
    robots = list(state.robots)
    slots = {name: list(values) for name, values in state.store.slots.items()}
    cells = dict(state.store.cells)
    for pid, _, outcome in steps:
        if not isinstance(outcome, Writes):
            continue
        robots[pid] = Robot(outcome.locals, {**robots[pid].ports, **outcome.ports}, outcome.stopped)
        for name, value in outcome.slots.items():
            slots[name][pid] = value
        cells.update(outcome.cells)
    store = Store({name: tuple(values) for name, values in slots.items()}, cells)
    return state._replace(robots=tuple(robots), store=store)


class _Working:
    """One run of one effect: copies that the event itself reads back."""

    def __init__(self, view: View) -> None:
        self.locals = dict(view.locals)
        self.temps: dict[str, Value] = {}
        self.slots = {name: list(values) for name, values in view.slots.items()}
        self.cells = dict(view.cells)
        self.ports = dict(view.ports)
        self.view = view._replace(
            locals=self.locals, temps=self.temps, slots=self.slots, cells=self.cells, ports=self.ports
        )
        self.written: dict[tuple[str, str], Span] = {}  # (what kind, name) -> the last statement that wrote it
        self.stopped = False

    def block(self, block: stmt.Block) -> None:
        for statement in block:
            if self.stopped:
                return
            match statement:
                case stmt.Assign(place, value, span):
                    self.assign(place, evaluate(value, self.view), span)
                case stmt.Let(name, _, value):
                    self.temps[name] = evaluate(value, self.view)
                case stmt.If(condition, then, orelse):
                    self.block(then if holds(condition, self.view) else orelse)
                case stmt.Stop():
                    self.stopped = True
                case _:
                    assert_never(statement)

    def assign(self, place: stmt.Place, value: Value, span: Span) -> None:
        match place:
            case stmt.LocalPlace(name):
                self.locals[name] = value
                self.written["local", name] = span
            case stmt.TempPlace(name):
                self.temps[name] = value
            case stmt.OwnSlot(name):
                self.slots[name][self.view.pid] = value
                self.written["slot", name] = span
            case stmt.SharedPlace(name):
                self.cells[name] = value
                self.written["cell", name] = span
            case stmt.PortPlace(module, port):
                self.ports[f"{module}.{port}"] = value
                self.written["port", f"{module}.{port}"] = span
            case _:
                assert_never(place)

    def writes(self) -> Writes | Discarded:
        """What leaves the event at its end; a last value that no robot may use discards all of it."""
        values: dict[str, dict[str, Value]] = {"slot": {}, "cell": {}, "port": {}, "local": {}}
        where: dict[str, Mapping[str, Value]] = {"cell": self.cells, "port": self.ports, "local": self.locals}
        for (kind, name), span in self.written.items():
            value = self.slots[name][self.view.pid] if kind == "slot" else where[kind][name]
            if not (may_stay(value) if kind == "local" else may_leave(value)):
                shown = "an int beyond 64 bits" if isinstance(value, int) else repr(value)
                return Discarded(f"{name} would become {shown}, which no robot may use", span)
            values[kind][name] = value
        return Writes(self.locals, values["slot"], values["cell"], values["port"], self.stopped)
