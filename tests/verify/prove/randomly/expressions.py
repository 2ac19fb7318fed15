"""Random expressions as people write them: short, over visible variables, sometimes without a value."""

from __future__ import annotations

from random import Random

from tests.verify.prove.randomly.names import KEYS, Variable

COMPARISONS = ("==", "<", "<=", ">", ">=", "!=")
RISKY = 0.4  # of the atoms that may fail, how many are written without a test before them


class Expressions:
    """`scope` is what can be read; `functions` are calls by the type of their result, with the types of arguments."""

    def __init__(
        self, random: Random, scope: list[Variable], functions: dict[str, list[tuple[str, list[str]]]]
    ) -> None:
        self.random = random
        self.scope = scope
        self.functions = functions
        self.robots = True  # whether pid, N_SYS and others' slots can be read

    def pick(self, *options: str) -> str:
        return self.random.choice(options)

    def chance(self, share: float) -> bool:
        return self.random.random() < share

    def some(self, type_: str, writable: bool = False) -> Variable | None:
        """A variable of a type, if there is one."""
        found = [v for v in self.scope if v.type == type_ and (v.writable or not writable)]
        return self.random.choice(found) if found else None

    def read(self, type_: str) -> str:
        found = self.some(type_)
        return found.here if found else ""

    def simple(self, type_: str) -> str:
        """A variable or a literal."""
        return (self.chance(0.6) and self.read(type_)) or self.literal(type_)

    # Values by type

    def value(self, type_: str, depth: int = 0) -> str:
        match type_:
            case "int":
                return self.number(depth)
            case "bool":
                return self.truth(depth)
            case "float":
                return self.real(depth)
            case "Point":
                return self.point(depth)
        if (call := self.call(type_, depth)) and self.chance(0.4):
            return call
        if (known := self.read(type_)) and self.chance(0.6):
            return known
        return self.made(type_)

    def made(self, type_: str) -> str:
        """A value that is written out."""
        if type_.startswith("("):
            items = [self.value(part.strip(), 3) for part in type_[1:-1].split(",")]
            return f"({', '.join(items)})"
        if type_.startswith(("List<", "Queue<")):
            element = type_[type_.index("<") + 1 : -1]
            return f"[{', '.join(self.value(element, 3) for _ in range(self.random.choice((0, 1, 2, 3))))}]"
        if type_.startswith("Set<"):
            return f"{{{', '.join(sorted({self.pick('0', '1', '2', '3'), self.pick('0', '5')}))}}}"
        if type_.startswith("Map<"):
            return f"{{{KEYS[0] if 'string' in type_ else 1}: {self.number(3)}}}"
        return (
            f"Task({self.number(3)}, {self.number(3)})"
            if type_ == "Task"
            else {"string": '"a"'}.get(type_, self.literal(type_))
        )

    def literal(self, type_: str) -> str:
        match type_:
            case "int":
                return self.pick("0", "1", "2", "3", "5")
            case "bool":
                return self.pick("True", "False")
            case "float":
                return self.pick("0.0", "0.5", "1.5", "2.0")
        return f"Point({self.pick('0', '1', '5')}, {self.pick('0', '2')}, 0)"

    def number(self, depth: int = 0) -> str:
        if depth >= 3:
            return self.simple("int")
        roll = self.random.random()
        if depth < 2 and roll < 0.3:
            a, b = self.number(depth + 1), self.number(depth + 1)
            return self.pick(
                f"{a} + {b}", f"{a} + 1", f"{a} - 1", f"({a}) - ({b})", f"min({a}, {b})", f"max({a}, {b})",
                f"abs({a})", f"({a}) * 2", f"({a}) // 2", f"({a}) % 3", f"({a} if {self.truth(3)} else {b})",
            )  # fmt: skip
        if roll < 0.55 and (known := self.read("int")):
            return known
        if roll < 0.75 and (part := self.part()):
            return part
        if roll < 0.8 and self.robots:
            return self.pick("pid", "pid", "N_SYS", "N_SYS - 1", "(pid + 1) % N_SYS")
        if (
            roll < 0.85
            and self.robots
            and (slots := [v for v in self.scope if v.home == "allread" and v.type == "int"])
        ):
            slot = self.random.choice(slots).name
            return self.pick(
                f"{slot}[0]", f"{slot}[N_SYS - 1]", f"{slot}[(pid + 1) % N_SYS]", f"sum({slot})", f"{slot}.count(1)"
            )
        if roll < 0.9 and (call := self.call("int", depth)):
            return call
        return self.literal("int")

    def part(self) -> str:
        """A part or a measure of something bigger; some of these may have no value."""
        found = self.random.choice(self.scope) if self.scope else None
        if found is None:
            return ""
        name, risky = found.here, self.chance(RISKY)
        match found.type:
            case "List<int>" | "Queue<int>":
                safe = [f"len({name})"] + (
                    [f"{name}.count({self.number(3)})", f"sum({name})"] if found.type[0] == "L" else []
                )
                risk = [f"first({name})", f"last({name})", f"7 // len({name})"]
                risk += (
                    [f"{name}[{self.pick('0', '1', self.number(3))}]", f"{name}.index({self.number(3)})"]
                    if found.type[0] == "L"
                    else []
                )
                return self.pick(*(risk if risky else safe))
            case "Map<int, int>" | "Map<string, int>":
                key = self.pick(*KEYS) if "string" in found.type else self.number(3)
                return (
                    f"{name}[{key}]"
                    if risky
                    else self.pick(f"{name}.get({key}, {self.pick('0', '1', '-1')})", f"len({name})")
                )
            case "Set<int>" | "List<Task>" | "List<List<int>>" | "List<Point>" | "List<(int, int)>":
                if risky and found.type == "List<Task>":
                    return self.pick(f"first({name}).cost", f"{name}[{self.number(3)}].id", f"last({name}).id")
                if risky and found.type == "List<List<int>>":
                    return self.pick(f"len(first({name}))", f"{name}[0][0]", f"sum(last({name}))")
                return f"len({name})"
            case "Task":
                return f"{name}.{self.pick('id', 'cost')}"
            case "(int, bool)":
                return f"{name}[0]"
            case "float":
                return self.pick(f"floor({name})", f"round({name})", f"ceil({name})")
        return ""

    def truth(self, depth: int = 0) -> str:
        if depth >= 3:
            return self.simple("bool")
        roll = self.random.random()
        if depth < 2 and roll < 0.2:
            a, b = self.truth(depth + 1), self.truth(depth + 1)
            return self.pick(f"{a} and {b}", f"({a} or {b})", f"not ({a})")
        if roll < 0.4 and (known := self.read("bool")):
            return self.pick(known, known, f"not {known}")
        if roll < 0.5 and (asked := self.asked()):
            return asked
        if roll < 0.55 and (call := self.call("bool", depth)):
            return call
        if roll < 0.65 and (known := self.read("float")):
            return f"{known} {self.pick('<', '<=', '>', '>=')} {self.real(3)}"
        return f"{self.number(max(depth, 1))} {self.pick(*COMPARISONS)} {self.number(3)}"

    def asked(self) -> str:
        """A question about something bigger."""
        found = self.random.choice(self.scope) if self.scope else None
        if found is None:
            return ""
        name = found.here
        match found.type:
            case "List<int>" | "Set<int>" | "Map<int, int>" | "Queue<int>":
                return self.pick(
                    f"{self.number(3)} in {name}",
                    f"len({name}) > 0",
                    f"len({name}) < 3",
                    f"{self.number(3)} not in {name}",
                )
            case "Map<string, int>":
                return f"{self.pick(*KEYS)} in {name}"
            case "Point":
                return self.pick(
                    f"{name} in Rect(Point(0, 0, 0), Point(5, 5, 5))", f"{name}.x > {self.real(3)}",
                    f"{name} == {self.point(3)}", f"distance({name}, {self.point(3)}) < 2",
                )  # fmt: skip
            case "(int, bool)":
                return f"{name}[1]"
            case "List<Task>" | "List<List<int>>" | "List<Point>" | "List<(int, int)>":
                return self.pick(f"len({name}) > 0", f"len({name}) < 2")
        return ""

    def real(self, depth: int = 0) -> str:
        if depth >= 3:
            return self.simple("float")
        roll = self.random.random()
        if depth < 2 and roll < 0.3:
            a, b = self.real(depth + 1), self.real(depth + 1)
            return self.pick(f"{a} + {b}", f"{a} - 0.5", f"min({a}, {b})", f"max({a}, {b})", f"({a}) / 2", f"abs({a})")
        if roll < 0.7 and (known := self.read("float")):
            return known
        if roll < 0.78 and (known := self.read("Point")):
            return self.pick(f"{known}.x", f"{known}.y", f"distance({known}, {self.point(3)})")
        if roll < 0.83:
            return self.pick(f"sqrt({self.real(3)})", f"1 / ({self.real(3)})", f"sqrt({self.real(3)} - 1)")
        return self.literal("float")

    def point(self, depth: int = 0) -> str:
        if depth >= 3:
            return self.simple("Point")
        roll = self.random.random()
        if depth < 2 and roll < 0.2:
            a, b = self.point(depth + 1), self.point(depth + 1)
            return self.pick(f"({a} + {b}) / 2", f"{a} + Point(1, 0, 0)", f"({a} if {self.truth(3)} else {b})")
        if roll < 0.65 and (known := self.read("Point")):
            return known
        if roll < 0.72 and (route := self.read("List<Point>")):
            return self.pick(f"first({route})", f"{route}[0]", f"{route}[{self.number(3)}]")
        return self.literal("Point")

    def call(self, type_: str, depth: int) -> str:
        options = self.functions.get(type_)
        if not options:
            return ""
        name, wanted = self.random.choice(options)
        return f"{name}({', '.join(self.value(t, max(depth, 1)) for t in wanted)})"
