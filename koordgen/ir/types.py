"""The types of Koord values, as the IR carries them. A type prints as the user writes it."""

from __future__ import annotations

from koordgen.node import Node


class Scalar(Node):
    """A type without parts that the language names: one of the constants below."""

    name: str

    def __str__(self) -> str:
        return self.name


class PerRobot(Node):
    """`T name[N_SYS]`: one value a robot, indexed by pid (an `allread` variable)."""

    element: Scalar

    def __str__(self) -> str:
        return f"{self.element}[N_SYS]"


INT = Scalar("int")
FLOAT = Scalar("float")
BOOL = Scalar("bool")
POINT = Scalar("Point")
# What a failed check leaves behind: it agrees with everything, so that one mistake gives one message.
POISON = Scalar("<error>")

NAMED: dict[str, Scalar] = {t.name: t for t in (INT, FLOAT, BOOL, POINT)}

Type = Scalar | PerRobot
