"""IR -> Koord text with the same meaning, so that parser and checker take part in the comparison.

Initial values are left to the types' defaults if they do not matter. Values that no expression writes (an updated list
within an expression, an empty map as an argument) come from functions that the text declares for them.
"""

from __future__ import annotations

from collections.abc import Iterator

from koordgen.lang.ir import decl as d
from koordgen.lang.ir import expr as e
from koordgen.lang.ir import stmt as s
from koordgen.lang.ir.builtins import METHODS, UPDATES
from koordgen.lang.ir.printer import capacities
from koordgen.lang.ir.types import ExternType, MapOf, PerRobot, RecordType, Scalar, Sequence, Sized, TupleOf, Type

_METHODS = {name for _, name in METHODS}
_STATEMENTS = {
    "appended": "append", "extended": "extend", "inserted": "insert", "removed": "remove", "cleared": "clear",
    "set_with": "add", "set_without": "remove", "map_without": "remove", "popped": "pop",
}  # fmt: skip
assert {*_STATEMENTS} - {"popped"} == {*UPDATES.values()}


WIDENED = "(int x) -> float:\n  return x"


class Unwritable(Exception):
    """Raised for a value without a literal, at a place where only a literal is possible."""


def source(program: d.Program) -> str:
    """Return the program's text. Raises Unwritable."""
    return _Source().program(program)


