"""A finite environment: what sensors may say first, and next after each round; what callable ports answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

from koordgen.check.params import BadParam, with_params
from koordgen.explore.machine import Machine, Own, Packed
from koordgen.ir import decl
from koordgen.ir.expr import Const
from koordgen.ir.types import BOOL, POINT, Type
from koordgen.located import Reader, Report, YamlNode
from koordgen.node import replace
from koordgen.replay.functions import meant_value
from koordgen.runtime.values import Point
from koordgen.semantics.eval import Discarded
from koordgen.semantics.exec import NoMeaning
from koordgen.semantics.property import holds_assumption
from koordgen.semantics.step import initial
from koordgen.semantics.values import Value
from koordgen.source import Source, Span

MOST = 100_000  # values of one port
ANSWERS = ("straight", "none")


class Domain(NamedTuple):
    """The values of one sensor. `near` tells whether one follows another within a round; None: any does."""

    values: tuple[Value, ...]
    near: Callable[[Value, Value], bool] | None = None


class Lacking(Exception):
    """An environment is needed, and is not there or not usable; the message says for which port."""


class Environment(NamedTuple):
    """By "Module.port": sensors' domains; what callable ports answer, one of ANSWERS."""

    domains: Mapping[str, Domain]
    answers: Mapping[str, str]


def environment(program: decl.Program, source: Source | None, report: Report) -> Environment | None:
    """What the file says, and both values of each bool sensor that it does not name. None after a mistake was reported;
    raises Lacking."""
    sensors = {f"{m.name}.{p.name}": p.type for m in program.modules for p in m.ports if p.direction == "sensor"}
    called = [f"{m.name}.{p.name}" for m in program.modules for p in m.ports if p.direction == "callable"]
    domains = {name: Domain((False, True)) for name, type_ in sensors.items() if type_ == BOOL}
    answers: dict[str, str] = {}
    if source is not None:
        mistakes: list[int] = []

        def noted(*mistake: Any) -> None:
            mistakes.append(1)
            report(*mistake)

        reader = Reader(source, noted)
        for name, node in reader.table(reader.document(), "the environment", [], [*sensors, *called]).items():
            if name in called:
                answers[name] = reader.choice(node, name, ANSWERS) or "none"
            else:
                domains[name] = _domain(reader, node, name, sensors[name], program)
        if mistakes:
            return None
    missing = [name for name in (*sensors, *called) if name not in domains and name not in answers]
    if missing:
        kind = f"answers, one of {', '.join(ANSWERS)}" if missing[0] in called else "values, a finite number of them"
        raise Lacking(f"{missing[0]} needs {kind}: name them in a file for --env" + _others(missing[1:]))
    for name in answers:
        if answers[name] == "straight" and sensors.get(f"{name.partition('.')[0]}.position") != POINT:
            raise Lacking(f"{name}: a straight way begins at a position, and the program has no such sensor beside it")
    return Environment(domains, answers)


def _others(missing: Sequence[str]) -> str:
    return f" (so do {', '.join(missing)})" if missing else ""


def _domain(reader: Reader, node: YamlNode, name: str, type_: Type, program: decl.Program) -> Domain:
    if node.tag != "tag:yaml.org,2002:map":
        items = reader.items(node, name)
        if not items and node.value == []:
            reader.report("F005", f"{name} has no value", node)
        return Domain(tuple(_values(reader, items, name, type_, program)))
    given = reader.table(node, name, ["grid"], ["moves"])
    if type_ != POINT:
        reader.report("F004", f"{name} is of type {type_}: a grid has Points; write a list of values", node)
        return Domain(())
    box = reader.table(given.get("grid"), f"{name}.grid", ["lo", "hi", "step"], [])
    lo, hi = reader.vector(box.get("lo"), "lo"), reader.vector(box.get("hi"), "hi")
    step = reader.number(box.get("step"), "step", 1e-6, 1e5)
    if lo is None or hi is None or step is None:
        return Domain(())
    counts = [math.floor((b - a) / step + 1e-9) + 1 for a, b in zip(lo, hi, strict=True)]
    if min(counts) < 1 or counts[0] * counts[1] * counts[2] > MOST:
        reader.report("F005", f"{name}.grid has no place, or more than {MOST}", node)
        return Domain(())
    axes = [[a + k * step for k in range(n)] for a, n in zip(lo, counts, strict=True)]
    points = tuple(Point(*place) for place in product(*axes))
    if "moves" not in given:
        return Domain(points)
    reach = reader.number(given["moves"], f"{name}.moves", 0, 1000, int) or 0
    return Domain(points, _within(reach * step * (1 + 1e-9)))


