"""Random whole programs: declarations, functions, `init`, events and invariants."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random
from typing import NamedTuple

from koordgen.lang.analyze.program import check
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.verify import verify
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse
from tests.verify.prove.randomly.names import WORDS, Home, Variable, int_variable
from tests.verify.prove.randomly.statements import Statements, indented

TRIES = 40  # texts of one seed, until the checker takes one
BIG = (
    "List<int>", "List<int>", "List<int>", "List<Task>", "List<List<int>>", "Map<int, int>", "Map<string, int>",
    "Set<int>", "Queue<int>", "(int, bool)", "List<(int, int)>", "Task", "List<Point>",
)  # fmt: skip
LEVELS = (
    "level' >= 0",
    "0 <= level' and level' <= 3",
    "level' == level or level' == 0",
    "level' <= level + 1",
    "level' >= level",
)
MOVES = (
    "position' in Rect(position, target)", "position' in Rect(lo, hi)", "position' == position or position' == target",
    "not reached' or position' == target",
)  # fmt: skip
PLANS = (
    "planner(goal) == [] or first(planner(goal)) == position",
    "planner(goal) == [] or last(planner(goal)) == goal",
    "len(planner(goal)) <= 3",
)
HEATS = ("heat_now >= 0", "heat_now' >= heat_now", "0 <= heat_now' and heat_now' <= 2.5")


class Made(NamedTuple):
    """A text that the checker takes, its program, and how many texts were thrown away before it."""

    text: str
    program: Program
    refused: int


def checked(text: str) -> Program | None:
    """The program of a text; None where the checker finds an error."""
    source = Source("random.koord", text)
    tree, unread = parse(source)
    program, found = check(tree, source)
    if program is None or any(d.severity == "error" for d in (*unread, *found)):
        return None
    verify(program)
    return program


def program(seed: int) -> Made:
    """The program of a seed. Raises ValueError where none of its texts is right."""
    random = Random(seed)
    for refused in range(TRIES):
        text = _Writer(random).text()
        if (made := checked(text)) is not None:
            return Made(text, made, refused)
    raise ValueError(f"seed {seed}: no text of {TRIES} is right")


class _Writer:
    """One program. What is random is drawn while it is written, from top to bottom."""

    def __init__(self, random: Random) -> None:
        self.random = random
        self.variables: list[Variable] = []
        self.functions: dict[str, list[tuple[str, list[str]]]] = {}
        self.words = {type_: random.sample(words, len(words)) for type_, words in WORDS.items()}
        self.motion = self.log = self.bounded = self.planner = False

    def pick(self, *options: str) -> str:
        return self.random.choice(options)

    def chance(self, share: float) -> bool:
        return self.random.random() < share

    def text(self) -> str:
        declared = [*self.params(), *self.modules(), *self.shared()]
        task = ["def Task:", "  int id", "  int cost", ""] if any("Task" in v.type for v in self.variables) else []
        functions = [line for number in range(self.random.choice((0, 0, 1, 1, 2))) for line in self.function(number)]
        lines = [*task, *declared, "", *functions, *self.init()]
        events = [self.event(name) for name in self.names()]
        return "\n".join([*lines, *self.ordered(events), *self.properties()]) + "\n"

    def ordered(self, events: list[list[str]]) -> Iterator[str]:
        """The events, some of them in a `priority:` block now and then, with others before or behind it."""
        first, end = 0, 0
        if self.chance(0.4):
            first = self.random.choice((0, 0, 0, len(events) // 2))
            end = self.random.choice((len(events), len(events), len(events) - first // 2))
        for place, lines in enumerate(events):
            if first <= place < end:
                yield from ["priority:"] if place == first else []
                yield from indented(lines)
            else:
                yield from lines

    def names(self) -> list[str]:
        return self.random.sample(["Go", "Count", "Work", "Look", "Reset"], self.random.choice((1, 1, 2, 2, 2, 3)))

    # Declarations

    def params(self) -> Iterator[str]:
        if self.chance(0.25):
            yield "param int limit = 3"
            self.variables.append(Variable("limit", "int", "param"))
        if self.chance(0.15):
            yield "param float eps = 0.5"
            self.variables.append(Variable("eps", "float", "param"))

    def modules(self) -> Iterator[str]:
        self.motion = self.chance(0.3)
        if self.chance(0.5):
            yield "using Dev:"
            kinds = self.random.sample(["int level", "bool on", "float heat_now"], self.random.choice((1, 1, 2)))
            for kind in kinds:
                yield f"  sensors: {kind}"
                type_, name = kind.split()
                self.variables.append(Variable(f"Dev.{name}", type_, "sensor", "range", 0, 3))
            for _ in range(self.random.choice((0, 1, 1, 2)) if "int level" in kinds else 0):
                yield f"  assume {self.pick(*LEVELS)}"
            if "float heat_now" in kinds and self.chance(0.6):
                yield f"  assume {self.pick(*HEATS)}"
        if self.motion:
            yield from self.moving()
        self.log = self.chance(0.25)
        if self.log:
            yield from ("using Log:", "  stream stdout")

    def moving(self) -> Iterator[str]:
        """A module of motion, with a position or without one."""
        self.bounded = self.chance(0.5)
        position, reached = self.chance(0.7), self.chance(0.4)
        if self.bounded:
            yield "param Point lo = Point(0, 0, 0)"
            yield "param Point hi = Point(5, 5, 5)"
            self.variables += [Variable("lo", "Point", "param"), Variable("hi", "Point", "param")]
        yield "using Motion:"
        if position:
            yield "  sensors: Point position"
            self.variables.append(Variable("Motion.position", "Point", "sensor"))
        if reached:
            yield "  sensors: bool reached"
            self.variables.append(Variable("Motion.reached", "bool", "sensor"))
        yield "  actuators: Point target"
        self.variables.append(Variable("Motion.target", "Point", "actuator"))
        self.planner = self.chance(0.35)
        if self.chance(0.7 if self.planner else 0.1):
            yield "  actuators: List<Point> path"
            self.variables.append(Variable("Motion.path", "List<Point>", "actuator"))
        if self.planner:
            yield "  PathPlanner planner"
            self.functions.setdefault("List<Point>", []).append(("Motion.planner", ["Point"]))
        allowed = [m for m in MOVES if position and (reached or "reached" not in m) and (self.bounded or "lo" not in m)]
        for _ in range(self.random.choice((0, 1, 1, 2)) if allowed else 0):
            yield f"  assume {self.random.choice(allowed)}"
        if self.planner and self.chance(0.1):
            yield from ("  assume planner(goal) == []", "  assume len(planner(goal)) > 0")
        elif self.planner and position:
            yield f"  assume {self.pick(*PLANS)}"

    def shared(self) -> Iterator[str]:
        homes: dict[Home, list[Variable]] = {"allread": [], "allwrite": [], "local": []}
        for home, most in (("local", 3), ("allread", 2), ("allwrite", 1)):
            made = homes[home]  # type: ignore[index]
            for _ in range(self.random.randint(1 if home == "local" else 0, most)):
                made.append(int_variable(self.random, self.words["int"].pop(), home))  # type: ignore[arg-type]
        for type_ in ("bool", "bool", "float", "Point", *self.random.sample(BIG, 3)):
            if self.chance(0.5):
                home = self.random.choice(("local", "local", "local", "allread", "allwrite"))
                if self.words[type_]:
                    homes[home].append(Variable(self.words[type_].pop(), type_, home))  # type: ignore[index, arg-type]
        for home, variables in homes.items():
            if variables:
                yield f"{home}:"
            for v in variables:
                size = "[N_SYS]" if home == "allread" else ""
                yield f"  {v.type} {v.name}{size}{self.first(v)}"
            self.variables += variables

    def first(self, v: Variable) -> str:
        if v.type == "List<int>" and self.chance(0.4):
            return f" = {self.pick('[1, 2, 3]', '[0]', '[2, 0]', '[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]')}"
        if v.type == "Map<int, int>" and self.chance(0.3):
            return " = {1: 2}"
        return v.first()

    # Blocks

    def writer(self, scope: list[Variable], place: str) -> Statements:
        made = Statements(self.random, scope, self.functions, place)
        made.log = self.log and place == "event"
        return made

    def function(self, number: int) -> list[str]:
        """A function with a loop, mostly: a search, a fold or anything."""
        name = ("chosen", "rated")[number]
        result = self.pick("int", "int", "bool")
        parameter = self.pick(
            "List<int>", "List<int>", "List<int>", "int", "Map<int, int>", "Set<int>", "List<List<int>>"
        )
        takes = [Variable("values", parameter, "param"), Variable("wanted", "int", "param")]
        body = self.writer(takes, "function")
        body.result = result
        made = body.random.random()
        if made < 0.75:
            if result == "int":
                lines = [f"int result = {body.literal('int')}"]
                body.scope.append(Variable("result", "int", "temp"))
                body.minted.add("result")
            else:
                lines = []
            lines += body.loop(1) if made < 0.6 else body.block(2, 1)
            lines.append(f"return {'result' if result == 'int' else body.pick('True', 'False', body.truth(1))}")
        else:
            lines = [f"if {body.truth()}: return {body.value(result)}", f"return {body.value(result)}"]
        self.functions.setdefault(result, []).append((name, [parameter, "int"]))
        return [f"fun {name}({parameter} values, int wanted) -> {result}:", *indented(lines), ""]

    def init(self) -> list[str]:
        if self.chance(0.5):
            return []
        scope = [v for v in self.variables if v.home in ("local", "sensor", "param", "actuator")]
        body = self.writer(scope, "init")
        return ["init:", *indented(body.block(self.random.choice((1, 2, 3)), self.random.choice((0, 1, 1)))), ""]

    def event(self, name: str) -> list[str]:
        body = self.writer(self.variables, "event")
        guard = self.guard(body)
        lines = body.block(self.random.choice((1, 1, 2, 2, 3, 4)))
        if self.chance(0.06):
            lines.append("stop")
        head = "  eff: atomic:" if self.chance(0.3) else "  eff:"
        return [f"{name}:", f"  pre: {guard}", head, *indented(indented(lines)), ""]

    def guard(self, body: Statements) -> str:
        own = [v for v in self.variables if v.type == "int" and v.home in ("local", "allread") and v.form == "range"]
        roll = self.random.random()
        if roll < 0.3:
            return "True"
        if own and roll < 0.6:
            v = self.random.choice(own)
            return self.pick(f"{v.here} < {v.high}", f"{v.here} == {v.low}", f"{v.here} > {v.low}")
        return body.truth()

    # Properties

    def properties(self) -> Iterator[str]:
        for v in self.variables:
            if v.home == "sensor" and v.type == "int" and self.chance(0.8):
                yield f"initially: forall i in ID: 0 <= {v.of('i')} and {v.of('i')} <= 3"
            if v.home == "sensor" and v.type == "float" and self.chance(0.8):
                yield f"initially: forall i in ID: {v.of('i')} == 0"
            if v.home == "sensor" and v.type == "Point" and self.bounded and self.chance(0.8):
                yield f"initially: forall i in ID: {v.of('i')} in Rect(lo, hi)"
        for number in range(self.random.choice((2, 3, 3, 4))):
            yield f"invariant I{number}: {self.invariant()}"

    def invariant(self) -> str:
        known = [v for v in self.variables if v.home != "param"]
        v = self.random.choice(
            [v for v in known if v.type == "int" and v.home != "sensor"] if self.chance(0.6) else known
        )
        claim = self.claim(v, "i")
        roll = self.random.random()
        if self.chance(0.015):
            return self.pick("N_SYS < 0", "False", "N_SYS >= 1")
        if roll < 0.15 and v.own:
            other = self.random.choice([w for w in known if w.type in ("bool", "int")] or [v])
            guard = (
                other.of("i")
                if other.type == "bool"
                else f"{other.of('i')} {self.pick('>', '<', '==')} {self.pick('0', '1', '3')}"
            )
            claim = self.pick(
                f"not ({guard}) or ({claim})", f"({claim}) or {guard}", f"{claim} and {self.claim(v, 'i')}"
            )
        if roll > 0.93 and v.own:
            pair = self.pick("!=", "<=", "==")
            return f"forall i, j in ID: i == j or {v.of('i')} {pair if v.type == 'int' else '=='} {v.of('j')}"
        if roll > 0.88:
            claim = self.pick(f"N_SYS > 1 or ({claim})", f"N_SYS == 1 or ({claim})", f"N_SYS < 3 or ({claim})")
        if roll > 0.84 and v.own:
            return f"exists i in ID: {claim}"
        return f"forall i in ID: {claim}" if "[i]" in claim else claim

    def claim(self, v: Variable, i: str) -> str:
        """What may be true of a variable."""
        name = v.of(i)
        match v.type:
            case "int":
                return self.number_claim(v, i)
            case "bool":
                return self.pick(f"not {name}", f"not {name} or N_SYS >= 1", f"{name} == {name}", name)
            case "float":
                return self.pick(f"{name} >= 0", f"{name} <= 2", f"{name} == 0", f"{name} > -3", f"{name} < 10")
            case "Point":
                box = (
                    self.pick("Rect(lo, hi)", "Rect(Point(0, 0, 0), Point(5, 5, 5))")
                    if self.bounded
                    else "Rect(Point(0, 0, 0), Point(5, 5, 5))"
                )
                return self.pick(
                    f"{name} in {box}",
                    f"{name} in {box}",
                    f"{name}.z == 0",
                    f"{name} == Point(0, 0, 0)",
                    f"{name}.x >= 0",
                )
            case "Task":
                return self.pick(f"{name}.cost >= 0", f"{name}.id == 0", f"{name}.id <= 5")
            case "(int, bool)":
                return self.pick(f"{name}[0] >= 0", f"not {name}[1]", f"{name}[0] == 0")
            case "Set<int>" | "Map<int, int>":
                return self.pick(f"not 1 in {name}", f"len({name}) <= 3", f"len({name}) >= 0", f"len({name}) == 0")
            case "Map<string, int>":
                return self.pick(f'not "a" in {name}', f"len({name}) <= 3")
            case "List<int>":
                return self.pick(
                    f"len({name}) <= 3",
                    f"len({name}) > 0",
                    f"len({name}) == 0",
                    f"not 3 in {name}",
                    f"sum({name}) >= 0",
                )
        return self.pick(f"len({name}) <= 3", f"len({name}) <= 2", f"len({name}) == 0", f"len({name}) >= 0")

    def number_claim(self, v: Variable, i: str) -> str:
        name = v.of(i)
        low, high = v.low, v.high
        own = {
            "range": (f"{name} >= {low}", f"{name} <= {high}", f"{low} <= {name} and {name} <= {high}"),
            "grows": (f"{name} >= 0", f"{name} >= 0", f"{name} > -5"),
            "index": (f"{name} >= -1", f"{name} < N_SYS", f"-1 <= {name} and {name} < N_SYS"),
            "same": (f"{name} == {low}", f"{name} <= {low}", f"{name} >= {low}"),
        }.get(v.form, (f"{name} >= 0", f"{name} <= 3", f"{name} == 0"))
        others = [w for w in self.variables if w.type == "int" and w != v]
        wild = [
            f"{name} >= {self.pick('0', '1', '-1', '5')}",
            f"{name} <= {self.pick('0', '1', '3', '10')}",
            f"{name} == {self.pick('0', '1')}",
        ]
        wild += [
            f"{name} != {self.pick('7', '5', '2')}",
            f"{name} <= N_SYS",
            f"{name} == N_SYS",
            f"{name} == {i} or {name} <= 0" if v.own else f"{name} < 9",
        ]
        lists = [w for w in self.variables if w.type == "List<int>"]
        if lists:
            xs = self.random.choice(lists).of(i)
            wild += [
                f"{name} <= len({xs})",
                f"{name} >= len({xs})",
                f"{name} in {xs} or {name} <= 0",
                f"{name} >= sum({xs})",
            ]
        if others:
            w = self.random.choice(others)
            wild += [f"{name} <= {w.of(i)}", f"{name} >= {w.of(i)}", f"{name} == {w.of(i)}", f"{name} + {w.of(i)} >= 0"]
        return self.random.choice(own if self.chance(0.65) else wild)
