"""Parser of environment files, which list the possible values of ports for an exploration.

Each mistake in a file is reported with its line and column.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from decimal import Decimal
from itertools import product
from typing import Any

from koordgen.fleet.yaml_reader import Report, YamlNode, YamlReader
from koordgen.lang.analyze.params import BadParam, with_params
from koordgen.lang.ir import decl
from koordgen.lang.ir.expr import Const
from koordgen.lang.ir.ports import position_beside
from koordgen.lang.ir.types import BOOL, FLOAT, INT, POINT, SCAN, TupleOf, Type, list_of
from koordgen.lang.node import replace
from koordgen.lang.semantics.step import initial
from koordgen.lang.semantics.values import Value
from koordgen.lang.source import Source, Span
from koordgen.runtime.values.points import Point
from koordgen.verify.explore.environment import STRAIGHT, Environment, MissingEnvironment, SensorDomain
from koordgen.verify.explore.lidar import lidar

MAX_VALUES = 100_000  # largest number of values that one port may have
ROUNDING = 1e-9  # relative tolerance for comparing distances; exceeds the rounding error of a distance
ANSWERS: dict[str, tuple[Any, ...]] = {"straight": (STRAIGHT,), "none": ((),), "either": (STRAIGHT, ())}
PATH, SCANS = list_of(POINT), list_of(TupleOf((POINT, SCAN)))


def environment(program: decl.Program, n_sys: int, source: Source | None, report: Report) -> Environment | None:
    """Return the environment that the file `source` describes; None if the file has a mistake.

    Mistakes are passed to `report`. A bool sensor that the file leaves out can be false or true. Raises
    MissingEnvironment if the file leaves out another sensor or a callable port.
    """
    ports = {f"{m.name}.{p.name}": p for m in program.modules for p in m.ports}
    sensors = {name: p.type for name, p in ports.items() if p.direction == "sensor"}
    called = [name for name, p in ports.items() if p.direction == "callable"]
    found = Environment({name: SensorDomain((False, True)) for name, type_ in sensors.items() if type_ == BOOL}, {})
    if source is not None:
        mistakes: list[int] = []

        def noted(*mistake: Any) -> None:
            mistakes.append(1)
            report(*mistake)

        found = _EnvironmentFile(YamlReader(source, noted), program, sensors, called).read(found, n_sys)
        if mistakes:
            return None
    for pid in range(n_sys):
        check_completeness(found.of(pid), program)
    return found


def check_completeness(found: Environment, program: decl.Program) -> None:
    """Check that an environment has values for all ports of a program. Raises MissingEnvironment."""
    ports = {f"{m.name}.{p.name}": p for m in program.modules for p in m.ports}
    sensors = [name for name, p in ports.items() if p.direction == "sensor"]
    called = [name for name, p in ports.items() if p.direction == "callable"]
    missing = [name for name in (*sensors, *called) if name not in found.domains and name not in found.answers]
    if missing:
        choice = f"answers, one of {', '.join(ANSWERS)}: name the answers"
        kind = choice if missing[0] in called else "values, a finite number of them: list the values"
        others = f" (so do {', '.join(missing[1:])})" if missing[1:] else ""
        raise MissingEnvironment(f"{missing[0]} needs {kind} in a file for --env{others}")
    for name, answers in found.answers.items():
        if name in ports and STRAIGHT in answers and not position_beside(program, name):
            raise MissingEnvironment(
                f"{name}: a straight path begins at the robot's position, but the module has no position sensor; list"
                " the possible paths in the file for --env"
            )


class _EnvironmentFile:
    def __init__(self, reader: YamlReader, program: decl.Program, sensors: dict[str, Type], called: list[str]) -> None:
        self.reader, self.program, self.sensors, self.called = reader, program, sensors, called

    def read(self, usual: Environment, n_sys: int) -> Environment:
        """Read the file and return its environment. `usual` has the values of ports that the file leaves out."""
        table = self.reader.table(
            self.reader.document(), "the environment", [], [*self.sensors, *self.called, "params", "robots"]
        )
        params = self._params(table.pop("params", None))
        robots = table.pop("robots", None)
        found = self._ports(table, usual)._replace(params=params)
        return found._replace(robots=self._robots(robots, found, n_sys))

    def _params(self, node: YamlNode | None) -> dict[str, Any]:
        found = {}
        for name, value in self.reader.table(node, "params", [], [p.name for p in self.program.params]).items():
            found[name] = self.reader.plain(value, f"param {name}")
            try:
                with_params(self.program, {name: found[name]})
            except BadParam as error:
                self.reader.report("F004", str(error), value)
        return found

    def _robots(self, node: YamlNode | None, usual: Environment, n_sys: int) -> dict[int, Environment]:
        """Return the environment of each robot that has an entry under `robots`, by pid.

        Entries of robots that this fleet does not have are left out, so one file serves fleets of several sizes."""
        found = {}
        keys = [key for key, _ in node.value] if node is not None and node.tag == "tag:yaml.org,2002:map" else []
        pids = [str(key.value) for key in keys if str(key.value).isdecimal()]
        for key in keys:
            if str(key.value) not in pids:
                self.reader.report(
                    "F002", f"unknown key {key.value!r} in robots", key, "a robot is named by its pid: 0"
                )
        for pid, own in self.reader.table(node, "robots", [], [str(key.value) for key in keys]).items():
            table = self.reader.table(own, f"robots.{pid}", [], [*self.sensors, *self.called])
            if pid in pids:
                found[int(pid)] = self._ports(table, usual)
        return {pid: own for pid, own in found.items() if pid < n_sys}

    def _ports(self, table: dict[str, YamlNode], usual: Environment) -> Environment:
        domains, answers = dict(usual.domains), dict(usual.answers)
        for name, node in table.items():
            if name in self.called:
                answers[name] = self._answers(node, name)
            else:
                domains[name] = self._domain(node, name, usual.domains.get(name))
        return Environment(domains, answers)

    def _answers(self, node: YamlNode, name: str) -> tuple[Any, ...]:
        if node.tag != "tag:yaml.org,2002:seq":
            return ANSWERS[self.reader.choice(node, name, tuple(ANSWERS)) or "none"]
        found: list[Any] = []
        for item in self._some(node, name):
            if item.tag == "tag:yaml.org,2002:str":
                found += ANSWERS[self.reader.choice(item, name, tuple(ANSWERS)) or "none"]
            else:
                found += self._values([item], name, PATH)
        return tuple(dict.fromkeys(found))

    def _domain(self, node: YamlNode, name: str, usual: SensorDomain | None) -> SensorDomain:
        type_ = self.sensors[name]
        if node.tag != "tag:yaml.org,2002:map":
            return SensorDomain(self._values(self._some(node, name), name, type_))
        keys = [key.value for key, _ in node.value]
        if "lidar" in keys:
            return self._lidar(node, name, type_)
        if keys == ["start"] and usual is not None:
            given, found = self.reader.table(node, name, ["start"], []), usual
        elif "grid" in keys:
            given = self.reader.table(node, name, ["grid"], ["moves", "start"])
            found = self._grid(node, given, name, type_)
        elif "values" in keys:
            given = self.reader.table(node, name, ["values"], ["start"])
            found = SensorDomain(self._values(self._some(given.get("values"), name), name, type_))
        else:
            given, found = self._interval(node, name, type_)
        if "start" not in given:
            return found
        starts = self._values(self._some(given["start"], f"{name}.start"), name, type_)
        strange = [value for value in starts if value not in found.values]
        if strange and found.values:
            self.reader.report("F005", f"{name}.start: {strange[0]} is not one of its values", given["start"])
        return found._replace(starts=starts)

    def _grid(self, node: YamlNode, given: dict[str, YamlNode], name: str, type_: Type) -> SensorDomain:
        reader = self.reader
        if type_ != POINT:
            reader.report("F004", f"{name} is of type {type_}: a grid has Points; write {_form(type_)}", node)
            return SensorDomain(())
        box = reader.table(given.get("grid"), f"{name}.grid", ["lo", "hi", "step"], [])
        lo, hi = reader.vector(box.get("lo"), "lo"), reader.vector(box.get("hi"), "hi")
        step = reader.number(box.get("step"), "step", 1e-6, 1e5)
        if lo is None or hi is None or step is None:
            return SensorDomain(())
        axes = self._axes(node, f"{name}.grid", zip(lo, hi, strict=True), step)
        points = tuple([Point(*place) for place in product(*axes)])
        if "moves" not in given:
            return SensorDomain(points)
        reach = reader.number(given["moves"], f"{name}.moves", 0, 1000, int) or 0
        return SensorDomain(points, _within(reach * step * (1 + ROUNDING)))

    def _interval(self, node: YamlNode, name: str, type_: Type) -> tuple[dict[str, YamlNode], SensorDomain]:
        reader = self.reader
        if type_ not in (INT, FLOAT):
            reader.report("F004", f"{name} is of type {type_}: write {_form(type_)}", node)
            return {}, SensorDomain(())
        kind, needed = (int, ["lo", "hi"]) if type_ == INT else (float, ["lo", "hi", "step"])
        given = reader.table(node, name, needed, ["step", "change", "start"])
        lo, hi = (reader.scalar(given.get(end), f"{name}.{end}", kind) for end in ("lo", "hi"))
        least = 1 if type_ == INT else 1e-6
        step = reader.number(given["step"], f"{name}.step", least, 1e9, kind) if "step" in given else 1
        change = reader.number(given["change"], f"{name}.change", 0, None, kind) if "change" in given else None
        if lo is None or hi is None or step is None:
            return given, SensorDomain(())
        (values,) = self._axes(node, name, [(lo, hi)], step)
        return given, SensorDomain(tuple(values), None if change is None else _change(change + ROUNDING * step))

    def _axes(self, node: YamlNode, what: str, ends: Any, step: float) -> list[list[Any]]:
        """Return a list of numbers for each axis of a grid, in ascending order.

        Returns empty lists and reports a mistake if an axis has no number or the grid has over MAX_VALUES points."""
        ends = list(ends)
        counts = [math.floor((hi - lo) / step + ROUNDING) + 1 for lo, hi in ends]
        if min(counts) < 1 or math.prod(counts) > MAX_VALUES:
            self.reader.report("F005", f"{what} has no value, or more than {MAX_VALUES}", node)
            return [[] for _ in ends]
        return [[_stepped(lo, step, k) for k in range(count)] for (lo, _), count in zip(ends, counts, strict=True)]

    def _lidar(self, node: YamlNode, name: str, type_: Type) -> SensorDomain:
        reader = self.reader
        if type_ != SCANS or not position_beside(self.program, name):
            reader.report("F004", f"{name} is of type {type_}: a lidar sees List<Point, Scan> from a position", node)
            return SensorDomain(())
        table = reader.table(
            reader.table(node, name, ["lidar"], []).get("lidar"), "lidar", ["rays", "range"], ["walls"]
        )
        rays = reader.number(table.get("rays"), "rays", 1, 360, int)
        range_ = reader.number(table.get("range"), "range", 0.01, 1e3)
        walls = []
        for item in reader.items(table.get("walls"), "walls"):
            box = reader.table(item, "a wall", ["lo", "hi"], [])
            lo, hi = reader.vector(box.get("lo"), "lo"), reader.vector(box.get("hi"), "hi")
            if lo is not None and hi is not None:
                walls.append((Point(*lo), Point(*hi)))
        if rays is None or range_ is None:
            return SensorDomain(())
        return SensorDomain(((),), seen_from=lidar(rays, range_, tuple(walls)))

    def _some(self, node: YamlNode | None, name: str) -> list[YamlNode]:
        items = self.reader.items(node, name)
        if node is not None and node.value == []:
            self.reader.report("F005", f"{name} has no value", node)
        return items

    def _values(self, items: list[YamlNode], name: str, type_: Type) -> tuple[Value, ...]:
        return tuple(self._each_value(items, name, type_))

    def _each_value(self, items: list[YamlNode], name: str, type_: Type) -> Iterator[Value]:
        """Yield the values of the items in a list. The file writes them in the same form as values of params."""
        at = Span(1, 1, 1, 1)
        param = decl.Param(name, type_, Const(0, type_, at), at)
        alone = replace(self.program, params=(param,), shared=(), locals=(), modules=())
        for item in items:
            try:
                made = with_params(alone, {name: self.reader.plain(item, name)})
            except BadParam as error:
                self.reader.report("F004", str(error).removeprefix("param "), item)
                continue
            yield initial(made, 1).params[name]


def _form(type_: Type) -> str:
    if type_ in (INT, FLOAT):
        return "{lo: a, hi: b, step: c}, or a list of values"
    return (
        "{grid: {lo: [x, y, z], hi: [x, y, z], step: s}}, or a list of values" if type_ == POINT else "a list of values"
    )


def _stepped(lo: float, step: float, k: int) -> float:
    """Return `lo` plus `k` steps, computed in decimals: 18 plus three steps of 0.1 is exactly 18.3."""
    return type(lo)(Decimal(repr(lo)) + k * Decimal(repr(step)))


def _within(reach: float) -> Callable[[Value, Value], bool]:
    def near(a: Any, b: Any) -> bool:
        return bool(max(abs(a.x - b.x), abs(a.y - b.y), abs(a.z - b.z)) <= reach)

    return near


def _change(most: float) -> Callable[[Value, Value], bool]:
    def near(a: Any, b: Any) -> bool:
        return bool(abs(a - b) <= most)

    return near
