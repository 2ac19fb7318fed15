"""The canonical encoding of the IR. `python -m tests.lang.ir.test_encoding` writes the golden digests anew."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any, get_args, get_type_hints

import pytest

import koordgen.lang.ir
from koordgen.build.emit.program import interface_hash, program_hash
from koordgen.build.pipeline import check_file
from koordgen.lang.analyze.program import check
from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.builtins import FUNCTIONS, METHODS, UPDATE_SIGNATURES, Signature
from koordgen.lang.ir.encoding import CONNECTED, HEADER, LAYOUTS, PROVIDING, VERSION, WORDS, encode
from koordgen.lang.ir.types import FLOAT, INT, STRING, MapOf, Sequence, Sized, list_of
from koordgen.lang.node import Node, replace
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax.parse import parse
from tests.agree.faults import rewritten
from tests.agree.formulas import with_formulas
from tests.lang.check.sound import TEXT
from tests.lang.ir.everything import nodes
from tests.programs import programs_alone

ROOT = Path(__file__).parents[3]
DIGESTS = Path(__file__).parent / "digests.txt"
KITCHEN = ROOT / "tests/golden/kitchen/kitchen.koord"
AT = Span(7, 7, 7, 8)
ONE, TWO = expr.Const(1, INT, AT), expr.Const(2, INT, AT)

# The fields that take no part in the encoding, beside every span and the types of expressions.
MARKS: dict[type, set[str]] = {
    expr.SlotRead: {"proved"},
    expr.Binary: {"proved"},
    expr.At: {"proved"},
    expr.Slice: {"proved"},
    decl.Program: {"path"},
}
EXPRESSIONS = set(get_args(expr.Expr))
TYPED = {expr.Make, expr.TempRead}
SCOPES = (decl.Function, decl.ExternFunction, decl.SpecFunction, decl.Event, decl.Property, decl.Assumption)
TEMPORARIES = {
    expr.TempRead: "name", expr.Quantified: "name", stmt.TempPlace: "name", stmt.Let: "name", stmt.For: "names",
    decl.Parameter: "name",
}  # fmt: skip


def compiled(text: str) -> decl.Program:
    source = Source("app.koord", text)
    tree, found = parse(source)
    assert not found, found
    program, diagnostics = check(tree, source)
    assert program is not None, diagnostics
    return program


DRAFT = "koordgen.lang.ir.draft"


def ir_classes() -> set[type[Node]]:
    """Return the node classes of koordgen.lang.ir, but for the builtins' own table and drafts, which no checked program
    contains."""
    names = [m.name for m in pkgutil.iter_modules(koordgen.lang.ir.__path__, "koordgen.lang.ir.") if m.name != DRAFT]
    found = [c for name in names for c in vars(importlib.import_module(name)).values() if isinstance(c, type)]
    return {c for c in found if issubclass(c, Node) and c.__module__ in names} - {Signature}


def unencoded(node: type) -> set[str]:
    """The fields of a node class that take no part."""
    return {"span"} | MARKS.get(node, set()) | ({"type"} if node in EXPRESSIONS - TYPED else set())


@pytest.mark.parametrize("node", sorted(ir_classes() | set(LAYOUTS), key=str))
def test_each_field_of_each_node_is_encoded_or_listed_as_a_mark(node: type[Node]) -> None:
    assert node in LAYOUTS, "give the new node kind a tag"
    encoded = [field.lstrip("~:^=") for field in LAYOUTS[node][1].split()]
    encoded += PROVIDING[1].split() if node is decl.Program else []
    fields = set(node.__match_args__)  # type: ignore[attr-defined]
    assert len(encoded) == len(set(encoded))
    assert set(encoded) == fields - unencoded(node), "encode the new field, or list it as a mark"


def test_tags_and_words_are_one_to_one() -> None:
    tags = [tag for tag, _ in (*LAYOUTS.values(), CONNECTED, PROVIDING)]
    assert len(set(tags)) == len(tags) and min(tags) >= 0x10 and max(tags) <= 0x7F
    assert len(set(WORDS.values())) == len(WORDS)
    directions = get_args(get_type_hints(decl.Port)["direction"])
    assert {*directions} | UPDATE_SIGNATURES.keys() == WORDS.keys()
    assert not WORDS.keys() & ({*FUNCTIONS} | {name for _, name in METHODS})


# Golden


def programs() -> dict[str, decl.Program]:
    files = [*programs_alone(), KITCHEN]
    found = {str(path.relative_to(ROOT)): check_file(str(path)).program for path in files}
    connected = {"EXPORTER": compiled(EXPORTER), "IMPORTER": compiled(IMPORTER), "PROVIDER": compiled(PROVIDER)}
    return {**found, "tests/lang/check/sound.py": compiled(TEXT), **connected}


def digests() -> str:
    """One line a program: its program hash, its interface hash, and the number of bytes of its encoding."""
    lines = [f"{program_hash(p)} {interface_hash(p)} {len(encode(p)):6} {name}\n" for name, p in programs().items()]
    return f"version {VERSION}\n{''.join(lines)}"


def test_digests_of_the_examples() -> None:
    assert DIGESTS.read_text() == digests(), (
        "the canonical encoding changed: raise VERSION if that is meant, then python -m tests.lang.ir.test_encoding"
    )


def test_the_golden_programs_use_every_node() -> None:
    used = {type(node) for program in programs().values() for node in nodes(program)}
    assert set(LAYOUTS) <= used


def test_bytes_of_plain_values() -> None:
    head = HEADER + bytes([0, 0, 0, VERSION])
    assert encode(None, False, True) == head + b"\x00\x01\x02"
    assert encode(0, -1, 128) == head + bytes.fromhex("0300000001 00 0300000001 ff 0300000002 0080")
    assert encode(2**80) == head + bytes.fromhex("03 0000000b 01 00000000000000000000")
    assert encode(1.5, -0.0) == head + bytes.fromhex("04 3ff8000000000000 04 8000000000000000")
    assert encode("é", ()) == head + bytes.fromhex("05 00000002 c3a9 06 00000000")
    assert encode("\ud800") == head + bytes.fromhex("05 00000003 eda080")
    with pytest.raises(TypeError):
        encode({"a": 1})  # type: ignore[arg-type]


def test_bytes_of_nodes() -> None:
    def tail(*items: Node) -> str:
        return encode(*items)[len(HEADER) + 4 :].hex()

    assert tail(ONE) == "20" + "0300000001" + "01"
    assert tail(expr.Unary("-", ONE, INT, AT)) == "2e" + "05000000012d" + tail(ONE)
    held = decl.Meaning(False, "s", ("b",))
    assert tail(held) == "7f" + "01" + "050000000173" + "0600000001" + "050000000162"
    assert tail(decl.Port("p", INT, "sensor", held, AT)) == "77" + "050000000170" + tail(INT) + "0800000001" + tail(
        held
    )
    temp = expr.TempRead("i", INT, AT)
    assert tail(temp, expr.TempRead("k", INT, AT), temp) == "".join(f"26070000000{i}{tail(INT)}" for i in (0, 1, 0))
    assert tail(list_of(INT)) == "12" + "05000000044c697374" + tail(INT) + "030000000140"
    assert tail(expr.Make((), list_of(INT), AT)) == "36" + "12" + "05000000044c697374" + tail(INT) + "00" + "0600000000"


# Programs that mean the same, and programs that do not

BASE = """\
extern fun weigh(int load, int most) -> int
fun twice(int n) -> int:
  int m = n
  return m * 2
