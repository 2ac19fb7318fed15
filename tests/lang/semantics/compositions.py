"""Random compositions: two or three small applications with exports, imports and writes, on up to four robots."""

from __future__ import annotations

from random import Random

from koordgen.lang.analyze.program import check
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.verify import verify
from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse

NAMES = ("first", "second", "third")


def compiled(name: str, text: str) -> Program:
    """Return a program, which must have no errors."""
    source = Source(f"{name}.koord", text)
    tree, found = parse(source)
    assert not found, (text, found)
    program, diagnostics = check(tree, source)
    assert program is not None, (text, [d.message for d in diagnostics])
    verify(program)
    return program


def random_system(seed: int, robots: int = 3) -> System:
    """Return a composition of two or three random applications, of which later ones import from earlier ones."""
    rng = Random(seed)
    names = NAMES[: rng.randrange(2, 4)]
    applications = []
    for index, name in enumerate(names):
        exporters = [other for other in names[:index] if rng.random() < 0.8]
        members = sorted(rng.sample(range(robots), rng.randrange(1, robots + 1)))
        program = compiled(name, text(rng, name, exporters))
        bindings = tuple([(exporter.title(), exporter) for exporter in exporters])
        applications.append(Application(name, program, tuple(members), bindings))
    return System(tuple(applications), robots)


def text(rng: Random, name: str, exporters: list[str]) -> str:
    """Return a program that exports two allwrite variables and an allread one, and imports those of `exporters`."""
    a, b, x = f"{name}_a", f"{name}_b", f"{name}_x"
    lines = [f"export:\n  write int {a}\n  int {b}\n  int {x}[N_SYS]"]
    lines.append(f"allwrite:\n  int {a}\n  int {b}\nallread: int {x}[N_SYS]")
    lines.append("local:\n  int k\n  int seen")
    cells, written, lists = [a, b], [a, b], list[str]()
    for exporter in exporters:
        lines.append(
            f"import {exporter.title()}:\n  write int {exporter}_a\n  int {exporter}_b\n"
            f"  int {exporter}_x[{exporter.title()}.N_SYS]"
        )
        cells += [f"{exporter}_a", f"{exporter}_b"]
        written.append(f"{exporter}_a")
        lists.append(f"{exporter}_x")
    if rng.random() < 0.5:
        lines.append(f"init:\n  k = pid\n  {rng.choice(written)} = {rng.randrange(9)}")
    for number in range(rng.randrange(2, 5)):
        lines.append(event(rng, f"E{number}", x, cells, written, lists, [e.title() for e in exporters]))
    return "\n".join(lines) + "\n"


def event(
    rng: Random, name: str, x: str, cells: list[str], written: list[str], lists: list[str], imports: list[str]
) -> str:
    """Return a random event, plain or atomic."""
    values = ["k", "seen", "pid", str(rng.randrange(5)), *cells, f"{x}[pid]"]
    values += [f"sum({each})" for each in lists] + [f"{each}.N_SYS" for each in imports]
    values += [f"{each}.pid" for each in imports]
    guard = f"{rng.choice(values)} {rng.choice(('<', '<=', '!=', '>'))} {rng.choice(values)} + {rng.randrange(4)}"
    targets = [*written, "k", "seen", f"{x}[pid]"]
    effects = [f"{rng.choice(targets)} = ({rng.choice(values)} + {rng.choice(values)}) % 7" for _ in range(2)]
    if rng.random() < 0.1:
        effects.append("stop")
    if lists and rng.random() < 0.2:
        effects.append(f"seen = {rng.choice(lists)}[{rng.choice(('k', 'seen'))}]")  # may be discarded
    atomic = rng.random() < 0.5
    head, indent = ("  eff:\n    atomic:\n", 6) if atomic else ("  eff:\n", 4)
    body = "\n".join(" " * indent + effect for effect in effects)
    return f"{name}:\n  pre: {guard}\n{head}{body}"