class _Source:
    def __init__(self) -> None:
        self.helpers: dict[str, str] = {}  # a function's text without its name -> its name

    def program(self, p: d.Program) -> str:
        lines = [f"extern type {t.name}" for t in p.extern_types]
        for record in p.records:
            lines += [f"def {record.type.name}:", *[f"  {_declared(t, n)}" for n, t in record.type.fields]]
        lines += [f"param {_declared(v.type, v.name)} = {_plain(v.type)}" for v in p.params]
        for module in p.modules:
            lines += [f"using {module.name}:", *self.ports(module)]
        for v in p.shared:
            size = "[N_SYS]" if v.kind == "allread" else ""
            lines += [f"{v.kind}:", f"  {_declared(v.type, v.name + size)}"]
        lines += ["local:", *[f"  {_declared(v.type, v.name)}" for v in p.locals]]
        for f in p.externs:
            lines.append(f"extern fun {self.signature(f)}" + (":" if f.requires or f.ensures else ""))
            lines += [f"  requires: {self.text(formula)}" for formula in f.requires]
            lines += [f"  ensures: {self.text(formula)}" for formula in f.ensures]
        for function in p.functions:
            lines += [f"fun {self.signature(function)}:", *self.block(function.block, "  ")]
        if p.init:
            lines += ["init:", *self.block(p.init, "  ")]
        for event in p.events:
            lines += [f"{event.name}:", f"  pre: {self.text(event.guard)}", "  eff:"]
            if event.lock is None:
                lines += self.block(event.effect, "    ")
            else:
                lines += ["    atomic:", *self.block(event.effect, "      ")]
        lines += [f"fun {name}{text}" for text, name in self.helpers.items()]
        return "\n".join(lines) + "\n"

    def ports(self, module: d.Module) -> Iterator[str]:
        for port in module.ports:
            match port.direction:
                case "sensor" | "actuator":
                    yield f"  {port.direction}s: {port.type} {port.name}"
                case "callable":
                    yield f"  PathPlanner {port.name}"
                case "stream":
                    yield f"  stream {port.name}"

    def signature(self, f: d.Function | d.ExternFunction) -> str:
        return f"{f.name}({', '.join([_parameter(p.type, p.name) for p in f.parameters])}) -> {f.result}"

    def helper(self, text: str) -> str:
        """Return the name of a function of this text with these parameters, result and block."""
        return self.helpers.setdefault(text, f"made{len(self.helpers)}")

    # Statements

    def block(self, block: s.Block, indent: str) -> Iterator[str]:
        if not block:
            yield f"{indent}pass"
        for statement in block:
            match statement:
                case s.If(condition, then, orelse):
                    yield f"{indent}if {self.text(condition)}:"
                    yield from self.block(then, indent + "  ")
                    if orelse:
                        yield f"{indent}else:"
                        yield from self.block(orelse, indent + "  ")
                case s.For(names, _, values, inner):
                    yield f"{indent}for {', '.join(names)} in {self.domain(values)}:"
                    yield from self.invariants(statement, indent + "  ")
                    yield from self.block(inner, indent + "  ")
                case s.While(condition, inner):
                    yield f"{indent}while {self.text(condition)}:"
                    yield from self.invariants(statement, indent + "  ")
                    yield from self.block(inner, indent + "  ")
                case _:
                    yield indent + self.simple(statement)

    def invariants(self, loop: s.For | s.While, indent: str) -> Iterator[str]:
        for invariant in loop.invariants:
            yield f"{indent}invariant {self.text(invariant.formula)}"

    def domain(self, values: e.Expr) -> str:
        if isinstance(values, e.Range):
            return f"range({self.text(values.start)}, {self.text(values.stop)}, {values.step})"
        return self.text(values)

    def simple(self, statement: s.Stmt) -> str:
        match statement:
            case s.Assign(place, e.Builtin(name, (read, *rest)) as value) if name in _STATEMENTS and _reads(
                read, place
            ):
                if name == "appended" and str(value.type).startswith("Queue"):
                    return f"{_place(place)}.push({self.args(rest)})"
                return f"{_place(place)}.{_STATEMENTS[name]}({self.args(rest)})"
            case s.Assign(place, e.Builtin("updated" | "map_with", (read, i, v))) if _reads(read, place):
                return f"{_place(place)}[{self.text(i)}] = {self.text(v)}"
            case s.Assign(place, e.With(read, name, v)) if _reads(read, place):
                return f"{_place(place)}{_part(name)} = {self.text(v)}"
            case s.Assign(place, value):
                return f"{_place(place)} = {self.text(value)}"
            case s.Let(name, type_, value):
                return f"{type_} {name} = {self.text(value)}"
            case s.Return(value):
                return f"return {self.text(value)}"
            case s.Emit(module, port, items):
                return f"{module}.{port} << {' << '.join([self.text(item) for item in items])}"
            case _:
                return type(statement).__name__.lower()

    # Expressions: each operator in its own brackets

    def args(self, nodes: list[e.Expr] | tuple[e.Expr, ...]) -> str:
        return ", ".join([self.text(node) for node in nodes])

    def text(self, node: e.Expr) -> str:
        match node:
            case e.Const(str() as value):
                return (
                    '"'
                    + value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\t", "\\t")
                    + '"'
                )
            case e.Const(value) if value == -(2**63):  # no literal says it
                return f"(-{2**63 - 1} - 1)"
            case e.Const(value):
                return f"({value!r})" if repr(value)[0] == "-" else repr(value)
            case e.Pid():
                return "pid"
            case e.NSys():
                return "N_SYS"
            case e.Ids():
                return "ID"
            case e.SlotRead(name, index):
                return f"{name}[{self.text(index)}]"
            case e.ParamRead(name) | e.LocalRead(name) | e.TempRead(name) | e.SlotsRead(name) | e.SharedRead(name):
                return name
            case e.PortRead(module, port):
                return f"{module}.{port}"
            case e.Widen(operand):
                return f"{self.helper(WIDENED)}({self.text(operand)})"
            case e.Unary(op, operand):
                return f"({op} {self.text(operand)})"
            case e.Binary(op, left, right) | e.Compare(op, left, right) | e.Logic(op, left, right):
                return f"({self.text(left)} {op} {self.text(right)})"
            case e.Contains(item, values):
                return f"({self.text(item)} in {self.text(values)})"
            case e.Conditional(condition, then, orelse):
                return f"({self.text(then)} if {self.text(condition)} else {self.text(orelse)})"
            case e.Quantified(kind, name, domain, body):
                return f"({kind} {name} in {self.domain(domain)}: {self.text(body)})"
            case _:
                return self.part(node)

    def part(self, node: e.Expr) -> str:
        match node:
            case e.Make(items, type_):
                return self.make(items, type_)
            case e.Field(operand, name):
                return f"{self.text(operand)}.{name}"
            case e.Item(operand, index):
                return f"{self.text(operand)}[{index}]"
            case e.At(operand, index):
                return f"{self.text(operand)}[{self.text(index)}]"
            case e.Slice(operand, start, stop):
                ends = ["" if end is None else self.text(end) for end in (start, stop)]
                return f"{self.text(operand)}[{ends[0]}:{ends[1]}]"
            case e.With(operand, name, value):
                made = f"({operand.type} x, {value.type} v) -> {operand.type}:\n  x{_part(name)} = v\n  return x"
                return f"{self.helper(made)}({self.text(operand)}, {self.text(value)})"
            case e.Builtin(name, args):
                return self.builtin(name, args, node.type)
            case e.Call(name, args) | e.ExternCall(name, args):
                return f"{name}({self.args(args)})"
            case e.PortCall(module, port, args):
                return f"{module}.{port}({self.args(args)})"
            case _:
                raise AssertionError(node)

    def make(self, items: tuple[e.Expr, ...], type_: Type) -> str:
        match type_:
            case RecordType(name):
                return f"{name}({self.args(items)})"
            case TupleOf():
                return f"({self.args(items)})"
            case Sequence("Queue", element) if items:
                filled = f"(List<{element}> xs) -> {type_}:\n  {type_} q\n  for x in xs: q.push(x)\n  return q"
                return f"{self.helper(filled)}([{self.args(items)}])"
            case Sequence(name) if items:
                return f"[{self.args(items)}]" if name == "List" else f"{{{self.args(items)}}}"
            case MapOf() if items and all(isinstance(item, e.Make) for item in items):
                pairs = [f"{self.text(i.items[0])}: {self.text(i.items[1])}" for i in items if isinstance(i, e.Make)]
                return f"{{{', '.join(pairs)}}}"
            case _:
                empty = f"() -> {type_}:\n  {type_} x\n  return x"
                return f"{self.helper(empty)}()"

    def builtin(self, name: str, args: tuple[e.Expr, ...], type_: Type) -> str:
        first = args[0].type
        if name == "map_at":
            return f"{self.text(args[0])}[{self.text(args[1])}]"
        if name in ("updated", "map_with"):
            made = f"({type_} x, {args[1].type} k, {args[2].type} v) -> {type_}:\n  x[k] = v\n  return x"
            return f"{self.helper(made)}({self.args(args)})"
        if name in _STATEMENTS or name == "without":
            given = ", ".join([f"{arg.type} {word}" for arg, word in zip(args, ("x", "a", "b"), strict=False)])
            given = given.replace("[N_SYS] a", " a[N_SYS]")
            used = ", ".join(("a", "b")[: len(args) - 1])
            changed = f"x.{_STATEMENTS.get(name, 'pop')}({used})"
            if isinstance(first, Sequence) and first.name == "Queue" and name in ("appended", "without"):
                changed = "x.push(a)" if name == "appended" else "x.pop()"
            made = f"({given}) -> {type_}:\n  {changed}\n  return x"
            return f"{self.helper(made)}({self.args(args)})"
        if name in _METHODS:
            return f"{self.text(args[0])}.{name}({self.args(args[1:])})"
        return f"{name}({self.args(args)})"


