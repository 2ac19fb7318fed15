"""Types of the IR. `str` of a type is its form in a program.

Capacities limit the size of a variable's value. Like spans they do not count in equality: a list with capacity 8 can be
assigned to a variable with capacity 4, if it has at most 4 elements when the event ends.
"""

from __future__ import annotations

from koordgen.lang.node import Node


class Scalar(Node):
    """Type without parts: one of the constants below."""

    name: str

    def __str__(self) -> str:
        return self.name


class Sized(Node):
    """Type without parts but with a capacity: string (bytes of UTF-8), GridMap (cells) or Scan (rays)."""

    name: str
    capacity: int

    def __str__(self) -> str:
        return self.name


class Sequence(Node):
    """Type `List<T>`, `Queue<T>` or `Set<T>`. `name` is "List", "Queue" or "Set"."""

    name: str
    element: Type
    capacity: int

    def __str__(self) -> str:
        return f"{self.name}<{self.element}>"


class MapOf(Node):
    """Type `Map<K, V>`."""

    key: Type
    value: Type
    capacity: int

    def __str__(self) -> str:
        return f"Map<{self.key}, {self.value}>"


class TupleOf(Node):
    """Type `(A, B)` of tuples with two or more items."""

    items: tuple[Type, ...]

    def __str__(self) -> str:
        return f"({', '.join(map(str, self.items))})"


class RecordType(Node):
    """Type of a record, `def Task:`, with its fields in the order of their declaration."""

    name: str
    fields: tuple[tuple[str, Type], ...]

    def __str__(self) -> str:
        return self.name


class ExternType(Node):
    """Type `extern type Ticket`, whose values are opaque to all but extern functions."""

    name: str

    def __str__(self) -> str:
        return self.name


class PerRobot(Node):
    """Type of `T name[N_SYS]`, an allread variable or a parameter: one value for each robot, by pid."""

    element: Type

    def __str__(self) -> str:
        return f"{self.element}[N_SYS]"


MOST_ROBOTS = 128  # the largest number of robots in a fleet

# Default capacities: of shared variables, and of local ones.
SHARED_ELEMENTS, SHARED_BYTES, SHARED_CELLS, SHARED_RAYS = 64, 256, 1024, 64
LOCAL_ELEMENTS, LOCAL_BYTES, LOCAL_CELLS, LOCAL_RAYS = 4096, 4096, 65536, 4096

INT = Scalar("int")
FLOAT = Scalar("float")
BOOL = Scalar("bool")
POINT = Scalar("Point")
POSE = Scalar("Pose")
GRID = Scalar("Grid")
# Regions may only stand on the right of `in`; a planner and a stream are only types of ports.
RECT = Scalar("Rect")
BALL = Scalar("Ball")
PLANNER = Scalar("PathPlanner")
STREAM = Scalar("stream")
STRING = Sized("string", SHARED_BYTES)
GRIDMAP = Sized("GridMap", SHARED_CELLS)
SCAN = Sized("Scan", SHARED_RAYS)
# Type of an expression with an error. It agrees with every type, so that one mistake gives one message.
POISON = Scalar("<error>")

# Types with a plain name, apart from records and extern types.
NAMED: dict[str, Scalar | Sized] = {
    t.name: t for t in (INT, FLOAT, BOOL, STRING, POINT, POSE, GRID, GRIDMAP, SCAN, PLANNER, STREAM)
}
# Names of container types -> number of types between `<` and `>`.
GENERIC: dict[str, int] = {"List": 1, "Queue": 1, "Set": 1, "Map": 2}

Type = Scalar | Sized | Sequence | MapOf | TupleOf | RecordType | ExternType | PerRobot


def list_of(element: Type) -> Sequence:
    """Return `List<element>` with the default capacity."""
    return Sequence("List", element, SHARED_ELEMENTS)


def is_key(type_: Type) -> bool:
    """Return whether values of a type may be elements of a Set and keys of a Map.

    Such values have an exact total order.
    """
    match type_:
        case TupleOf(items):
            return all(map(is_key, items))
        case _:
            return type_ in (INT, BOOL, STRING)
