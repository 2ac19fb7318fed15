"""Names of a generated program: maps each Koord name to a unique Python name.

A prefix avoids Python's keywords and builtins (the variable `class` becomes `local_class`) and shows the reader of the
generated code what a name denotes. Records and their fields are visible to the user's own Python files, so they keep
their names if possible.
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
_IN_CLASSES = ("int", "float", "bool", "str", "tuple", "set_of", "map_of", "area")  # in annotations and initial values
# Names that a generated program defines itself.
_OWN = (
    "PROGRAM", "LINES", "LIBRARY", "State", "init", "s", "self", "frame", "n_sys", "Any", "Annotated", "msgspec",
    "PROPERTIES", "Fleet", "Ports", "Step",
)  # fmt: skip


def snake(name: str) -> str:
    """Convert `TargetUpdate` to `target_update`; characters that are not letters, digits or underscores are removed."""
    return re.sub(r"\W", "", _WORD.sub("_", name)).lower()


class Names:
    """Python names of one program. The first Koord name that needs a Python name gets it; later ones get a number."""

    formulas = False  # True in `properties.py`, whose formulas read their values from a `Known` object
    floats: Mapping[Place, int] = {}  # kinds of floats in the present block, see koordgen/build/emit/floats.py
    before = after = ""  # prefixes of a port's name; an assumption distinguishes the port before and after the step

    def __init__(self, program: Program) -> None:
        self._taken = {*keyword.kwlist, *dir(builtins), *library.HOME, *_OWN}
        self.records = {r.type.name: self._mint(r.type.name) for r in program.records}
        self.extern_types = {t.name: self._mint(t.name) for t in program.extern_types}
        self.fields = {r.type.name: self._fields([name for name, _ in r.type.fields]) for r in program.records}
        # The names of a param and a local variable that an import adds have a dot: `Mapping.N_SYS`, `Mapping.pid`.
        self.params = {p.name: self._mint(f"PARAM_{snake(p.name.replace('.', '_')).upper()}") for p in program.params}
        self.locals = {v.name: self._mint(f"local_{v.name.replace('.', '_')}") for v in program.locals}
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
        self.provided = {
            (m.name, p.port.name): self._mint(f"provided_{snake(m.name)}_{p.port.name}")
            for m in program.provides
            for p in m.ports
            if p.port.direction == "sensor"
        }
        self.bounds: dict[str, str] = {}  # names of records' bounds, by the text of the bound
        self.used: set[str] = set()

    def _mint(self, wanted: str) -> str:
        name = _free(wanted, self._taken)
        self._taken.add(name)
        return name

    def _fields(self, fields: list[str]) -> dict[str, str]:
        """Return Python names of a record's fields.

        A field must not have a name that the class body uses, because the field would hide it.
        """
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
        """Return a new name for the range of a loop; `name` is the loop's variable."""
        return self._mint(f"turns_{name}")

    def bound(self, record: str, text: str) -> str:
        """Return a new name for the size bound of a record. Generated code writes this name for the bound `text`."""
        self.bounds[text] = self._mint(f"BOUND_{snake(record).upper()}")
        return self.bounds[text]

    def use(self, name: str) -> str:
        """Return `name`, and record that the generated text uses it.

        `name`: a name of the library or the program, or the mark of an operator that `library.notes` explains.
        """
        self.used.add(name)
        return name

    def attempt(self) -> Names:
        """Return a copy with an empty record of used names. It serves text that may be dropped."""
        made = copy.copy(self)
        made.used = set()
        return made

    def within(self, floats: Mapping[Place, int]) -> Names:
        """Return a copy for one block. `floats`: the kinds of floats that variables and ports may hold in the block."""
        made = copy.copy(self)
        made.floats = floats
        return made

    @staticmethod
    def temp(name: str) -> str:
        """Return the Python name of a variable that an event or a function declares. No other name has this prefix."""
        return f"my_{name}"


def _free(wanted: str, taken: set[str]) -> str:
    """Return `wanted`, with a number if the name is taken, and with an `x` in front if it begins with an underscore."""
    wanted = f"x{wanted}" if wanted.startswith("_") else wanted
    name, number = wanted, 2
    while name in taken:
        name, number = f"{wanted}_{number}", number + 1
    return name