def _reads(node: e.Expr, place: s.Place) -> bool:
    """Return whether an expression is the value of a place."""
    match node, place:
        case (e.LocalRead(name), s.LocalPlace(own)) | (e.TempRead(name), s.TempPlace(own)):
            return name == own
        case e.SharedRead(name), s.SharedPlace(own):
            return name == own
        case e.SlotRead(name, e.Pid()), s.OwnSlot(own):
            return name == own
        case e.PortRead(module, port), s.PortPlace(module_, port_):
            return (module, port) == (module_, port_)
        case _:
            return False


def _place(place: s.Place) -> str:
    match place:
        case s.OwnSlot(name):
            return f"{name}[pid]"
        case s.PortPlace(module, port):
            return f"{module}.{port}"
        case s.LocalPlace(name) | s.SharedPlace(name) | s.TempPlace(name):
            return name


def _part(name: str) -> str:
    return f"[{name}]" if name.isdigit() else f".{name}"


def _declared(type_: Type, name: str) -> str:
    most = list(capacities(type_))
    return f"{type_} {name}" + (f" max {', '.join(map(str, most))}" if most else "")


def _parameter(type_: Type, name: str) -> str:
    return f"{type_.element} {name}[N_SYS]" if isinstance(type_, PerRobot) else f"{type_} {name}"


def _plain(type_: Type) -> str:
    """Return some value of a type; the initial state replaces it."""
    match type_:
        case Sequence("Set") | MapOf():
            return "{}"
        case Sequence():
            return "[]"
        case TupleOf(items):
            return f"({', '.join(map(_plain, items))})"
        case RecordType(name):
            return f"{name}()"
        case Scalar() | Sized("string" | "GridMap"):
            return {
                "int": "0", "float": "0.0", "bool": "False", "string": '""', "Point": "Point(0, 0, 0)",
                "Pose": "Pose(Point(0, 0, 0), 0)", "Grid": "Grid(0, 0, 1)",
                "GridMap": "GridMap(Point(0, 0, 0), Point(1, 1, 0), 1)",
            }[type_.name]  # fmt: skip
        case _:
            assert isinstance(type_, (Sized, ExternType))
            raise Unwritable(str(type_))
