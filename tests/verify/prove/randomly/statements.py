"""Random statements as people write them: loops of every kind, searches, folds, nested data, early exits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random

from tests.verify.prove.randomly.expressions import Expressions
from tests.verify.prove.randomly.names import KEYS, Variable

DEEPEST = 3  # blocks within one another
SLIPS = 0.15  # of the writes to a variable that keeps to something, how many do not


class Statements(Expressions):
    """The statements of one block of a program: `place` says of which kind it is. Names of `locked` are read only: a
    loop's end depends on them."""

    def __init__(
        self, random: Random, scope: Sequence[Variable], functions: dict[str, list[tuple[str, list[str]]]], place: str
    ) -> None:
        super().__init__(random, list(scope), functions)
        self.place = place
        self.robots = place != "function"
        self.locked: set[str] = set()
        self.minted: set[str] = {v.name for v in scope}
        self.loops = 0
        self.result = ""
        self.log = False

    # Blocks

    def block(self, count: int, depth: int = 0) -> list[str]:
        """So many statements, nested ones not counted; at least one line."""
        kept, lines = list(self.scope), []
        for _ in range(count):
            lines += self.statement(depth)
        self.scope[:] = kept
        return lines or ["pass"]

    def inner(self, depth: int) -> list[str]:
        """The block of something at `depth`, indented."""
        return indented(self.block(self.random.choice((1, 1, 2)), depth + 1))

    def statement(self, depth: int) -> list[str]:
        roll = self.random.random()
        if depth < DEEPEST and self.chance((0.3, 0.14, 0.07)[depth]):
            return self.loop(depth)
        if depth < DEEPEST and self.chance((0.22, 0.2, 0.12)[depth]):
            return self.branch(depth)
        if roll < 0.3 and (lines := self.change()):
            return lines
        if roll < 0.37:
            return self.let()
        if roll < 0.4 and self.log:
            return [f'Log.stdout << "at " << {self.number(1)}']
        return self.write()

    def branch(self, depth: int) -> list[str]:
        lines = [f"if {self.truth()}:", *self.inner(depth)]
        if self.chance(0.15):
            lines += [f"elif {self.truth(1)}:", *self.inner(depth)]
        if self.chance(0.35):
            lines += ["else:", *self.inner(depth)]
        return lines

    def let(self) -> list[str]:
        type_ = self.pick("int", "int", "bool", "float", "Point", "List<int>")
        name = self.mint({"int": "n", "bool": "here", "float": "d", "Point": "p", "List<int>": "copy"}[type_])
        line = f"{type_} {name} = {self.value(type_, 1)}"
        self.scope.append(Variable(name, type_, "temp"))
        return [line]

    def mint(self, *names: str) -> str:
        """A name that nothing has in this block of the program."""
        name = self.pick(*names)
        number = 1
        while name in self.minted:
            number += 1
            name = f"{name.rstrip('0123456789')}{number}"
        self.minted.add(name)
        return name

    # Writes

    def target(self, type_: str = "") -> Variable | None:
        found = [
            v for v in self.scope
            if v.writable and v.name not in self.locked and (not type_ or v.type == type_)
        ]  # fmt: skip
        return self.random.choice(found) if found else None

    def write(self) -> list[str]:
        target = self.target("int") if self.chance(0.5) else self.target()
        if target is None:
            return ["pass"]
        if target.type == "int":
            return self.int_write(target)
        if target.home == "actuator" or target.type in ("bool", "float", "Point") or self.chance(0.3):
            return [f"{target.here} = {self.value(target.type)}"]
        return self.changed(target)

    def int_write(self, target: Variable) -> list[str]:
        """A write that mostly keeps to what the variable keeps to."""
        v = target.here
        form = "any" if self.chance(SLIPS) else target.form
        low, high = str(target.low), str(target.high)
        match form:
            case "range":
                return self.lines(
                    f"if {v} < {high}: {v} += 1",
                    f"if {v} > {low}: {v} -= 1",
                    f"{v} = {low}",
                    f"{v} = {high}",
                    f"{v} = max({low}, min({high}, {self.number(1)}))",
                    f"{v} = min({v} + 1, {high})",
                    f"{v} = max({v} - 1, {low})",
                )
            case "grows":
                return self.lines(
                    f"{v} += 1", f"{v} += 2", f"{v} = max({v}, {self.number(1)})", f"{v} += abs({self.number(2)})"
                )
            case "index":
                told = ("pid", "-1", f"({v} + 1) % N_SYS", "0") if self.robots else ("-1", "0")
                return [f"{v} = {self.pick(*told)}"]
            case "same":
                return self.lines(f"{v} = {low}", f"{v} = max({v}, {low})", f"if {v} != {low}: {v} = {low}")
        return self.lines(
            f"{v} = {self.number()}",
            f"{v} = {self.number()}",
            f"{v} += {self.number(2)}",
            f"{v} -= 1",
            f"{v} = {self.literal('int')}",
        )

    def lines(self, *options: str) -> list[str]:
        return [self.random.choice(options)]

    def change(self) -> list[str]:
        """A change of a part of something bigger."""
        found = [
            v for v in self.scope
            if v.writable and v.home != "actuator" and v.name not in self.locked
            and v.type not in ("int", "bool", "float", "Point")
        ]  # fmt: skip
        return self.changed(self.random.choice(found)) if found else []

    def changed(self, target: Variable) -> list[str]:
        v, n = target.here, self.number(2)
        match target.type:
            case "List<int>":
                return self.lines(
                    f"{v}.append({n})", f"if len({v}) < 3: {v}.append({n})", f"if len({v}) < 3: {v}.append({n})",
                    f"{v}.clear()", f"{v}.remove(3)", f"if {n} in {v}: {v}.remove({n})", f"{v}[0] = {n}",
                    f"if len({v}) > 0: {v}[len({v}) - 1] = {n}", f"{v}.insert(0, {n})", f"if len({v}) > 0: {v}.pop()",
                    f"{v} = {v} + [{n}]", f"{v} = sorted({v})", f"{v} = reversed({v})", f"{v}.extend([1, 2])",
                    f"{v} = []",
                )  # fmt: skip
            case "Queue<int>":
                popped = self.target("int")
                taken = [f"{popped.here} = {v}.pop()"] if popped else []
                return self.lines(f"{v}.push({n})", f"if len({v}) < 2: {v}.push({n})", f"{v}.clear()", *taken)
            case "Set<int>":
                return self.lines(
                    f"{v}.add({n})", f"{v}.clear()", f"if {n} in {v}: {v}.remove({n})", f"{v} = {v}.union({{1, 2}})"
                )
            case "Map<int, int>" | "Map<string, int>":
                key = self.pick(*KEYS) if "string" in target.type else n
                return self.lines(
                    f"{v}[{key}] = {self.number(1)}", f"{v}[{key}] = {v}.get({key}, 0) + 1", f"{v}.clear()",
                    f"if {key} in {v}: {v}.remove({key})", f"if {key} in {v}: {v}[{key}] += 1",
                )  # fmt: skip
            case "Task":
                return self.lines(f"{v}.id = {n}", f"{v}.cost += 1", f"{v}.cost = {self.number(1)}")
            case "List<Task>":
                return self.lines(
                    f"if len({v}) < 3: {v}.append(Task({n}, {self.number(2)}))", f"{v}[0].cost = {n}", f"{v}.clear()",
                    f"if len({v}) > 0: {v}[0].id = {n}", f"if len({v}) > 0: {v}.pop(0)",
                )  # fmt: skip
            case "List<List<int>>":
                return self.lines(
                    f"if len({v}) < 3: {v}.append([{n}])", f"{v}[0].append({n})", f"{v}.clear()",
                    f"if len({v}) > 0: {v}[0].append({n})", f"{v}.append([])",
                )  # fmt: skip
            case "(int, bool)":
                return self.lines(f"{v} = ({n}, {self.truth(1)})", f"{v}[0] = {n}", f"{v}[1] = {self.truth(1)}")
            case "List<(int, int)>":
                return self.lines(f"if len({v}) < 3: {v}.append(({n}, {self.number(2)}))", f"{v}.clear()")
            case "List<Point>":
                return self.lines(
                    f"if len({v}) < 3: {v}.append({self.point(1)})",
                    f"{v} = {self.value(target.type, 1)}",
                    f"{v} = {self.value(target.type, 1)}",
                    f"{v}.clear()",
                )
        return [f"{v} = {self.value(target.type)}"]

    # Loops

    def loop(self, depth: int) -> list[str]:
        kinds: tuple[tuple[int, Callable[[int], list[str]]], ...] = (
            (3, self.counted), (2, self.robots_all), (2, self.over_list), (3, self.over_other), (2, self.counter),
            (1, self.forever), (1, self.drain), (2, self.fold), (2, self.search),
        )  # fmt: skip
        (made,) = self.random.choices([kind for _, kind in kinds], [weight for weight, _ in kinds])
        return made(depth) or self.counter(depth)

    def run(
        self, header: str, depth: int, names: Sequence[Variable] = (), first: Sequence[str] = (),
        last: Sequence[str] = (), counter: str = "",
    ) -> list[str]:  # fmt: skip
        """A loop with a block of its own, which begins with the lines `first` and ends with `last`. `counter`: what the
        loop counts up, from 0 or more."""
        kept = list(self.scope)
        self.scope += names
        self.loops += 1
        body = self.block(self.random.choice((1, 1, 2, 3)), depth + 1)
        if self.chance(0.25):
            body += self.leaving()
        elif self.chance(0.15) and not last:
            body = [f"if {self.truth(1)}: continue", *body]
        self.loops -= 1
        self.scope[:] = kept
        return [header, *indented([*self.promises(counter), *first, *body, *last])]

    def promises(self, counter: str = "") -> list[str]:
        """Loop invariants; many of them are true."""
        if self.chance(0.5):
            return []
        if counter and self.chance(0.6):
            return [f"invariant {counter} >= {self.pick('0', '0', f'old({counter})', '1')}"]
        found = self.some("int", writable=True)
        if found is None:
            return []
        v = found.here
        low, high = f"{v} >= {found.low}", f"{v} <= {found.high}"
        told = self.pick(low, high, f"{low} and {high}", f"{v} >= old({v})", f"{v} == old({v})")
        return [f"invariant {told}"]

    def leaving(self) -> list[str]:
        """The end of a loop's run, or of more."""
        how = ["break", "break", "break"]
        how += [f"return {self.value(self.result, 1)}"] if self.result else []
        how += ["stop"] if self.place == "event" and self.chance(0.3) else []
        return ["break"] if self.chance(0.15) else [f"if {self.truth(1)}: {self.random.choice(how)}"]

    def bound(self) -> str:
        """How far a loop over numbers goes."""
        lists = [v for v in self.scope if v.type.startswith(("List", "Queue", "Set", "Map"))]
        options = ["2", "3", "3", "9", "10"]
        options += ["N_SYS", "N_SYS", "pid"] if self.robots else []
        options += [v.here for v in self.scope if v.type == "int"][:3]
        options += [f"len({self.random.choice(lists).here})"] * 2 if lists else []
        return self.random.choice(options)

    def counted(self, depth: int) -> list[str]:
        name = self.mint("i", "k", "at")
        bound = self.bound()
        ends = self.pick(
            bound, bound, bound, f"1, {bound}", f"0, {bound}, 2", f"{bound}, 0, -1", f"{bound} - 1, -1, -1", "4, 0, -1",
            "1, 10, 3", f"{self.number(2)}, {bound}",
        )  # fmt: skip
        return self.run(f"for {name} in range({ends}):", depth, [Variable(name, "int", "temp")])

    def robots_all(self, depth: int) -> list[str]:
        if not self.robots:
            return []
        name = self.mint("i", "other", "robot")
        first = ["if " + name + " == pid: continue"] if self.chance(0.2) else []
        return self.run(f"for {name} in ID:", depth, [Variable(name, "int", "temp")], first)

    def over_list(self, depth: int) -> list[str]:
        lists = [v for v in self.scope if v.type in ("List<int>", "List<Task>", "List<List<int>>", "List<Point>")]
        if not lists:
            return []
        found = self.random.choice(lists)
        element = found.type[5:-1]
        name = self.mint({"int": "x", "Task": "job", "List<int>": "row", "Point": "p"}[element])
        return self.run(f"for {name} in {found.here}:", depth, [Variable(name, element, "temp")])

    def over_other(self, depth: int) -> list[str]:
        others = [
            v for v in self.scope if v.type in ("Map<int, int>", "Set<int>", "List<(int, int)>", "Map<string, int>")
        ]
        if not others:
            return []
        found = self.random.choice(others)
        a, b, v = self.mint("key", "a"), self.mint("value", "b"), found.here
        key, value = Variable(a, "int", "temp"), Variable(b, "int", "temp")
        if found.type == "Set<int>":
            return self.run(f"for {a} in {v}:", depth, [key])
        if found.type == "List<(int, int)>":
            return self.run(f"for {a}, {b} in {v}:", depth, [key, value])
        if found.type == "Map<string, int>":
            return self.run(f"for {a}, {b} in {v}.items():", depth, [value])
        if self.chance(0.5):
            return self.run(f"for {a}, {b} in {v}.items():", depth, [key, value])
        return self.run(f"for {a} in {self.pick(v, f'{v}.keys()')}:", depth, [key])

    def counter(self, depth: int) -> list[str]:
        """A `while` with a counter of its own, which `continue` does not hold up."""
        name = self.mint("k", "turn", "n")
        lines = [f"int {name} = 0"]
        also = f" and {self.truth(1)}" if self.chance(0.3) else ""
        bound = self.bound()
        self.scope.append(Variable(name, "int", "temp"))
        self.locked.add(name)
        step, end = [f"{name} += 1"], self.chance(0.5)
        header = f"while {name} < {bound}{also}:"
        body = self.run(header, depth, (), [] if end else step, step if end else [], name)
        self.locked.discard(name)
        return lines + body

    def forever(self, depth: int) -> list[str]:
        name = self.mint("k", "turn")
        ends = f"if {name} >= {self.bound()}: break"
        self.locked.add(name)
        self.scope.append(Variable(name, "int", "temp"))
        leave = [ends, f"{name} += 1"] if self.chance(0.5) else [f"{name} += 1", ends]
        lines = [f"int {name} = 0", *self.run("while True:", depth, (), leave, (), name)]
        self.locked.discard(name)
        return lines

    def drain(self, depth: int) -> list[str]:
        """A `while` that ends because it makes something smaller or bigger."""
        queue = self.target("Queue<int>")
        if queue is not None and self.chance(0.6):
            job = self.mint("job", "next")
            self.locked.add(queue.name)
            lines = self.run(
                f"while len({queue.here}) > 0:",
                depth,
                [Variable(job, "int", "temp")],
                [f"int {job} = {queue.here}.pop()"],
            )
            self.locked.discard(queue.name)
            return lines
        number = self.target("int")
        if number is None or number.home == "temp":
            return []
        self.locked.add(number.name)
        v = number.here
        if self.chance(0.6):
            bound = self.bound()
            lines = self.run(f"while {v} < {bound}:", depth, (), [f"{v} += 1"]) if bound != v else []
        else:
            lines = self.run(f"while {v} > {self.literal('int')}:", depth, (), [f"{v} -= 1"])
        self.locked.discard(number.name)
        return lines

    def fold(self, depth: int) -> list[str]:
        """Most, least, how many or how much of the elements, as a loop."""
        target = self.target("int")
        if target is None:
            return []
        name, domain, element = self.elements()
        v = target.here
        count = f"if {element} {self.pick('>', '==', '<')} {self.number(2)}: {v} += 1"
        step = self.pick(
            f"{v} = max({v}, {element})",
            f"{v} = min({v}, {element})",
            f"{v} += {element}",
            count,
            f"if {element} > {v}: {v} = {element}",
        )
        first = [f"{v} = {self.pick('0', '0', '-1', '10')}"] if self.chance(0.5) else []
        return [*first, f"for {name} in {domain}:", *indented([*self.promises(v), step])]

    def search(self, depth: int) -> list[str]:
        """The first element that something is true of."""
        name, domain, element = self.elements()
        condition = self.pick(
            f"{element} {self.pick('>', '==', '<')} {self.number(2)}", f"{element} != 0", self.truth(1)
        )
        if self.result and self.chance(0.6):
            return [f"for {name} in {domain}:", f"  if {condition}: return {self.value(self.result, 2)}"]
        flag, number = self.target("bool"), self.target("int")
        found = [f"{flag.here} = True"] if flag else []
        found += (
            [f"{number.here} = {name if domain != 'pairs' else element}"]
            if number and (not flag or self.chance(0.6))
            else []
        )
        first = [f"{flag.here} = False"] if flag and self.chance(0.6) else []
        return [
            *first,
            f"for {name} in {domain}:",
            f"  if {condition}:",
            *[f"    {line}" for line in found or ["pass"]],
            "    break",
        ]

    def elements(self) -> tuple[str, str, str]:
        """A loop's variable, what it runs over, and an int of each run."""
        name = self.mint("i", "k", "x")
        slots = [v for v in self.scope if v.home == "allread" and v.type == "int"] if self.place == "event" else []
        lists = [v for v in self.scope if v.type == "List<int>"]
        if slots and self.chance(0.5):
            return name, self.pick("ID", "range(N_SYS)"), f"{self.random.choice(slots).name}[{name}]"
        if lists and self.chance(0.7):
            found = self.random.choice(lists).here
            return (name, found, name) if self.chance(0.5) else (name, f"range(len({found}))", f"{found}[{name}]")
        return name, self.pick("ID", "range(5)", "range(N_SYS)", "range(9)") if self.robots else "range(9)", name


def indented(lines: Sequence[str]) -> list[str]:
    return [f"  {line}" for line in lines]
