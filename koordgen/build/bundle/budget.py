"""Message sizes, checked at build time: shared variables must fit into datagrams, and a round into the link's rate.

All sizes are upper bounds. Each message shows its arithmetic.
"""

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
    from koordgen.fleet.medium import Medium

# These limits are equal to those of koordgen/runtime/net/layout.py, bounds.py and wire.py (tests compare them).
# _WRITE and _ENTRY: bytes of the longest MessagePack encodings.
DATAGRAM = 1200
MOST_ENTRY, MOST_FRAGMENTS, MOST_SHARED = 128 * 1024, 256, 256
WRITE, ENTRY = 5, 38
LONGEST_DELTA = 60.0  # seconds; equal to that of koordgen/fleet/file.py
_UDP, _IP, _FRAME = 8, 20, 38  # bytes of headers: per datagram, per packet, per Ethernet frame (with its gap)


def check_budget(program: Program, robots: int) -> list[Diagnostic]:
    """Return errors if the shared variables are too large for a fleet of `robots` robots.

    Three messages are checked: the log entry of one round, the state transfer to a robot that rejoins, and the values
    that `init` writes. Each error points at the largest variable.
    """
    if len(program.shared) > MOST_SHARED:
        message = f"the program has {len(program.shared)} shared variables; at most {MOST_SHARED} are supported"
        return [Diagnostic("B004", "error", message, program.shared[-1].span, help="combine some of them in a record")]
    return [*(_check_entry(program, robots) or _check_store(program, robots)), *_check_init(program, robots)]


def _check_entry(program: Program, robots: int) -> list[Diagnostic]:
    room, total = most_entry(robots), _entry(program.shared)
    if total <= room:
        return []
    largest = max(program.shared, key=lambda v: most_bytes(v.type))
    message = (
        f"shared writes of one round take up to {total} bytes; with {robots} robots a round can send at most {room} "
        f"bytes; {largest.name} alone takes up to {most_bytes(largest.type)} bytes"
    )
    return [Diagnostic("B004", "error", message, largest.span, help=_less(program, largest, robots))]


def _check_store(program: Program, robots: int) -> list[Diagnostic]:
    room, total = most_store(robots), store_bytes(program.shared, robots)
    if total <= room:
        return []
    largest = max(program.shared, key=lambda v: _kept(v, robots))
    slots = f": {robots} slots of {most_bytes(largest.type)} bytes" if largest.kind == "allread" else ""
    message = (
        f"all shared variables together take up to {total} bytes; with {robots} robots, a robot that rejoins can "
        f"receive at most {room} bytes; {largest.name} alone takes up to {_kept(largest, robots)} bytes{slots}"
    )
    return [Diagnostic("B004", "error", message, largest.span, help=_less(program, largest, robots))]


def _less(program: Program, largest: Shared, robots: int) -> str:
    """Return the help of B004. It names the greatest capacity with which the largest variable fits."""

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
    written = [(v, most_in(program.init, v)) for v in program.shared]
    largest = max(written, key=lambda pair: pair[1])[0]
    each = " + ".join(f"{most} for {v.name}" for v, most in written if most)
    message = (
        f"writes of `init` to shared variables must fit into one datagram; they take up to {total} bytes: {ENTRY} + "
        f"{each}; with {robots} robots there is room for {room} bytes"
    )
    found = _capacity(largest, lambda v: _init_bytes(program, _with(program.shared, v)) <= room)
    ways = [f"it fits with {found}"] if found else []
    help = ", or ".join([*ways, "give the variable its initial value in its declaration, or write it in an event"])
    return [Diagnostic("B004", "error", message, largest.span, help=help)]


def most_entry(robots: int) -> int:
    """Return the largest size in bytes of one log entry in a fleet of `robots` robots."""
    return min(MOST_ENTRY, most_store(robots))


def most_store(robots: int) -> int:
    """Return the size in bytes that all shared variables of a fleet of `robots` robots may have.

    State transfer sends them to a robot that rejoins, in at most MOST_FRAGMENTS datagrams.
    """
    return MOST_FRAGMENTS * (DATAGRAM - overhead(robots))


