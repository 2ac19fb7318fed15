"""The types of Koord values, as the IR carries them. A type prints as the user writes it.

Capacities bound what a variable may hold; like spans they take no part in equality: a list of at most 8 fits a
variable of at most 4 as long as it is short enough when the event ends.
"""

from __future__ import annotations

from koordgen.lang.node import Node


class Scalar(Node):
    """A type without parts: one of the constants below."""

    name: str

    def __str__(self) -> str:
        return self.name


class Sized(Node):
    """A type without parts whose values vary in length: a string (bytes of UTF-8), a GridMap (cells), a Scan (rays)."""

    name: str
    capacity: int

    def __str__(self) -> str:
        return self.name


class Sequence(Node):
    """`List<T>`, `Queue<T>`, `Set<T>`: `name` is that word."""

    name: str
    element: Type
    capacity: int

    def __str__(self) -> str:
        return f"{self.name}<{self.element}>"


class MapOf(Node):
    """`Map<K, V>`"""

    key: Type
    value: Type
    capacity: int

    def __str__(self) -> str:
        return f"Map<{self.key}, {self.value}>"


class TupleOf(Node):
    """`(A, B)`: two items at least."""

    items: tuple[Type, ...]

    def __str__(self) -> str:
        return f"({', '.join(map(str, self.items))})"


class RecordType(Node):
    """`def Task:`; fields in the order of their declaration."""

    name: str
    fields: tuple[tuple[str, Type], ...]

    def __str__(self) -> str:
        return self.name


class ExternType(Node):
    """`extern type Ticket`: a value that only extern functions can look into."""

    name: str

    def __str__(self) -> str:
        return self.name


class PerRobot(Node):
    """`T name[N_SYS]`: one value a robot, indexed by pid (an allread variable, a parameter of a function)."""

    element: Type

    def __str__(self) -> str:
        return f"{self.element}[N_SYS]"


# Capacities where none is declared: of what is shared, and of what a robot keeps to itself.
SHARED_ELEMENTS, SHARED_BYTES, SHARED_CELLS, SHARED_RAYS = 64, 256, 1024, 64
LOCAL_ELEMENTS, LOCAL_BYTES, LOCAL_CELLS, LOCAL_RAYS = 4096, 4096, 65536, 4096

INT = Scalar("int")
FLOAT = Scalar("float")
BOOL = Scalar("bool")
POINT = Scalar("Point")
POSE = Scalar("Pose")
GRID = Scalar("Grid")
# Regions stand on the right of `in` only; a planner and a stream are ports only.
RECT = Scalar("Rect")
BALL = Scalar("Ball")
PLANNER = Scalar("PathPlanner")
STREAM = Scalar("stream")
STRING = Sized("string", SHARED_BYTES)
GRIDMAP = Sized("GridMap", SHARED_CELLS)
SCAN = Sized("Scan", SHARED_RAYS)
# What a failed check leaves behind: it agrees with everything, so that one mistake gives one message.
POISON = Scalar("<error>")

# The types that a program names by a plain word, beside its records and extern types.
NAMED: dict[str, Scalar | Sized] = {
    t.name: t for t in (INT, FLOAT, BOOL, STRING, POINT, POSE, GRID, GRIDMAP, SCAN, PLANNER, STREAM)
}
# The words that stand before `<`: how many types they take.
GENERIC: dict[str, int] = {"List": 1, "Queue": 1, "Set": 1, "Map": 2}

Type = Scalar | Sized | Sequence | MapOf | TupleOf | RecordType | ExternType | PerRobot


def list_of(element: Type) -> Sequence:
    """`List<element>` without a declared capacity."""
    return Sequence("List", element, SHARED_ELEMENTS)


def is_key(type_: Type) -> bool:
    """Whether values of a type may be elements of a Set and keys of a Map: they have one exact order."""
    match type_:
        case TupleOf(items):
            return all(map(is_key, items))
        case _:
            return type_ in (INT, BOOL, STRING)