param float margin = 0.5
def Task:
  int id
  int size
using Motion:
  sensors: Point position
  actuators: Point target
  PathPlanner planner
  assume planner(goal) == []
allread: int x[N_SYS]
allwrite:
  int a
  int b
  List<int> c max 3
local:
  int k
  List<Task> tasks max 4
init:
  int first = 1
  k = first
Go:
  pre: k < 3 and k > -3
  eff:
    int s = k + 1
    int t = k - 1
    for i in range(3):
      s = s + i
    if s > t: k = s
    else: k = weigh(t, s)
priority:
  Add:
    pre: k < -7
    eff: atomic:
      a = b + 1
      c.append(a)
  Count:
    pre: k > 3
    eff: atomic: x[pid] = x[0] + twice(k)
invariant Low: forall i in ID: exists j in ID: x[i] <= x[j]
invariant High: forall i in ID: k[i] < 9
"""

EXPORTER = """\
export:
  write List<int> done
    guarantee Kept: len(done) <= len(done')
    guarantee Few: len(done) < 9
  int place[N_SYS]
allwrite: List<int> done max 20
allread: int place[N_SYS]
Go:
  pre: place[pid] < 3
  eff: place[pid] = place[pid] + 1
"""
IMPORTER = """\
import Mapping:
  write List<int> done max 20
  int place[Mapping.N_SYS]
  spec fun good(int a) -> bool
Go:
  pre: Mapping.pid >= 0 and place[Mapping.pid] > 3
  eff: atomic: done.append(Mapping.N_SYS)
invariant Good: forall i in Mapping.ID: good(place[i])
"""
PROVIDER = """\
provides Motion:
  sensors:
    Point position = goal
    bool reached = goal == last
  actuators: Point target = goal
allwrite:
  Point goal
  Point last
local: bool gone
Go:
  pre: not gone
  eff: gone = True
"""
CONNECTIONS = {
    "an export": (EXPORTER, "  int place[N_SYS]\n", "", 1),
    "write of an export": (EXPORTER, "write List", "List", 1),
    "a guarantee": (EXPORTER, "    guarantee Few: len(done) < 9\n", "", 1),
    "the name of a guarantee": (EXPORTER, "Few", "Low", 1),
    "the formula of a guarantee": (EXPORTER, "< 9", "< 8", 1),
    "before and after": (EXPORTER, "len(done) <= len(done')", "len(done') <= len(done)", 1),
    "the name of an import": (IMPORTER, "Mapping", "Survey", -1),
    "a provided module": (PROVIDER, "provides Motion", "provides Arm", 1),
    "the name of a provided port": (PROVIDER, "reached", "there", 1),
    "the value of a provided sensor": (PROVIDER, "== last", "!= last", 1),
    "the mark of a provided port": (PROVIDER, "Point target = goal", "Point target clears reached = goal", 1),
    "the variable of a provided actuator": (PROVIDER, "target = goal", "target = last", 1),
    "the direction of a provided port": (PROVIDER, "    bool reached = goal == last\n", "", 1),
    "write of an import": (IMPORTER.replace("atomic: done.append(Mapping.N_SYS)", "pass"), "write ", "", 1),
}

SAME = {
    "a comment": ("  int size", "  int size  # metres"),
    "an empty line": ("using Motion:", "\n\nusing Motion:"),
    "layout": ("    if s > t: k = s", "    if s > t:\n        k   =   s"),
    "parentheses": ("k = weigh(t, s)", "k = (weigh((t), s))"),
    "a variable of init": ("int first = 1\n  k = first", "int start = 1\n  k = start"),
    "a variable of a block": ("    int m = n\n  return m".lstrip(), "int result_of = n\n  return result_of"),
    "a variable of a loop": ("for i in range(3):\n      s = s + i", "for s_2 in range(3):\n      s = s + s_2"),
    "a parameter": ("twice(int n) -> int:\n  int m = n", "twice(int o) -> int:\n  int m = o"),
    "a variable of a quantifier": ("exists j in ID: x[i] <= x[j]", "exists q in ID: x[i] <= x[q]"),
    "what an assumption is for all values of": ("planner(goal)", "planner(place)"),
}
OTHER = {
    "a constant": ("margin = 0.5", "margin = 0.25"),
    "the type of a constant": ("margin = 0.5", "margin = 1"),
    "a sign": ("k > -3", "k > 3"),
    "an operator": ("k + 1", "k * 1"),
    "a comparison": ("k < 3", "k <= 3"),
    "a connective": ("k < 3 and", "k < 3 or"),
    "a quantifier": ("exists j", "forall j"),
    "the order of statements": ("a = b + 1\n      c.append(a)", "c.append(a)\n      a = b + 1"),
    "which variable is read": ("if s > t: k = s", "if s > t: k = t"),
    "which quantified robot is read": ("x[i] <= x[j]", "x[j] <= x[i]"),
    "the order of arguments": ("weigh(t, s)", "weigh(s, t)"),
    "a capacity of a shared variable": ("c max 3", "c max 4"),
    "a capacity of a local variable": ("tasks max 4", "tasks max 5"),
    "a type": ("param float margin = 0.5", "param int margin = 1"),
    "the order of fields": ("  int id\n  int size", "  int size\n  int id"),
    "the kind of a shared variable": ("  List<int> c max 3", "  List<int> c max 3\nallread: int z[N_SYS]"),
    "a lock group": ("a = b + 1", "a = b + x[1]"),
    "a priority": ("priority:\n  Add:\n", "Add2:\n  pre: k > 9\n  eff: stop\npriority:\n  Add:\n"),
    "the name of a param": ("margin", "border"),
    "the name of a field": ("size", "weight"),
    "the name of an event": ("Count:", "Tally:"),
    "the name of an invariant": ("Low", "Small"),
    "the name of an extern function's parameter": ("int load, int most", "int mass, int most"),
    "the name of a shared variable": ("  int b\n", "  int b\n  int d\n"),
    "a loop invariant": ("for i in range(3):\n", "for i in range(3):\n      invariant i >= 0\n"),
}


def changed_text(change: tuple[str, str]) -> decl.Program:
    old, new = change
    assert old in BASE
    program = compiled(BASE.replace(old, new))
    return replace(program, name="app")


@pytest.mark.parametrize("what", SAME)
def test_programs_with_one_meaning_have_one_encoding(what: str) -> None:
    assert encode(changed_text(SAME[what])) == encode(compiled(BASE)), what


def test_programs_with_different_meanings_have_different_encodings() -> None:
    encodings = {what: encode(changed_text(change)) for what, change in OTHER.items()} | {"": encode(compiled(BASE))}
    assert len(set(encodings.values())) == len(encodings)


@pytest.mark.parametrize("what", CONNECTIONS)
def test_exports_and_imports_count(what: str) -> None:
    text, old, new, count = CONNECTIONS[what]
    assert old in text
    assert encode(compiled(text)) != encode(compiled(text.replace(old, new, count)))


def test_the_name_of_the_file_counts_and_its_ending_does_not() -> None:
    program = compiled(BASE)
    assert encode(replace(program, path="app.txt")) == encode(program)
    assert encode(replace(program, name="other")) != encode(program)


def test_the_program_hash_covers_the_functions_file_and_the_version(monkeypatch: pytest.MonkeyPatch) -> None:
    program = compiled(BASE)
    before = program_hash(program), interface_hash(program)
    assert program_hash(program, b"def weigh(): ...") != before[0]
    monkeypatch.setattr("koordgen.lang.ir.encoding.VERSION", VERSION + 1)
    after = program_hash(program), interface_hash(program)
    assert after[0] != before[0] and after[1] != before[1]


def test_the_interface_hash_covers_shared_variables_only() -> None:
    def interface(change: tuple[str, str]) -> str:
        return interface_hash(changed_text(change))

    base = interface_hash(compiled(BASE))
    assert (
        interface(OTHER["a constant"]) == base and interface(("int k\n", "float k\n".replace("float", "int"))) == base
    )
    assert interface(OTHER["a capacity of a shared variable"]) != base
    assert interface(OTHER["the name of a shared variable"]) != base


def _marked(node: Node) -> Node:
    """The node with other marks, another place, and another name for its temporary."""
    fields: dict[str, Any] = {"span": AT} if "span" in type(node).__match_args__ else {}  # type: ignore[attr-defined]
    if hasattr(node, "proved"):
        fields["proved"] = not node.proved
    if type(node) in TEMPORARIES:
        name = TEMPORARIES[type(node)]
        old = getattr(node, name)
        fields[name] = tuple([f"of {one}" for one in old]) if isinstance(old, tuple) else f"of {old}"
    if type(node) in EXPRESSIONS:
        fields["type"] = _wider(node.type) if type(node) in TYPED else STRING  # type: ignore[attr-defined]
    return replace(node, **fields)


def _wider(type_: Any) -> Any:
    match type_:
        case Sized() | Sequence() | MapOf():
            return replace(type_, capacity=type_.capacity + 1)
    return type_


@pytest.mark.parametrize("seed", range(6))
def test_marks_and_names_of_temporaries_take_no_part(seed: int) -> None:
    program = with_formulas(seed)
    named = [replace(f, parameters=()) for f in program.externs]  # the names of their parameters count
    program = replace(program, externs=tuple(named))
    other = replace(rewritten(program, _marked), path="elsewhere")
    assert repr(other) != repr(program) and encode(other) == encode(program)


# Random changes. `meaning` says independently of the encoder which of them change what the program means.


def meaning(part: Any, temps: dict[str, int], exact: bool = True) -> Any:
    """Nested tuples that are equal for programs of one meaning. `exact`: capacities count."""
    if isinstance(part, tuple):
        return tuple([meaning(inner, temps, exact) for inner in part])
    if not isinstance(part, Node):
        return type(part).__name__, repr(part)
    if isinstance(part, SCOPES):
        temps = {}
    found: list[Any] = [type(part).__name__]
    if isinstance(part, decl.ExternFunction):
        found.append([parameter.name for parameter in part.parameters])
    for field in type(part).__match_args__:  # type: ignore[attr-defined]
        value = getattr(part, field)
        if field in unencoded(type(part)) or (field == "capacity" and not exact):
            continue
        if TEMPORARIES.get(type(part)) == field:
            names = value if isinstance(value, tuple) else (value,)
            found.append([temps.setdefault(name, len(temps)) for name in names])
        else:
            derived = field in ("type", "types") and isinstance(part, (*TYPED, stmt.Let, stmt.For))
            found.append(meaning(value, temps, exact and not derived))
    return tuple(found)


Way = tuple[str | int, ...]


def places(part: Any, path: Way = ()) -> Iterator[tuple[Way, Any]]:
    """Every field and item of a tree, with the way to it."""
    yield path, part
    if isinstance(part, tuple):
        for index, inner in enumerate(part):
            yield from places(inner, (*path, index))
    elif isinstance(part, Node) and not isinstance(part, Span):
        for field in type(part).__match_args__:  # type: ignore[attr-defined]
            yield from places(getattr(part, field), (*path, field))


def put(part: Any, path: Way, value: Any) -> Any:
    if not path:
        return value
    first, *rest = path
    if isinstance(first, int):
        return (*part[:first], put(part[first], tuple(rest), value), *part[first + 1 :])
    return replace(part, **{first: put(getattr(part, first), tuple(rest), value)})


def mutant(value: Any, rng: Random) -> Any:
    """Another value in the place of this one, not always a sensible one."""
    match value:
        case bool():
            return not value
        case int() | float():
            return rng.choice((value + 1, -value - 1, float(value), str(value)))
        case str():
            return rng.choice((value + "_", value[1:], "+", "x"))
        case None:
            return rng.choice((0, ONE))
        case tuple():
            return rng.choice(
                (value[1:], value[:-1], value + value[-1:], value[::-1], value[1:2] + value[:1] + value[2:])
            )
        case _:  # an expression
            return rng.choice((ONE, TWO, expr.Unary("-", value, INT, AT), expr.Widen(value, FLOAT, AT)))


@pytest.mark.parametrize("seed", [pytest.param(n, marks=pytest.mark.slow) if n >= 3 else n for n in range(6)])
def test_random_changes_change_the_encoding_if_they_change_the_meaning(seed: int) -> None:
    rng = Random(seed)
    program = with_formulas(seed)
    found = {encode(program): meaning(program, {})}
    changeable = [place for place in places(program) if type(place[1]) in EXPRESSIONS or not isinstance(place[1], Node)]
    for path, value in rng.sample(changeable, 20):
        other = put(program, path, mutant(value, rng))
        meant = meaning(other, {})
        known = found.setdefault(encode(other), meant)
        assert known == meant, path
    assert len(set(map(repr, found.values()))) == len(found) > 6


if __name__ == "__main__":
    DIGESTS.write_text(digests())