def store_bytes(shared: tuple[Shared, ...], robots: int) -> int:
    """Return the largest size in bytes of a state transfer: all slots of these variables, and the protocol's fields."""
    members = array_head(robots, 16, 0) + NUMBER * robots
    acted = array_head(robots, 16, 0) + 5 * robots
    beside = 1 + (1 + 2 * NUMBER + members) + NUMBER + array_head(len(shared), 16, 0) + members + acted
    return beside + sum(_kept(v, robots) for v in shared)


def most_init(robots: int) -> int:
    """Return the largest size in bytes of the log entry of `init`. A Hello carries it in one datagram."""
    return DATAGRAM - (146 + 20 * min(robots, 8) + array_head(robots, 16, 0) + robots)


class Traffic(Node):
    """Upper bound of the traffic of one round. All byte counts but `writes` include headers of packets.

    `writes`: bytes of the longest log entry. `datagrams`: number of datagrams that carry it to one receiver.
    `entry`: bytes of these datagrams. `acknowledgement`: bytes of the datagram that reports that a round was applied.
    `loss`: share of datagrams that the link loses, below 1.
    """

    robots: int
    addresses: int  # addresses of all robots: a squad has one for each of its robots, another robot has one
    receivers: int  # receivers of a robot's datagrams; 1 if one datagram reaches all robots
    writes: int
    datagrams: int
    entry: int
    acknowledgement: int
    loss: float

    @property
    def bytes(self) -> int:
        """Bytes that the whole fleet sends in one round, with retransmissions of lost datagrams."""
        once = self.addresses * self.receivers * (self.entry + self.acknowledgement)
        return ceil(once / (1 - self.loss))


def traffic(shared: tuple[Shared, ...], robots: int, link: Medium, to_all: bool, addresses: int = 0) -> Traffic:
    """Return the traffic of a round in which each robot writes these variables.

    `to_all`: one datagram reaches all other robots (broadcast, multicast). `addresses`: of all robots, if there are
    squads; 0: each robot has one.
    """
    return traffic_of(_entry(shared), robots, link, to_all, addresses)


def traffic_of(writes: int, robots: int, link: Medium, to_all: bool, addresses: int = 0) -> Traffic:
    """Return the traffic of a round in which each robot's log entry has `writes` bytes. Others: see `traffic`."""
    head = overhead(robots)
    room = DATAGRAM - head
    alone = on_the_medium(head, link.mtu)
    if writes <= room:
        datagrams, entry = 1, on_the_medium(head + writes, link.mtu)
    else:  # the fragments of an entry, and the round message that announces them
        full, rest = divmod(writes, room)
        datagrams = full + bool(rest) + 1
        entry = alone + full * on_the_medium(DATAGRAM, link.mtu) + bool(rest) * on_the_medium(head + rest, link.mtu)
    return Traffic(robots, addresses or robots, 1 if to_all else robots - 1, writes, datagrams, entry, alone, link.loss)


def round_bytes(program: Program, robots: int, link: Medium, to_all: bool = False) -> int:
    """Return the largest number of bytes that the fleet sends in one round, headers of packets included."""
    return traffic(longest_event(program), robots, link, to_all).bytes


def check_link(
    program: Program, robots: int, delta: float, link: Medium | None, to_all: bool = False, addresses: int = 0
) -> list[Diagnostic]:
    """Check the traffic of one round against the `link` of the fleet file; None if the fleet file has none.

    B008 (error): a round of `delta` seconds is too short for the traffic. B009 (warning): the writes of one event need
    several datagrams. `to_all`, `addresses`: see `traffic`.
    """
    if link is None or robots < 2 or not program.events:
        return []
    shared = longest_event(program)
    found = traffic(shared, robots, link, to_all, addresses)
    largest = max(shared, key=lambda v: most_bytes(v.type), default=None)
    span = largest.span if largest else program.events[0].span
    diagnostics = []
    if found.bytes * 8 > link.rate * delta:
        message = f"{_arithmetic(found)}; a round of {delta:g} s at {link.rate:g} bit/s carries "
        message += f"{int(link.rate * delta / 8)} bytes"
        diagnostics.append(Diagnostic("B008", "error", message, span, help=_link_help(found, shared, delta, link)))
    elif largest and found.datagrams > 1:
        message = (
            f"the writes of an event take up to {found.writes} bytes and need {found.datagrams} datagrams: "
            "the loss of one of them delays the round"
        )
        room = DATAGRAM - overhead(robots)
        fits = _capacity(largest, lambda v: _entry(_with(shared, v)) <= room)
        help = f"they fit into one with {fits}" if fits else "write fewer or smaller variables in one event"
        diagnostics.append(Diagnostic("B009", "warning", message, span, help=help))
    return diagnostics


