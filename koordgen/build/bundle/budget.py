"""Whether what robots share can be sent, by one and by all of them: decided at build time, with the arithmetic in the
message."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from math import ceil, floor, log10
from typing import TYPE_CHECKING, assert_never

from koordgen.build.emit.types import EXTERN_BYTES, FIXED, NUMBER
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir import expr, stmt
from koordgen.lang.ir.decl import Program, Shared
from koordgen.lang.ir.tree import statements
from koordgen.lang.ir.types import ExternType, MapOf, PerRobot, RecordType, Scalar, Sequence, Sized, TupleOf, Type
from koordgen.lang.node import Node, replace

if TYPE_CHECKING:
    from koordgen.fleet.medium import Link

# As koordgen/runtime/net/layout.py, bounds.py and wire.py have them (tests compare): MessagePack's longest forms.
DATAGRAM = 1200
MOST_ENTRY, MOST_FRAGMENTS, MOST_SHARED = 128 * 1024, 256, 256
_WRITE, _ENTRY = 5, 38
LONGEST_DELTA = 60.0  # seconds, as in koordgen/fleet/file.py
_UDP, _IP, _FRAME = 8, 20, 38  # bytes of a datagram; of each packet that it takes; on Ethernet, gap included, likewise


def check_budget(program: Program, robots: int) -> list[Diagnostic]:
    """Errors, each at the shared variable that takes most, if a fleet of that size cannot send what they hold: in one
    round, to a robot that comes back, or after `init`."""
    if len(program.shared) > MOST_SHARED:
        message = f"a program of {len(program.shared)} shared variables; at most {MOST_SHARED} are supported"
        return [Diagnostic("B004", "error", message, program.shared[-1].span, help="gather some of them in records")]
    return [*(_check_entry(program, robots) or _check_store(program, robots)), *_check_init(program, robots)]


def _check_entry(program: Program, robots: int) -> list[Diagnostic]:
    room, total = most_entry(robots), _entry(program.shared)
    if total <= room:
        return []
    largest = max(program.shared, key=lambda v: most_bytes(v.type))
    message = (
        f"one round's shared writes take up to {total} bytes; with {robots} robots at most {room} can be sent; "
        f"{largest.name} alone takes up to {most_bytes(largest.type)}"
    )
    return [Diagnostic("B004", "error", message, largest.span, help=_less(program, largest, robots))]


def _check_store(program: Program, robots: int) -> list[Diagnostic]:
    room, total = most_store(robots), store_bytes(program.shared, robots)
    if total <= room:
        return []
    largest = max(program.shared, key=lambda v: _kept(v, robots))
    slots = f", {robots} slots of {most_bytes(largest.type)}" if largest.kind == "allread" else ""
    message = (
        f"all shared variables together take up to {total} bytes; with {robots} robots at most {room} can be handed to "
        f"a robot that comes back; {largest.name} alone takes up to {_kept(largest, robots)}{slots}"
    )
    return [Diagnostic("B004", "error", message, largest.span, help=_less(program, largest, robots))]


def _less(program: Program, largest: Shared, robots: int) -> str:
    """What makes everything fit."""

    def fits(variable: Shared) -> bool:
        shared = _with(program.shared, variable)
        return _entry(shared) <= most_entry(robots) and store_bytes(shared, robots) <= most_store(robots)

    found = _capacity(largest, fits)
    less = "share fewer or smaller variables, or declare smaller capacities with `max`"
    return f"it fits with {found}" if found else less


def _check_init(program: Program, robots: int) -> list[Diagnostic]:
    room, total = most_init(robots), _init_bytes(program, program.shared)
    if total <= room or robots < 2:
        return []
    written = [(v, _most_in(program.init, v)) for v in program.shared]
    largest = max(written, key=lambda pair: pair[1])[0]
    each = " + ".join(f"{most} for {v.name}" for v, most in written if most)
    message = (
        f"what `init` writes to shared variables must fit in one datagram; it takes up to {total} bytes: {_ENTRY} + "
        f"{each}; with {robots} robots there is room for {room}"
    )
    found = _capacity(largest, lambda v: _init_bytes(program, _with(program.shared, v)) <= room)
    ways = [f"it fits with {found}"] if found else []
    help = ", or ".join([*ways, "give the variable its first value where it is declared, or write it in an event"])
    return [Diagnostic("B004", "error", message, largest.span, help=help)]


def most_entry(robots: int) -> int:
    """The most bytes that an entry may have in a fleet of that size."""
    return min(MOST_ENTRY, most_store(robots))


def most_store(robots: int) -> int:
    """The most bytes that all shared variables may take in a fleet of that size: a robot that comes back gets them in
    fragments."""
    return MOST_FRAGMENTS * (DATAGRAM - overhead(robots))


def store_bytes(shared: tuple[Shared, ...], robots: int) -> int:
    """The most bytes of these variables, every slot of them, with what else a robot is told that comes back."""
    members = _head(robots, 16, 0) + NUMBER * robots
    acted = _head(robots, 16, 0) + 5 * robots
    beside = 1 + (1 + 2 * NUMBER + members) + NUMBER + _head(len(shared), 16, 0) + members + acted
    return beside + sum(_kept(v, robots) for v in shared)


def most_init(robots: int) -> int:
    """The most bytes of the entry that tells what `init` wrote: it goes in one datagram, a Hello."""
    return DATAGRAM - (146 + 20 * min(robots, 8) + _head(robots, 16, 0) + robots)


class Traffic(Node):
    """What a fleet puts on its medium in one round at most. `writes` are the bytes of the longest entry, `datagrams`
    those in which it goes to one receiver; `word` and `acknowledgement` the bytes of these and of the datagram that
    says when it has been applied, headers of packets included."""

    robots: int
    receivers: int  # of each robot's datagrams: 1 where one datagram reaches all
    writes: int
    datagrams: int
    word: int
    acknowledgement: int
    loss: float

    @property
    def bytes(self) -> int:
        """With what is repeated."""
        once = self.robots * self.receivers * (self.word + self.acknowledgement)
        return ceil(once / (1 - self.loss))


def traffic(shared: tuple[Shared, ...], robots: int, link: Link, to_all: bool) -> Traffic:
    """For entries that write these variables. `to_all`: one datagram reaches all others (broadcast, multicast)."""
    writes = _entry(shared)
    head = overhead(robots)
    room = DATAGRAM - head
    alone = on_the_medium(head, link.mtu)
    if writes <= room:
        datagrams, word = 1, on_the_medium(head + writes, link.mtu)
    else:  # fragments, and the word that tells of them
        full, rest = divmod(writes, room)
        datagrams = full + bool(rest) + 1
        word = alone + full * on_the_medium(DATAGRAM, link.mtu) + bool(rest) * on_the_medium(head + rest, link.mtu)
    return Traffic(robots, 1 if to_all else robots - 1, writes, datagrams, word, alone, link.loss)


def round_bytes(program: Program, robots: int, link: Link, to_all: bool = False) -> int:
    """The most bytes a round that a fleet of that size puts on its medium, headers of packets included."""
    return traffic(_longest(program), robots, link, to_all).bytes


def check_link(
    program: Program, robots: int, delta: float, link: Link | None, to_all: bool = False
) -> list[Diagnostic]:
    """An error if a round of `delta` seconds is too short for what a fleet of that size may send in it, by what its
    file says of the link; a warning if an event's writes need several datagrams. Nothing without a `link`."""
    if link is None or robots < 2 or not program.events:
        return []
    shared = _longest(program)
    found = traffic(shared, robots, link, to_all)
    largest = max(shared, key=lambda v: most_bytes(v.type), default=None)
    span = largest.span if largest else program.events[0].span
    told = []
    if found.bytes * 8 > link.rate * delta:
        message = f"{_arithmetic(found)}; a round of {delta:g} s at {link.rate:g} bit/s carries "
        message += f"{int(link.rate * delta / 8)}"
        told.append(Diagnostic("B008", "error", message, span, help=_link_help(found, shared, delta, link)))
    elif largest and found.datagrams > 1:
        message = (
            f"an event's writes take up to {found.writes} bytes and go in {found.datagrams} datagrams: one of these "
            "that is lost delays the round"
        )
        room = DATAGRAM - overhead(robots)
        fits = _capacity(largest, lambda v: _entry(_with(shared, v)) <= room)
        help = f"they fit in one with {fits}" if fits else "write fewer or smaller variables in one event"
        told.append(Diagnostic("B009", "warning", message, span, help=help))
    return told


