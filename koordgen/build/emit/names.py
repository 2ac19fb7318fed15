"""Mints every Python name in a generated program: pure, collision-checked, prefixed.

A prefix keeps a Koord name clear of Python's keywords and builtins (a variable called `class` becomes
`local_class`) and says on a robot at night what a name is. Records and their fields, which Python beside the program
sees, keep their own names where these are free.
"""

from __future__ import annotations

import builtins
import copy
import keyword
import re
from collections.abc import Mapping

from koordgen.build.emit import library
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.stmt import Place

_WORD = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_IN_CLASSES = ("int", "float", "bool", "str", "tuple", "set_of", "map_of", "area")  # in annotations and first values
# What a generated program calls by these names, beside Python's own and the library's.
_OWN = (
    "PROGRAM", "LINES", "LIBRARY", "State", "init", "s", "self", "frame", "n_sys", "Any", "Annotated", "msgspec",
    "PROPERTIES", "Fleet", "Ports", "Step",
)  # fmt: skip


def snake(name: str) -> str:
    """`TargetUpdate` -> `target_update`; anything that is no letter, digit or underscore goes."""
    return re.sub(r"\W", "", _WORD.sub("_", name)).lower()


class Names:
    """The Python name of each thing in one program. The first thing to claim a name gets it, later ones a number."""

    formulas = False  # whether it is for properties, which are asked of a Known
    floats: Mapping[Place, int] = {}  # of the block at hand: see koordgen/build/emit/floats.py
    before = after = ""  # what stands before a port's name; in an assumption two moments are told apart

    def __init__(self, program: Program) -> None:
        self._taken = {*keyword.kwlist, *dir(builtins), *library.HOME, *_OWN}
        self.records = {r.type.name: self._mint(r.type.name) for r in program.records}
        self.extern_types = {t.name: self._mint(t.name) for t in program.extern_types}
        self.fields = {r.type.name: self._fields([name for name, _ in r.type.fields]) for r in program.records}
        self.params = {p.name: self._mint(f"PARAM_{snake(p.name).upper()}") for p in program.params}
        self.locals = {v.name: self._mint(f"local_{v.name}") for v in program.locals}
        self.shared = {v.name: self._mint(f"shared_{v.name}") for v in program.shared}
        self.ports = {
            (m.name, p.name): self._mint(f"{snake(m.name)}_{p.name}") for m in program.modules for p in m.ports
        }
        self.sensors = {(m.name, p.name) for m in program.modules for p in m.ports if p.direction == "sensor"}
        self.functions = {f.name: self._mint(f"fun_{f.name}") for f in program.functions}
        self.externs = {f.name: self._mint(f"extern_{f.name}") for f in program.externs}
        self.calls = {f.name: self._mint(f"EXTERN_{snake(f.name).upper()}") for f in program.externs}
        self.guards = {e.name: self._mint(f"guard_{snake(e.name)}") for e in program.events}
        self.effects = {e.name: self._mint(f"effect_{snake(e.name)}") for e in program.events}
        self.bounds: dict[str, str] = {}  # of records, by their text
        self.used: set[str] = set()

    def _mint(self, wanted: str) -> str:
        name = _free(wanted, self._taken)
        self._taken.add(name)
        return name

    def _fields(self, fields: list[str]) -> dict[str, str]:
        """A class body's own names hide those that it uses, so these are taken for its fields."""
        classes = {name for name in library.HOME if name[0].isupper()}
        taken = {*keyword.kwlist, *_IN_CLASSES, *classes, *self.records.values(), *self.extern_types.values()}
        found: dict[str, str] = {}
        for field in fields:
            name = f"x{field}" if field.startswith("_") else field
            while name in taken:
                name += "_"
            found[field] = name
            taken.add(name)
        return found

    def turns(self, name: str) -> str:
        """Mint a name for the range that a loop runs over; `name` is the loop's variable."""
        return self._mint(f"turns_{name}")

    def bound(self, record: str, text: str) -> str:
        """Mint a name for how much a record may hold. `types.bound` says it instead of the text."""
        self.bounds[text] = self._mint(f"BOUND_{snake(record).upper()}")
        return self.bounds[text]

    def use(self, name: str) -> str:
        """Return a name, and note that the text has it: of the library, of the program, or an operator that the head of
        the module explains (notes.py)."""
        self.used.add(name)
        return name

    def attempt(self) -> Names:
        """The same names, for text that may be dropped: what it uses is noted apart."""
        made = copy.copy(self)
        made.used = set()
        return made

    def within(self, floats: Mapping[Place, int]) -> Names:
        """The same names, for a block whose places may hold such floats."""
        made = copy.copy(self)
        made.floats = floats
        return made

    @staticmethod
    def temp(name: str) -> str:
        """A variable declared inside an event or function: unique there already, and no other name starts so."""
        return f"my_{name}"


def _free(wanted: str, taken: set[str]) -> str:
    """Names that begin with an underscore mean something to Python."""
    wanted = f"x{wanted}" if wanted.startswith("_") else wanted
    name, number = wanted, 2
    while name in taken:
        name, number = f"{wanted}_{number}", number + 1
    return name