def on_the_medium(datagram: int, mtu: int) -> int:
    """Return the bytes that a datagram takes on the link, in as few packets as possible, with all headers."""
    packets = ceil((datagram + _UDP) / ((mtu - _IP) // 8 * 8))  # fragments have multiples of 8 bytes
    return datagram + _UDP + packets * (_IP + _FRAME)


def _arithmetic(found: Traffic) -> str:
    each = f"{found.robots} robots" + (f" x {found.receivers} receivers" if found.receivers > 1 else "")
    if found.addresses != found.robots:  # each address receives from all robots but one
        each = f"{found.addresses} addresses of {found.robots} robots x {found.receivers} senders"
    datagrams = f"{found.datagrams} datagrams" if found.datagrams > 1 else "one datagram"
    return (
        f"a round may send {found.bytes} bytes: {each} x ({found.entry} for {found.writes} of "
        f"writes in {datagrams} + {found.acknowledgement} for the acknowledgement) / (1 - {found.loss:g} loss)"
    )


def _link_help(found: Traffic, shared: tuple[Shared, ...], delta: float, link: Medium) -> str:
    """Return the help of B008. It names a delta, a rate and a capacity of the largest variable that would suffice."""
    bits = found.bytes * 8
    ways = [f"a delta of {_up(bits / link.rate)} s"] if bits / link.rate <= LONGEST_DELTA else []
    ways.append(f"a link of {_up(bits / delta)} bit/s")
    if shared:
        largest = max(shared, key=lambda v: most_bytes(v.type))
        to_all = found.receivers == 1

        def enough(variable: Shared) -> bool:
            made = traffic(_with(shared, variable), found.robots, link, to_all, found.addresses)
            return made.bytes * 8 <= link.rate * delta

        fits = _capacity(largest, enough)
        ways += [fits] if fits else []
    return f"it fits with {', or '.join(ways)}"


def _up(value: float) -> str:
    """Format a value, rounded up to three digits."""
    step = 10.0 ** (floor(log10(value)) - 2)
    return f"{ceil(value / step) * step:.3g}" if value < 100 else f"{ceil(value / step) * round(step)}"


def longest_event(program: Program) -> tuple[Shared, ...]:
    """Return the shared variables that are written by the event with the largest log entry."""
    written = (_written(event.effect) for event in program.events)
    return max((tuple(v for v in program.shared if v.name in names) for names in written), key=_entry, default=())


def _written(block: stmt.Block) -> set[str]:
    """Return the names of the shared variables that a block writes."""
    places = [s.place for s in statements(block) if isinstance(s, stmt.Assign)]
    return {place.name for place in places if isinstance(place, (stmt.OwnSlot, stmt.SharedPlace))}


def _init_bytes(program: Program, shared: tuple[Shared, ...]) -> int:
    return ENTRY + sum(most_in(program.init, v) for v in shared)


def most_in(block: stmt.Block, variable: Shared) -> int:
    """Return the largest size in bytes of a write to `variable` in a block; 0 if the block does not write it."""
    writes = [s for s in statements(block) if isinstance(s, stmt.Assign)]
    values = [s.value for s in writes if s.place in (stmt.OwnSlot(variable.name), stmt.SharedPlace(variable.name))]
    return max((WRITE + most_bytes(_as_long_as(value, variable.type)) for value in values), default=0)


def _as_long_as(value: expr.Expr, type_: Type) -> Type:
    """Return `type_` with the capacity of a literal, which is its length: 0 for `[]`."""
    if isinstance(value, expr.Make) and isinstance(type_, (Sequence, MapOf)):
        return replace(type_, capacity=min(type_.capacity, len(value.items)))
    return type_


def _kept(variable: Shared, robots: int) -> int:
    """Return the largest size in bytes of a variable, with all its slots."""
    most = most_bytes(variable.type)
    return array_head(robots, 16, 0) + robots * most if variable.kind == "allread" else most


def _with(shared: tuple[Shared, ...], changed: Shared) -> tuple[Shared, ...]:
    return tuple(changed if v.name == changed.name else v for v in shared)


def most_bytes(type_: Type) -> int:
    """Return the largest size in bytes of a MessagePack value of a type, within the declared capacities."""
    match type_:
        case Scalar():
            return FIXED[type_]
        case Sized("string", capacity):
            return array_head(capacity, 32, 256) + capacity
        case Sized("GridMap", capacity):
            packed = (capacity + 3) // 4  # two bits a cell
            return 1 + 5 * NUMBER + array_head(packed, 0, 256) + packed
        case Sized(_, capacity):
            return 1 + 2 * (array_head(capacity, 16, 0) + NUMBER * capacity) + NUMBER
        case Sequence(_, element, capacity):
            return array_head(capacity, 16, 0) + capacity * most_bytes(element)
        case MapOf(key, value, capacity):
            return array_head(capacity, 16, 0) + capacity * most_bytes(TupleOf((key, value)))
        case TupleOf(items):
            return array_head(len(items), 16, 0) + sum(map(most_bytes, items))
        case RecordType(_, fields):
            return most_bytes(TupleOf(tuple([field for _, field in fields])))
        case ExternType():
            return 1 + array_head(EXTERN_BYTES, 0, 256) + EXTERN_BYTES
        case PerRobot(element):
            raise AssertionError(f"a variable of type {element}[N_SYS]")
        case _:
            assert_never(type_)


def overhead(robots: int) -> int:
    """Return the largest size of a datagram without its log entries, in bytes.

    A datagram has a head, up to 8 clock echoes, and a number for each robot. In a fleet of one or two robots, the
    longest datagram is a Hello; in larger fleets it is a round message.
    """
    echoes = 20 * min(robots, 8)
    return echoes + max(152 + robots, 141 + 5 * robots + (2 if robots >= 16 else 0))


def array_head(count: int, shortest: int, short: int) -> int:
    """Return the bytes of the header of an array or text of `count` items.

    One byte suffices below `shortest` items, and two bytes suffice below `short` items.
    """
    return 1 if count < shortest else 2 if count < short else 3 if count < 1 << 16 else 5


def _entry(shared: tuple[Shared, ...]) -> int:
    """Return the largest size in bytes of a log entry that writes these variables."""
    return ENTRY + sum(WRITE + most_bytes(v.type) for v in shared)


def _capacity(variable: Shared, fits: Callable[[Shared], bool]) -> str:
    """Return a help text with the greatest `max` for which the variable fits; "" if it fits for no `max`."""
    type_ = variable.type
    if not isinstance(type_, (Sized, Sequence, MapOf)):
        return ""
    sizes = range(1, type_.capacity + 1)
    most = bisect_left(sizes, True, key=lambda n: not fits(replace(variable, type=replace(type_, capacity=n))))
    inner = " as its first capacity" if isinstance(type_, (Sequence, MapOf)) and _sized_inside(type_) else ""
    return f"`max {most}`{inner}: {type_} {variable.name} ... max {most}" if most else ""


def _sized_inside(type_: Sequence | MapOf) -> bool:
    """Return whether the elements, keys or values of a type have capacities, too: `max` names them after the first."""
    parts = (type_.element,) if isinstance(type_, Sequence) else (type_.key, type_.value)
    return any(isinstance(part, (Sized, Sequence, MapOf)) for part in parts)
