"""Small random programs of one sensor, with few states, and with invariants."""

from __future__ import annotations

from random import Random

LEVELS = (0, 1, 2)  # of the sensor
ASSUMED = ("0 <= level' and level' <= 2", "level' >= level", "level' == level or level' == 0", "level' <= level + 1")


def program(seed: int) -> str:
    """The text of a program whose names, events and invariants depend on the seed alone."""
    return _Writer(Random(seed)).program()


class _Writer:
    def __init__(self, random: Random) -> None:
        self.random = random

    def pick(self, *options: str) -> str:
        return self.random.choice(options)

    def number(self, depth: int = 0) -> str:
        if depth < 2 and self.random.random() < 0.35:
            a, b = self.number(depth + 1), self.number(depth + 1)
            made = self.pick(f"({a} + {b})", f"({a} - {b})", f"min({a}, {b})", f"max({a}, {b})", f"max({a}, {b})", "if")
            return f"({a} if {self.truth(depth + 1)} else {b})" if made == "if" else made
        return self.pick("0", "1", "2", "a", "a", "x[pid]", "x[pid]", "s", "Dev.level", "pid", "x[0]", "x[N_SYS - 1]")

    def truth(self, depth: int = 0) -> str:
        if depth < 2 and self.random.random() < 0.3:
            a, b = self.truth(depth + 1), self.truth(depth + 1)
            return self.pick(f"({a} and {b})", f"({a} or {b})", f"not {a}")
        compared = f"{self.number(depth + 1)} {self.pick('==', '<', '<=', '!=')} {self.number(depth + 1)}"
        return self.pick(f"({compared})", "b", "f[pid]", "(Dev.level == 1)", "(free < 0)", "(free == pid)")

    def statement(self, depth: int, indent: str) -> list[str]:
        roll = self.random.random()
        if roll < 0.25 and depth < 2:
            lines = [f"{indent}if {self.truth()}:", *self.block(depth + 1, indent + "  ")]
            return lines + ([f"{indent}else:", *self.block(depth + 1, indent + "  ")] if roll < 0.12 else [])
        if roll < 0.35 and depth < 2:
            body = [f"{indent}  if x[k] {self.pick('>', '==', '<')} {self.pick('0', '1', 'a')}:"]
            body += [*self.block(2, indent + "    "), f"{indent}    break"]
            return [f"{indent}for k in {self.pick('ID', 'range(N_SYS)', 'range(1, N_SYS)')}:", *body]
        if roll < 0.4 and depth < 2:
            return [
                f"{indent}for k in range({self.pick('2', '3', 'N_SYS')}):",
                indent + "  " + self.pick("a = max(a, k)", "a += 1", "s = min(s, x[0])"),
            ]
        if roll < 0.7:
            return [f"{indent}{self.pick('a', 'x[pid]', 's', 'free')} = {self.number()}"]
        if roll < 0.75:
            return [f"{indent}{self.pick('free = pid', 'free = -1', 's += 1', 'x[pid] = max(x[pid], s)')}"]
        return [f"{indent}{self.pick('b', 'f[pid]')} = {self.truth()}"]

    def block(self, depth: int, indent: str) -> list[str]:
        lines = []
        for _ in range(self.random.choice((1, 1, 2))):
            lines += self.statement(depth, indent)
        return lines

    def event(self, name: str) -> list[str]:
        head = "  eff: atomic:" if self.random.random() < 0.5 else "  eff:"
        body = self.block(0, "    ") + (["    stop"] if self.random.random() < 0.1 else [])
        return [f"{name}:", f"  pre: {self.truth()}", head, *body]

    def invariant(self, name: str) -> str:
        low, high = self.pick("0", "-1", "-2", "-3"), self.pick("0", "1", "2", "3", "N_SYS", "pid")
        high = "N_SYS" if high == "pid" else high
        return f"invariant {name}: " + self.pick(
            f"forall i in ID: x[i] >= {low}",
            f"forall i in ID: x[i] <= {high}",
            f"forall i in ID: a[i] >= {low}",
            f"s >= {low}",
            f"s <= {high}",
            "forall i, j in ID: i == j or not (b[i] and b[j])",
            "forall i, j in ID: i == j or not (f[i] and f[j] and b[i])",
            f"forall i in ID: not b[i] or x[i] >= {low}",
            f"forall i in ID: not f[i] or a[i] <= {high}",
            "forall i in ID: not b[i] or free == i",
            "-1 <= free and free < N_SYS",
            "forall i, j in ID: i == j or x[i] + x[j] <= 4",
            f"exists i in ID: x[i] <= {high}",
            f"forall i in ID: (exists j in ID: x[j] >= x[i]) and Dev.level[i] >= {low}",
            f"{low} in x or s == 0",
        )  # fmt: skip

    def program(self) -> str:
        assumed = self.pick(*ASSUMED)
        lines = ["using Dev:", "  sensors: int level", f"  assume {assumed}"]
        lines += ["allread:", "  int x[N_SYS]", "  bool f[N_SYS]", "allwrite:", "  int s", "  int free = -1"]
        lines += ["local:", "  int a", "  bool b"]
        if self.random.random() < 0.6:
            lines += ["init:", *[f"  {self.pick('a', 'x[pid]')} = {self.pick('pid', 'Dev.level', '1', 'a')}"]]
        for name in ("First", "Second"):
            lines += self.event(name)
        lines.append("initially: forall i in ID: 0 <= Dev.level[i] and Dev.level[i] <= 2")
        lines += [self.invariant(f"I{number}") for number in range(3)]
        return "\n".join(lines) + "\n"