def on_the_medium(datagram: int, mtu: int) -> int:
    """The bytes that a datagram takes there: in as few packets as go, each with its headers."""
    packets = ceil((datagram + _UDP) / ((mtu - _IP) // 8 * 8))  # fragments are cut at multiples of 8
    return datagram + _UDP + packets * (_IP + _FRAME)


def _arithmetic(found: Traffic) -> str:
    each = f" x {found.receivers} receivers" if found.receivers > 1 else ""
    datagrams = f"{found.datagrams} datagrams" if found.datagrams > 1 else "one datagram"
    return (
        f"a round may put {found.bytes} bytes on the link: {found.robots} robots{each} x ({found.word} for "
        f"{found.writes} of writes in {datagrams} + {found.acknowledgement} of acknowledgement) / "
        f"(1 - {found.loss:g} lost)"
    )


def _link_help(found: Traffic, shared: tuple[Shared, ...], delta: float, link: Link) -> str:
    """The least delta and rate, and the greatest capacity of the largest variable, that make it fit."""
    bits = found.bytes * 8
    ways = [f"a delta of {_up(bits / link.rate)} s"] if bits / link.rate <= LONGEST_DELTA else []
    ways.append(f"a link of {_up(bits / delta)} bit/s")
    if shared:
        largest = max(shared, key=lambda v: most_bytes(v.type))
        to_all = found.receivers == 1

        def enough(variable: Shared) -> bool:
            return traffic(_with(shared, variable), found.robots, link, to_all).bytes * 8 <= link.rate * delta

        fits = _capacity(largest, enough)
        ways += [fits] if fits else []
    return f"it fits with {', or '.join(ways)}"


def _up(value: float) -> str:
    """Rounded up to three digits."""
    step = 10.0 ** (floor(log10(value)) - 2)
    return f"{ceil(value / step) * step:.3g}" if value < 100 else f"{ceil(value / step) * round(step)}"


def _longest(program: Program) -> tuple[Shared, ...]:
    """The variables that are written by the event whose writes take most."""
    written = (_written(event.effect) for event in program.events)
    return max((tuple(v for v in program.shared if v.name in names) for names in written), key=_entry, default=())


def _written(block: stmt.Block) -> set[str]:
    """The shared variables that statements write."""
    places = [s.place for s in statements(block) if isinstance(s, stmt.Assign)]
    return {place.name for place in places if isinstance(place, (stmt.OwnSlot, stmt.SharedPlace))}


def _init_bytes(program: Program, shared: tuple[Shared, ...]) -> int:
    return _ENTRY + sum(_most_in(program.init, v) for v in shared)


def _most_in(block: stmt.Block, variable: Shared) -> int:
    """The most bytes of a write of what these statements give to a variable; 0 if they write it nowhere."""
    writes = [s for s in statements(block) if isinstance(s, stmt.Assign)]
    values = [s.value for s in writes if s.place in (stmt.OwnSlot(variable.name), stmt.SharedPlace(variable.name))]
    return max((_WRITE + most_bytes(_as_long_as(value, variable.type)) for value in values), default=0)


def _as_long_as(value: expr.Expr, type_: Type) -> Type:
    """A variable's type with no more capacity than an expression needs of it: `[]` holds nothing."""
    if isinstance(value, expr.Make) and isinstance(type_, (Sequence, MapOf)):
        return replace(type_, capacity=min(type_.capacity, len(value.items)))
    return type_


def _kept(variable: Shared, robots: int) -> int:
    """The most bytes of all that a variable holds."""
    most = most_bytes(variable.type)
    return _head(robots, 16, 0) + robots * most if variable.kind == "allread" else most


def _with(shared: tuple[Shared, ...], changed: Shared) -> tuple[Shared, ...]:
    return tuple(changed if v.name == changed.name else v for v in shared)


def most_bytes(type_: Type) -> int:
    """The most bytes of a value in MessagePack, within its capacities."""
    match type_:
        case Scalar():
            return FIXED[type_]
        case Sized("string", capacity):
            return _head(capacity, 32, 256) + capacity
        case Sized("GridMap", capacity):
            packed = (capacity + 3) // 4  # two bits a cell
            return 1 + 5 * NUMBER + _head(packed, 0, 256) + packed
        case Sized(_, capacity):
            return 1 + 2 * (_head(capacity, 16, 0) + NUMBER * capacity) + NUMBER
        case Sequence(_, element, capacity):
            return _head(capacity, 16, 0) + capacity * most_bytes(element)
        case MapOf(key, value, capacity):
            return _head(capacity, 16, 0) + capacity * most_bytes(TupleOf((key, value)))
        case TupleOf(items):
            return _head(len(items), 16, 0) + sum(map(most_bytes, items))
        case RecordType(_, fields):
            return most_bytes(TupleOf(tuple([field for _, field in fields])))
        case ExternType():
            return 1 + _head(EXTERN_BYTES, 0, 256) + EXTERN_BYTES
        case PerRobot(element):
            raise AssertionError(f"a variable of type {element}[N_SYS]")
        case _:
            assert_never(type_)


def overhead(robots: int) -> int:
    """The most bytes of a datagram beside its entries: head, clock echoes of up to 8 robots, what is held of each.
    With one or two robots a Hello has more."""
    echoes = 20 * min(robots, 8)
    return echoes + max(152 + robots, 141 + 5 * robots + (2 if robots >= 16 else 0))


def _head(count: int, shortest: int, short: int) -> int:
    return 1 if count < shortest else 2 if count < short else 3 if count < 1 << 16 else 5


def _entry(shared: tuple[Shared, ...]) -> int:
    """The most bytes of an entry that writes these variables."""
    return _ENTRY + sum(_WRITE + most_bytes(v.type) for v in shared)


def _capacity(variable: Shared, fits: Callable[[Shared], bool]) -> str:
    """The greatest `max` with which a variable fits, as help says it; empty if none does."""
    type_ = variable.type
    if not isinstance(type_, (Sized, Sequence, MapOf)):
        return ""
    sizes = range(1, type_.capacity + 1)
    most = bisect_left(sizes, True, key=lambda n: not fits(replace(variable, type=replace(type_, capacity=n))))
    inner = " as its first capacity" if isinstance(type_, (Sequence, MapOf)) and _sized_inside(type_) else ""
    return f"`max {most}`{inner}: {type_} {variable.name} ... max {most}" if most else ""


def _sized_inside(type_: Sequence | MapOf) -> bool:
    """Whether more capacities follow the outermost one."""
    parts = (type_.element,) if isinstance(type_, Sequence) else (type_.key, type_.value)
    return any(isinstance(part, (Sized, Sequence, MapOf)) for part in parts)