def _within(reach: float) -> Callable[[Value, Value], bool]:
    def near(a: Any, b: Any) -> bool:
        return bool(max(abs(a.x - b.x), abs(a.y - b.y), abs(a.z - b.z)) <= reach)

    return near


def _values(reader: Reader, items: list[YamlNode], name: str, type_: Type, program: decl.Program) -> Iterator[Value]:
    """Values are written as those of params are."""
    at = Span(1, 1, 1, 1)
    param = decl.Param(name, type_, Const(0, type_, at), at)
    alone = replace(program, params=(param,), shared=(), locals=(), modules=())
    for item in items:
        try:
            made = with_params(alone, {name: reader.plain(item, name)})
        except BadParam as error:
            reader.report("F004", str(error).removeprefix("param "), item)
            continue
        yield initial(made, 1).params[name]


def answering(environment: Environment) -> Callable[[int, Mapping[str, Any], str, tuple[Any, ...]], Any]:
    """The callable ports of a robot, by what its sensors say."""

    def answer(_: int, sensors: Mapping[str, Any], port: str, args: tuple[Any, ...]) -> Any:
        if environment.answers.get(port) == "straight":
            return (sensors[f"{port.partition('.')[0]}.position"], args[0])
        return ()

    return answer


class Surroundings:
    """The environment's steps of one machine's fleets."""

    def __init__(self, machine: Machine, environment: Environment) -> None:
        self.machine, self.domains = machine, environment.domains
        self._moves: dict[tuple[int, int], tuple[int, ...]] = {}
        self._news: dict[Hashable, list[dict[str, Value]]] = {}
        commanded = {name.rpartition(".")[0] for name in machine.actuators if name.endswith((".target", ".path"))}
        self._reached = {f"{module}.reached" for module in commanded}  # where nothing was commanded yet all is reached

    def starts(self) -> Iterator[tuple[dict[str, Value], ...]]:
        """What all robots' sensors may say when a mission begins, `initially` aside."""
        pools = [
            (True,) if name in self._reached else domain.values
            for name, domain in ((name, self.domains[name]) for name in self.machine.sensors)
        ]
        each = [dict(zip(self.machine.sensors, values, strict=True)) for values in product(*pools)]
        return product(each, repeat=self.machine.n_sys)

    def moved(self, fleet: Packed) -> Iterator[Packed]:
        """Every fleet after the environment's step. Raises Lacking where an assumption has no value."""
        if not self.machine.sensors:
            yield fleet
            return
        n_sys = self.machine.n_sys
        rest = fleet[n_sys:]
        for owns in product(*[self._moved(pid, fleet[pid]) for pid in range(n_sys)]):
            yield owns + rest

    def _moved(self, pid: int, own: int) -> tuple[int, ...]:
        found = self._moves.get((pid, own))
        if found is None:
            robot = self.machine.owns.values[own]
            key = (pid, self.machine.ports_key(robot))  # no assumption reads anything else
            if key not in self._news:
                pools = [self._nearby(name, robot) for name in self.machine.sensors]
                news = [dict(zip(self.machine.sensors, values, strict=True)) for values in product(*pools)]
                self._news[key] = [new for new in news if self._allowed(pid, robot, new)]
            moved = [self.machine.own(robot._replace(sensors=new)) for new in self._news[key]]
            found = self._moves[pid, own] = tuple(moved)
        return found

    def _nearby(self, name: str, robot: Own) -> list[Value]:
        values, near = self.domains[name]
        return [v for v in values if near is None or near(robot.sensors[name], v)]

    def _allowed(self, pid: int, robot: Own, new: Mapping[str, Any]) -> bool:
        """Whether the assumptions let one robot's sensors come to these values."""
        program, types = self.machine.program, self.machine.types
        before = {n: meant_value(v, types[n]) for n, v in {**robot.sensors, **robot.actuators}.items()}
        after = {**before, **new}
        for module in program.modules:
            for assumption in module.assumptions:
                try:
                    held = holds_assumption(
                        assumption, program, before, after, pid, self.machine.n_sys, self.machine.params
                    )
                except Discarded as error:
                    raise Lacking(f"{module.name}: an assumption has no value: {error}") from None
                except NoMeaning as error:
                    raise Lacking(f"{module.name}: an assumption cannot be evaluated: {error}") from None
                if not held:
                    return False
        return True
