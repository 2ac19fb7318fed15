"""Random programs with loops that are nearly right: counters, searches and folds over lists, some with a mistake."""

from __future__ import annotations

from random import Random

VALUES = ("k", "m", "n", "len(xs)", "len(ys)", "0", "1", "2", "3")
ORDERS = ("<", "<=", ">", ">=", "!=", "==")
HEAD = """\
local:
  List<int> xs
  List<int> ys
  int n
Go:
  pre: {guard}
  eff:
    int k = {k}
    int m = {m}
"""


def random_text(seed: int) -> str:
    """A program of one event, which reads and writes two lists and three ints."""
    return _Text(Random(seed)).program()


class _Text:
    """Lines of one event. `counters` are the names of the loops around, which may be read."""

    def __init__(self, rng: Random) -> None:
        self.rng = rng
        self.loops = 0

    def program(self) -> str:
        firsts = ("0", "0", "0", "1", "len(xs) - 1", "len(xs)", "-1", "pid")
        guard = self.rng.choice(("True", "n >= 0", "len(xs) > 0", "n < len(ys)"))
        head = HEAD.format(guard=guard, k=self.rng.choice(firsts), m=self.rng.choice(firsts))
        lines = self.loop("    ", 2, ())
        if self.rng.random() < 0.5:
            lines += self.block("    ", 1, (), False)
        return head + "\n".join(lines) + "\n"

    def value(self, counters: tuple[str, ...]) -> str:
        text = self.rng.choice((*VALUES, *counters))
        if self.rng.random() < 0.4:
            text += f" {self.rng.choice('+-')} {self.rng.choice(('1', '2', 'k', 'm', *counters))}"
        return text

    def condition(self, counters: tuple[str, ...]) -> str:
        text = f"{self.value(counters)} {self.rng.choice(ORDERS)} {self.value(counters)}"
        if self.rng.random() < 0.3:
            joint = self.rng.choice(("and", "or"))
            text += f" {joint} {self.value(counters)} {self.rng.choice(ORDERS)} {self.value(counters)}"
        return text

    def block(self, pad: str, depth: int, counters: tuple[str, ...], inside: bool) -> list[str]:
        count = self.rng.randrange(1, 4)
        return [line for _ in range(count) for line in self.statement(pad, depth, counters, inside)]

    def statement(self, pad: str, depth: int, counters: tuple[str, ...], inside: bool) -> list[str]:
        name, values = self.rng.choice(("k", "k", "m", "n")), self.rng.choice(("xs", "ys"))
        step = f"{name} {self.rng.choice(('+=', '+=', '-='))} {self.rng.choice(('1', '1', '2', 'm', 'k'))}"
        simple = (
            step,
            step,
            f"{name} = {self.value(counters)}",
            f"n = {values}[{self.value(counters)}]",
            f"{values}.append({self.value(counters)})",
            f"xs[{self.value(counters)}] = 1",
            f"n = 7 // ({self.value(counters)})",
        )
        match self.rng.randrange(12):
            case 0 | 1 if depth:
                return self.branch(pad, depth - 1, counters, inside)
            case 2 | 3 if depth:
                return self.loop(pad, depth - 1, counters)
            case 4 if inside:
                return [f"{pad}if {self.condition(counters)}: {self.rng.choice(('break', 'continue'))}"]
            case 5 if counters:
                return [f"{pad}{self.rng.choice(counters)} += 1"]
            case _:
                return [pad + self.rng.choice(simple)]

    def branch(self, pad: str, depth: int, counters: tuple[str, ...], inside: bool) -> list[str]:
        lines = [f"{pad}if {self.condition(counters)}:", *self.block(pad + "  ", depth, counters, inside)]
        if self.rng.random() < 0.5:
            lines += [f"{pad}else:", *self.block(pad + "  ", depth, counters, inside)]
        return lines

    def loop(self, pad: str, depth: int, counters: tuple[str, ...]) -> list[str]:
        self.loops += 1
        counter = f"i{self.loops}"
        if self.rng.random() < 0.6:
            return [pad + line for line in self.usual(counter, depth, counters)]
        turns = self.rng.choice(("", "", ", 2", ", -1"))
        head, own = self.rng.choice(
            (
                (f"while {self.condition(counters)}:", ()),
                (f"while {self.rng.choice('km')} < {self.value(counters)}:", ()),
                (f"for {counter} in range({self.value(counters)}, {self.value(counters)}{turns}):", (counter,)),
                (f"for {counter} in range({self.value(counters)}):", (counter,)),
            )
        )
        around = (*counters, *own)
        lines = [pad + head]
        for _ in range(self.rng.choice((0, 0, 1, 2))):
            lines.append(f"{pad}  invariant {self.condition(around)}")
        lines += self.block(pad + "  ", depth, around, True)
        if self.rng.random() < 0.6:
            step = f"{self.rng.choice(('+=', '+=', '-='))} {self.rng.choice(('1', '1', '2'))}"
            lines.append(f"{pad}  {self.rng.choice('km')} {step}")
        return lines

    def usual(self, counter: str, depth: int, counters: tuple[str, ...]) -> list[str]:
        """A loop as people write it, with something else in it now and then; behind it its result is used."""
        name, xs = self.rng.choice("km"), self.rng.choice(("xs", "ys"))
        other = "m" if name == "k" else "k"
        claim = self.rng.choice(
            (f"0 <= {name}", f"{name} <= len({xs})", f"{name} >= old({name})", f"{other} == old({other})",
             f"0 <= {name} and {name} <= len({xs})")
        )  # fmt: skip
        use, step = f"  n = {xs}[{name}]", f"  {name} += {self.rng.choice(('1', '1', '2'))}"
        down = self.rng.choice((f"{name} >= 0", f"{name} > 0", f"{name} > -1", f"0 <= {name}"))
        which = self.rng.choice(("1", f"{xs}[{name}]", name))
        leaving = self.rng.choice(("break", "continue", f"{name} += 1", f"{other} = {name}"))
        bound, away = self.rng.choice(("<=", ">=")), self.rng.choice(("+=", "-="))
        loops: tuple[list[str], ...] = (
            [f"while {name} < len({xs}):", *self.odd(depth, counters), use, *self.odd(depth, counters), step],
            [f"while {name} < len({xs}):", f"  if {xs}[{name}] == 1: {leaving}", *self.odd(depth, counters), step],
            [f"while {name} < len({xs}):", use, "  if n > 1:", f"    {name} {away} 2", "    continue", step],
            [f"while {name} != len({xs}):", f"  invariant {claim}", *self.odd(depth, counters), use, step],
            [f"while {down}:", use, *self.odd(depth, counters), f"  {name} -= 1"],
            [f"for {counter} in range({self.rng.choice(('', '0, ', '1, '))}len({xs})):", *self.odd(depth, counters),
             f"  if {xs}[{counter}] > {which}: {name} = {counter}"],
            [f"for {counter} in range(len({xs})):", f"  invariant {name} {bound} {counter} and {name} >= 0",
             f"  if {name} - {counter} < len({xs}): n = {xs}[{name} - {counter}]",
             *self.odd(depth, counters), f"  if n > 1: {name} += 1", f"  {name} = {name}"],
            [f"for {counter} in range(len({xs})):", f"  if {xs}[{counter}] > 1:", f"    {name} = {counter}",
             "    break", *self.odd(depth, counters)],
        )  # fmt: skip
        behind = self.rng.choice(
            (f"n = {xs}[{name}]", f"if {name} < len({xs}): n = {xs}[{name}]", f"if {name} >= 0: n = {xs}[{name}]",
             f"if len({xs}) > 0: n = {xs}[{name}]", f"n = {xs}[{name} - 1]", f"n = 7 // ({name} + 1)",
             f"n = {xs}[{other}]")
        )  # fmt: skip
        return [*self.rng.choice(loops), behind]

    def odd(self, depth: int, counters: tuple[str, ...]) -> list[str]:
        if self.rng.random() < 0.65:
            return []
        return self.block("  ", 0 if self.rng.random() < 0.6 else depth, counters, True)
