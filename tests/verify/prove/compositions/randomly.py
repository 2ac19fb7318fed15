"""Random compositions with guarantees and invariants, some of which hold."""

from __future__ import annotations

from random import Random

from koordgen.lang.semantics.composition import Application, System
from tests.lang.semantics.compositions import NAMES, compiled

STATE = ("{v} >= 0", "{v} <= 6", "{v} >= 0 and {v} <= 9", "{v} != 5", "{v} < limit")
STEP = (
    "{v} <= {v}'",
    "{v}' <= {v}",
    "{v} <= {v}' or {v}' == 0",
    "{v}' <= {v} + 2",
    "{v} == {v}'",
    "{v} < 3 or {v}' > 2",
)
SLOTS = ("forall i in ID: {v}[i] >= 0", "forall i in ID: {v}[i] <= {v}'[i]", "forall i in ID: {v}[i] <= N_SYS + 6")


def random_composition(seed: int) -> System:
    """Return two or three applications of at most three robots, of which later ones import from earlier ones."""
    rng = Random(seed)
    names, robots = NAMES[: rng.randrange(2, 4)], 3
    applications = []
    for index, name in enumerate(names):
        exporters = [other for other in names[:index] if index == 1 or rng.random() < 0.7]
        members = sorted(rng.sample(range(robots), rng.randrange(1, robots + 1)))
        bindings = tuple([(exporter.title(), exporter) for exporter in exporters])
        applications.append(Application(name, compiled(name, _text(rng, name, exporters)), tuple(members), bindings))
    return System(tuple(applications), robots)


def _text(rng: Random, name: str, exporters: list[str]) -> str:
    a, b, x = f"{name}_a", f"{name}_b", f"{name}_x"
    lines = ["export:"]
    for number, (variable, declared, templates) in enumerate(
        ((a, f"write int {a}", (*STATE, *STEP)), (b, f"int {b}", (*STATE, *STEP)), (x, f"int {x}[N_SYS]", SLOTS))
    ):
        lines.append(f"  {declared}")
        chosen = rng.sample(templates, rng.randrange(3))
        lines += [f"    guarantee G{number}{i}: {formula.format(v=variable)}" for i, formula in enumerate(chosen)]
    lines.append(f"param int limit = 7\ninitially: limit > 6\nallwrite:\n  int {a}\n  int {b}\nallread: int {x}[N_SYS]")
    lines.append("local:\n  int k\n  int seen")
    cells, written, lists = [a, b], [a, b], list[str]()
    for exporter in exporters:
        title = exporter.title()
        lines.append(
            f"import {title}:\n  write int {exporter}_a\n  int {exporter}_b\n  int {exporter}_x[{title}.N_SYS]"
        )
        cells += [f"{exporter}_a", f"{exporter}_b"]
        written.append(f"{exporter}_a")
        lists.append(exporter)
    if rng.random() < 0.3:
        lines.append(f"init:\n  k = pid\n  {rng.choice(written)} = {rng.randrange(9)}")
    lines += [_event(rng, f"E{n}", x, cells, written, lists) for n in range(rng.randrange(2, 5))]
    lines += [f"invariant I{n}: {_invariant(rng, x, cells, lists)}" for n in range(3)]
    return "\n".join(lines) + "\n"


def _event(rng: Random, name: str, x: str, cells: list[str], written: list[str], lists: list[str]) -> str:
    values = ["k", "seen", "pid", str(rng.randrange(5)), *cells, f"{x}[pid]"]
    values += [f"{each.title()}.N_SYS" for each in lists] + [f"{each.title()}.pid" for each in lists]
    guard = f"{rng.choice(values)} {rng.choice(('<', '<=', '!=', '>'))} {rng.choice(values)} + {rng.randrange(4)}"
    if lists and rng.random() < 0.3:
        other = rng.choice(lists)
        guard = f"{other.title()}.pid >= 0 and {other}_x[{other.title()}.pid] < {rng.randrange(6)}"
    body = [_effect(rng, rng.choice([*written, "k", "seen", f"{x}[pid]"]), values) for _ in range(2)]
    atomic = rng.random() < 0.5
    indent = " " * (6 if atomic else 4)
    head = "  eff:\n    atomic:\n" if atomic else "  eff:\n"
    return f"{name}:\n  pre: {guard}\n{head}" + "\n".join(indent + line for line in body)


def _effect(rng: Random, target: str, values: list[str]) -> str:
    value = rng.choice(values)
    effect = rng.choice((
        f"{target} = ({value} + {rng.choice(values)}) % 7",
        f"{target} = max({target}, {value})",
        f"{target} = {value}",
        f"{target} = min(6, {target} + 1)",
    ))  # fmt: skip
    return f"if {rng.choice(values)} > {rng.randrange(3)}: {effect}" if rng.random() < 0.25 else effect


def _invariant(rng: Random, x: str, cells: list[str], lists: list[str]) -> str:
    cell, number = rng.choice(cells), rng.randrange(8)
    formulas = [f"{cell} >= 0", f"{cell} <= {number}", f"forall i in ID: k[i] <= {cell} or k[i] < {number}"]
    formulas += [f"forall i in ID: seen[i] <= {cell}", f"forall i in ID: {x}[i] <= {number} or k[i] >= 0"]
    for other in lists:
        formulas += [
            f"forall i in {other.title()}.ID: {other}_x[i] >= 0",
            f"forall i in ID: {other.title()}.pid[i] < 0 or {other}_x[{other.title()}.pid[i]] >= {number - 6}",
            f"forall i in ID: {other}_a <= {other.title()}.N_SYS + 6 or seen[i] == 0",
        ]
    return rng.choice(formulas)
