"""Variables of a random program: their reads, the bounds that writers respect, possible claims about them."""

from __future__ import annotations

from random import Random
from typing import Literal, NamedTuple

Home = Literal["local", "allread", "allwrite", "sensor", "actuator", "param", "temp"]
Form = Literal["any", "range", "grows", "index", "same"]

WORDS: dict[str, tuple[str, ...]] = {
    "int": (
        "count",
        "total",
        "best",
        "most",
        "step",
        "votes",
        "bid",
        "rank",
        "leader",
        "battery",
        "seen_last",
        "tries",
    ),
    "bool": ("done", "ready", "busy", "found", "armed", "idle", "told", "late"),
    "float": ("speed", "heat", "margin", "average"),
    "Point": ("home", "place", "mark", "corner"),
    "List<int>": ("xs", "jobs", "marks", "history", "bids"),
    "List<Point>": ("route", "places"),
    "List<List<int>>": ("rows", "groups"),
    "Task": ("task", "order"),
    "List<Task>": ("tasks", "orders"),
    "Map<int, int>": ("cost", "visits"),
    "Map<string, int>": ("seen", "stock"),
    "Set<int>": ("ids", "visited"),
    "Queue<int>": ("queue", "inbox"),
    "(int, bool)": ("pair", "last_try"),
    "List<(int, int)>": ("pairs", "offers"),
}
KEYS = ('"a"', '"b"', '"door"')


class Variable(NamedTuple):
    """`low` and `high`: literals that a variable of the form "range" keeps within, and `low` its first value where the
    form is "same". A variable that "grows" never falls; an "index" is a robot's, or -1."""

    name: str
    type: str
    home: Home
    form: Form = "any"
    low: int = 0
    high: int = 0

    @property
    def here(self) -> str:
        """As an event reads and writes it."""
        return f"{self.name}[pid]" if self.home == "allread" else self.name

    def of(self, robot: str) -> str:
        """As a property reads that of one robot."""
        return f"{self.name}[{robot}]" if self.home in ("local", "allread", "sensor", "actuator") else self.name

    @property
    def own(self) -> bool:
        """Whether each robot has one."""
        return self.home in ("local", "allread", "sensor", "actuator")

    @property
    def writable(self) -> bool:
        return self.home not in ("sensor", "param")

    def first(self) -> str:
        """Its initial value, empty where its type's default will do."""
        if self.type == "int":
            value = {"index": -1, "range": self.low, "same": self.low}.get(self.form, 0)
            return f" = {value}" if value else ""
        return ""


def int_variable(random: Random, name: str, home: Home) -> Variable:
    """An int that keeps to something, mostly."""
    form: Form = random.choice(("any", "range", "range", "range", "grows", "index", "same"))
    low = random.choice((0, 0, 0, 0, 1, -1, -2))
    return Variable(name, "int", home, form, low, low + random.choice((1, 2, 3, 5, 10)))
