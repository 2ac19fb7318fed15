"""Compare the code of two commits: fail unless their top-level definitions are equal, wherever they stand.

    python tools/same_code.py OLD NEW [--renames FILE] [--text FILE] [PATH ...]

A commit that moves code between modules changes no syntax tree but for its imports. This command proves it: each
function, class, assignment and other top-level statement of OLD must have one equal partner in NEW, in any module, and
each definition of NEW must be the partner of one in OLD. PATHs are files or folders: only definitions that stand in
them, in either commit, are compared.

Names are compared by what they denote. A name that is imported, however it is imported, or defined in its module must
denote partners, so a moved function cannot read another constant of the same name. If several modules contain equal
definitions, each is paired by the module to which its neighbours moved. Two definitions with one name must not move
into one module. Imports, also under `if TYPE_CHECKING:`, and `__all__` are no definitions; each name in `__all__` must
exist in its module.

--renames FILE   Each line is `OLD_NAME NEW_NAME [PATH]`. Every identifier OLD_NAME in OLD, of variables, attributes,
                 parameters and definitions, must be NEW_NAME in NEW; with PATH, only in that file or folder of OLD.
                 Attributes of packages outside of the repository keep their names. A rename must not give two
                 names of one scope, or two attributes of `self` in one class, the same name.
--text FILE      Docstrings may differ. Each line is a JSON list of two strings: a string literal, or a literal piece of
                 an f-string, that may be replaced by the other one. This covers module paths in tables. An empty FILE
                 allows docstrings only.

Empty lines and lines that begin with `#` count in neither file. Comments are no part of a syntax tree.

Not compared: files that are not Python; the order of top-level definitions and what an import does when it runs;
whether a name is imported for type checking only.

Prints each difference with its places in OLD and NEW. Exit status: 0 without differences, 1 with some, 2 if a commit, a
file or a line of one cannot be read.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import subprocess
import sys
import tarfile
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


class Unreadable(Exception):
    """Raised for a commit, a file or a line that cannot be read."""


class Rules(NamedTuple):
    """Allowed differences.

    `renames`: triples (old name, new name, file or folder of OLD). `literals`: pairs of string literals, of which the
    second one may replace the first; None if no docstring and no literal may change.
    """

    renames: tuple[tuple[str, str, str], ...] = ()
    literals: frozenset[tuple[str, str]] | None = None

    def names(self, path: str) -> dict[str, str]:
        """Return the renames for one file; those with a longer path take precedence."""
        fitting = [r for r in self.renames if _within(path, r[2])]
        return {old: new for old, new, _ in sorted(fitting, key=lambda rename: len(rename[2]))}


class Definition:
    """Top-level statement of a module.

    `tokens`: the nodes of its syntax tree, in pre-order. `names`: the names that the statement binds.
    """

    def __init__(self, module: Module, node: ast.stmt, names: tuple[str, ...]) -> None:
        self.module, self.node, self.names = module, node, names
        self.tokens: list[Token] = []

    @property
    def kind(self) -> str:
        if isinstance(self.node, _FUNCTIONS):
            return "function"
        if isinstance(self.node, ast.ClassDef):
            return "class"
        if _is_text(self.node):
            return "docstring"
        return "assignment" if isinstance(self.node, (ast.Assign, ast.AnnAssign, ast.AugAssign)) else "statement"

    @property
    def label(self) -> str:
        """Kind and names of the definition. A renamed definition has its new name."""
        renames = self.module.renames
        return " ".join((self.kind, *[renames.get(name, name) for name in self.names]))

    @property
    def place(self) -> str:
        return f"{self.module.path}:{self.node.lineno}"


class Token(NamedTuple):
    """One step of a walk over a syntax tree.

    `key`: the text by which a step of one commit is compared with a step of the other one.
    `target`: the object that a name denotes. `literal`: a string that rules may replace.
    """

    key: str
    line: int
    target: Definition | Module | None = None
    literal: str | None = None


class Module:
    """One file of a commit.

    `imports`: name -> dotted path. `stars`: modules from which all public names are imported. `definitions`: name ->
    its first definition.
    """

    def __init__(self, path: str, text: bytes, renames: dict[str, str]) -> None:
        self.path, self.renames = path, renames
        parts = path.removesuffix(".py").split("/")
        self.package = ".".join(parts[:-1])
        self.name = self.package if parts[-1] == "__init__" else ".".join(parts)
        try:
            self.tree = ast.parse(text, path)
        except (SyntaxError, ValueError) as error:
            raise Unreadable(f"{path}: {error}") from None
        self.imports: dict[str, str] = {}
        self.stars: list[tuple[str, int]] = []
        self.definitions: dict[str, Definition] = {}
        self.statements: list[Definition] = []
        self.exported: list[tuple[str, int]] = []
        self.future: list[str] = []
        for node in self.tree.body:
            self._read(node)

    def _read(self, node: ast.stmt) -> None:
        if isinstance(node, ast.ImportFrom) and node.module == "__future__":
            self.future = sorted([*self.future, *(alias.name for alias in node.names)])
        elif isinstance(node, ast.ImportFrom) and node.names[0].name == "*":
            self.stars.append((self._base(node), node.lineno))
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            self.imports.update({name: bound for name, bound, _ in self.imported(node)})
        elif isinstance(node, ast.If) and not node.orelse and _for_types_only(node.test):
            for inner in node.body:
                self._read(inner)
        else:
            frame = _bound([node], self)
            self.imports.update(frame.imports)
            if "__all__" in frame.names:
                strings = [part for part in ast.walk(node) if isinstance(part, ast.Constant)]
                self.exported += [(str(part.value), part.lineno) for part in strings]
                return
            found = Definition(self, node, tuple(sorted(frame.names)))
            self.statements.append(found)
            for name in frame.names:
                self.definitions.setdefault(name, found)

    def _base(self, node: ast.ImportFrom) -> str:
        """Return the dotted path of the module from which names are imported."""
        if not node.level:
            return node.module or ""
        parts = self.package.split(".")
        return ".".join([*parts[: len(parts) - node.level + 1], *([node.module] if node.module else [])])

    def renamed(self, names: Iterable[str], line: int) -> Iterator[str]:
        """Yield an error for each pair of names of one scope that the renames make equal."""
        found = Counter(self.renames.get(name, name) for name in set(names))
        for name, count in found.items():
            if count > 1:
                yield f"{self.path}:{line} -> nowhere: the renames make {count} names of one scope {name}"

    def imported(self, node: ast.Import | ast.ImportFrom) -> Iterator[tuple[str, str, str]]:
        """Yield the names that an import binds, the dotted path of each, and the path that is imported."""
        if isinstance(node, ast.Import):
            for alias in node.names:
                bound = alias.name if alias.asname else alias.name.split(".")[0]
                yield alias.asname or bound, bound, alias.name
            return
        base = self._base(node)
        for alias in node.names:
            yield alias.asname or alias.name, f"{base}.{alias.name}", f"{base}.{alias.name}"


class Frame:
    """Scope inside a definition, for example of a function, with its names."""

    def __init__(self, is_class: bool = False) -> None:
        self.is_class = is_class
        self.names: set[str] = set()
        self.globals: set[str] = set()
        self.imports: dict[str, str] = {}


def _bound(body: Iterable[ast.AST], module: Module, is_class: bool = False) -> Frame:
    """Return the scope of some statements: the names that they bind, without those of inner functions."""
    frame = Frame(is_class)
    outer: set[str] = set()
    pending = [(node, True) for node in body]
    while pending:
        node, own = pending.pop()
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                frame.names.add(name)
                continue
            case ast.Lambda():
                continue
            case ast.Import() | ast.ImportFrom():
                frame.imports.update({name: bound for name, bound, _ in module.imported(node)})
            case ast.NamedExpr(target=ast.Name(id=name)):
                frame.names.add(name)
            case ast.Name(id=name, ctx=ast.Store() | ast.Del()) if own:
                frame.names.add(name)
            case ast.ExceptHandler(name=str(name)) | ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
                frame.names.add(name)
            case ast.MatchMapping(rest=str(name)):
                frame.names.add(name)
            case ast.Global(names=names):
                frame.globals.update(names)
            case ast.Nonlocal(names=names):
                outer.update(names)
        own = own and not isinstance(node, _COMPREHENSIONS)
        pending.extend((child, own) for child in ast.iter_child_nodes(node))
    frame.names -= outer | frame.globals
    return frame


class Commit:
    """Modules of a commit by dotted name, with the tokens of all definitions."""

    def __init__(self, files: dict[str, bytes], rules: Rules, old: bool) -> None:
        self.text_may_change = rules.literals is not None
        self.replaced = {literal for pair in rules.literals or () for literal in pair}
        self.modules = {m.name: m for m in (Module(p, t, rules.names(p) if old else {}) for p, t in files.items())}
        self.faults: list[str] = []
        self.statements: list[Definition] = []
        for module in self.modules.values():
            self.faults += module.renamed(module.definitions, 1)
            self._import_stars(module)
        for module in self.modules.values():
            for definition in module.statements:
                if rules.literals is not None and _is_text(definition.node):
                    continue
                self.statements.append(definition)
                walk = _Walk(self, module)
                walk.statements([definition.node])
                definition.tokens = walk.tokens
                self.faults += walk.faults

    def _import_stars(self, module: Module) -> None:
        for name, line in module.stars:
            if name not in self.modules:
                raise Unreadable(f"{module.path}:{line}: `from {name} import *`: the commit has no such module")
            source = self.modules[name]
            public = [n for n in (*source.imports, *source.definitions) if not n.startswith("_")]
            for bound in [n for n, _ in source.exported] or public:
                module.imports.setdefault(bound, f"{name}.{bound}")

    def resolve(self, dotted: str, depth: int = 0) -> tuple[Definition | Module | None, str, list[str]]:
        """Return the object that a dotted path denotes, the name of the object in NEW, and the rest of the path.

        The object is None if the path leads outside of the repository.
        """
        parts = dotted.split(".")
        for size in range(len(parts), 0, -1):
            module = self.modules.get(".".join(parts[:size]))
            if module is None:
                continue
            rest = parts[size:]
            if not rest:
                return module, "", []
            if rest[0] in module.definitions:
                return module.definitions[rest[0]], module.renames.get(rest[0], rest[0]), rest[1:]
            if rest[0] in module.imports and depth < 20:
                return self.resolve(".".join([module.imports[rest[0]], *rest[1:]]), depth + 1)
            break
        return None, dotted, []


class _Walk:
    """Tokens of one definition."""

    def __init__(self, commit: Commit, module: Module) -> None:
        self.commit, self.module = commit, module
        self.tokens: list[Token] = []
        self.faults: list[str] = []
        self.line = 0
        self.frames: list[Frame] = []

    def put(self, key: str) -> None:
        self.tokens.append(Token(key, self.line))

    def identifier(self, name: str) -> None:
        self.put(f"identifier {self.module.renames.get(name, name)}")

    def statements(self, body: list[ast.stmt]) -> None:
        """Walk a block of statements. Imports that follow one another may stand in any order."""
        if self.commit.text_may_change:
            body = [node for node in body if not _is_text(node)]
            body = [] if len(body) == 1 and isinstance(body[0], ast.Pass) else body
        imports: set[str] = set()
        for node in body:
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                self.line = node.lineno
                imports.update(path for _, _, path in self.module.imported(node))
                continue
            self._imports(imports)
            self.visit(node)
        self._imports(imports)
        self.put("end of block")

    def _imports(self, paths: set[str]) -> None:
        if not paths:
            return
        first = len(self.tokens)
        for path in paths:
            self.dotted(path, "import ")
        self.tokens[first:] = sorted(self.tokens[first:], key=lambda token: token.key)
        paths.clear()

    def dotted(self, path: str, prefix: str = "") -> None:
        """Walk a dotted path that begins with an import."""
        target, name, rest = self.commit.resolve(path)
        kind = "outside" if target is None else "module" if isinstance(target, Module) else "definition"
        for _ in rest:
            self.put("Attribute")
        self.tokens.append(Token(f"{prefix}{kind} {name}", self.line, target))
        for attribute in rest:
            self.identifier(attribute)

    def known(self, name: str) -> str | None:
        """Return the dotted path that a name denotes; "" for a name of the definition itself, None for a builtin."""
        for frame in reversed(self.frames):
            if name in frame.globals:
                break
            if frame.is_class and frame is not self.frames[-1]:
                continue
            if name in frame.names:
                return ""
            if name in frame.imports:
                return frame.imports[name]
        if name in self.module.definitions:
            return f"{self.module.name}.{name}"
        return self.module.imports.get(name)

    def name(self, name: str, attributes: tuple[str, ...] = ()) -> None:
        """Walk a name with its attributes."""
        path = self.known(name)
        if path:
            self.dotted(".".join((path, *attributes)))
            return
        for _ in attributes:
            self.put("Attribute")
        if path is None:
            self.put(f"builtin {name}")
        else:
            self.identifier(name)
        for attribute in attributes:
            self.identifier(attribute)

    def visit(self, node: ast.AST) -> None:
        self.line = getattr(node, "lineno", self.line)
        match node:
            case ast.Name(id=name):
                self.name(name)
            case ast.Attribute():
                self._attribute(node)
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.Lambda():
                self._function(node)
            case ast.ClassDef():
                self._class(node)
            case ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
                self.enter(_bound([generator.target for generator in node.generators], self.module))
                self.generic(node)
                self.frames.pop()
            case ast.Constant(value=str(value)):
                key = "a string that may change" if value in self.commit.replaced else repr(value)
                self.tokens.append(Token(key, self.line, literal=value))
            case ast.Constant(value=value):
                self.put(f"{type(value).__name__} {value!r}")
            case ast.Import() | ast.ImportFrom():
                raise AssertionError(
                    "an import statement reached the walk over nodes; the walk over blocks handles imports"
                )
            case _:
                self.generic(node)

    def generic(self, node: ast.AST, without: tuple[str, ...] = ()) -> None:
        """Walk a node: first the class of the node, then its fields."""
        self.put(type(node).__name__)
        for field, value in ast.iter_fields(node):
            if field not in ("ctx", "kind", "type_comment", "type_ignores", *without):
                self._field(value)

    def _field(self, value: object) -> None:
        match value:
            case ast.AST():
                self.visit(value)
            case list() if value and isinstance(value[0], ast.stmt):
                self.statements(value)
            case list():
                self.put(f"{len(value)} parts")
                for part in value:
                    self._field(part)
            case str():
                self.identifier(value)
            case _:
                self.put(repr(value))

    def enter(self, frame: Frame) -> None:
        """Open a scope."""
        if self.module.renames:
            self.faults += self.module.renamed(frame.names, self.line)
        self.frames.append(frame)

    def _attribute(self, node: ast.Attribute) -> None:
        names: list[str] = []
        inner: ast.expr = node
        while isinstance(inner, ast.Attribute):
            names.append(inner.attr)
            inner = inner.value
        if isinstance(inner, ast.Name):
            self.name(inner.id, tuple(reversed(names)))
            return
        for _ in names:
            self.put("Attribute")
        self.visit(inner)
        for name in reversed(names):
            self.identifier(name)

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) -> None:
        self.generic(node, ("body",))
        body = [node.body] if isinstance(node, ast.Lambda) else node.body
        frame = _bound(body, self.module)
        frame.names |= {part.arg for part in ast.iter_child_nodes(node.args) if isinstance(part, ast.arg)}
        self.enter(frame)
        if isinstance(node, ast.Lambda):
            self.visit(node.body)
        else:
            self.statements(node.body)
        self.frames.pop()

    def _class(self, node: ast.ClassDef) -> None:
        self.generic(node, ("body",))
        if self.module.renames:
            self.faults += self.module.renamed(_attributes_of_self(node), self.line)
        self.enter(_bound(node.body, self.module, is_class=True))
        self.statements(node.body)
        self.frames.pop()


def _for_types_only(test: ast.expr) -> bool:
    return ast.unparse(test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")


def _attributes_of_self(node: ast.ClassDef) -> Iterator[str]:
    for part in ast.walk(node):
        match part:
            case ast.Attribute(value=ast.Name(id="self"), attr=name):
                yield name


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


# Partners: definitions of OLD and NEW with equal tokens


def partners(old: list[Definition], new: list[Definition]) -> dict[Definition, Definition]:
    """Return pairs of definitions with equal tokens.

    If several definitions are equal, those are paired whose modules already contain other pairs.
    """
    keyed: dict[tuple[str, ...], tuple[list[Definition], list[Definition]]] = defaultdict(lambda: ([], []))
    for side, definitions in enumerate((old, new)):
        for definition in definitions:
            keyed[(*definition.module.future, *[token.key for token in definition.tokens])][side].append(definition)
    found: dict[Definition, Definition] = {}
    votes: Counter[tuple[str, str]] = Counter()
    several: list[tuple[Definition, list[Definition]]] = []
    for before, after in keyed.values():
        if len(before) == len(after) == 1:
            found[before[0]] = after[0]
            votes[before[0].module.name, after[0].module.name] += 1
            continue
        for one in before:
            stay = next((other for other in after if other.module.path == one.module.path), None)
            if stay is None:
                several.append((one, after))
            else:
                found[one] = stay
                after.remove(stay)
    for one, after in several:
        if after:
            found[one] = max(after, key=lambda other: votes[one.module.name, other.module.name])
            after.remove(found[one])
    return found


def differences(old: Commit, new: Commit, rules: Rules, paths: tuple[str, ...]) -> Iterator[str]:
    """Yield each difference as one line with its places."""
    yield from old.faults
    found = partners(old.statements, new.statements)
    taken = set(found.values())
    chosen = [d for d in old.statements if _compared(d, found.get(d), paths)]
    lost = [d for d in chosen if d not in found]
    added = [d for d in new.statements if d not in taken and _compared(d, None, paths)]
    for one in lost:
        same = [other for other in added if other.label == one.label]
        same = [other for other in same if one.names or other.module.path == one.module.path]
        same.sort(key=lambda other: other.module.path != one.module.path)
        if same:
            added.remove(same[0])
            yield _first(one, same[0])
        else:
            yield f"{one.place} -> nowhere: {one.label} is gone"
    yield from (f"nowhere -> {other.place}: {other.label} is new" for other in added)
    moves = {(one.module, other.module) for one, other in found.items()}
    for one in chosen:
        if one in found:
            yield from _inside(one, found[one], found, moves, rules)
    for module in new.modules.values():
        if _within_any(module.path, paths):
            yield from _meeting(module, {other: one for one, other in found.items()})
            yield from _exports(module, new)


def _meeting(module: Module, origins: dict[Definition, Definition]) -> Iterator[str]:
    """Yield an error for each name that one module of NEW defines twice, after a move from several modules of OLD."""
    first: dict[str, Definition] = {}
    for other in module.statements:
        for name in other.names:
            one = first.setdefault(name, other)
            if one in origins and other in origins and origins[one].module is not origins[other].module:
                yield f"{origins[other].place} -> {other.place}: {other.label} hides that at {one.place}"


def _exports(module: Module, commit: Commit) -> Iterator[str]:
    for name, line in module.exported:
        if not (name in module.definitions or name in module.imports or f"{module.name}.{name}" in commit.modules):
            yield f"nowhere -> {module.path}:{line}: __all__ names {name}, which the module does not have"


def _inside(
    one: Definition,
    other: Definition,
    found: dict[Definition, Definition],
    moves: set[tuple[Module, Module]],
    rules: Rules,
) -> Iterator[str]:
    """Yield the differences between two paired definitions: names that denote other objects, and other strings."""
    for a, b in _pairs(one, other, moves):
        places = f"{one.module.path}:{a.line} -> {other.module.path}:{b.line}: {one.label}"
        match a.target, b.target:
            case Definition() as before, Definition() as after:
                partner = found.get(before)
                if partner is not after and not (partner is None and before.label == after.label):
                    yield f"{places} refers to {before.label} at {before.place}, then to that at {after.place}"
            case Module() as start, Module() as end if start.path != end.path and (start, end) not in moves:
                yield f"{places} refers to {start.path}, then to {end.path}"
        if a.literal != b.literal and (a.literal, b.literal) not in (rules.literals or ()):
            yield f"{places} has the string {a.literal!r}, then {b.literal!r}"


def _pairs(one: Definition, other: Definition, moves: set[tuple[Module, Module]]) -> Iterator[tuple[Token, Token]]:
    """Yield pairs of corresponding tokens of two matched definitions.

    The imports of one block are unordered: each imported module is paired with the module that it moved to.
    """
    left = list(other.tokens)
    for at, a in enumerate(one.tokens):
        if a.key.startswith("import module "):
            end = next((k for k in range(at, len(left)) if left[k].key != a.key), len(left))
            fits = [k for k in range(at, end) if _moved(a.target, left[k].target, moves)]
            chosen = fits[0] if fits else at
            left[at], left[chosen] = left[chosen], left[at]
        yield a, left[at]


def _moved(start: object, end: object, moves: set[tuple[Module, Module]]) -> bool:
    return isinstance(start, Module) and isinstance(end, Module) and (start.path == end.path or (start, end) in moves)


def _first(one: Definition, other: Definition) -> str:
    """Return the first place where two definitions differ."""
    if one.module.future != other.module.future:
        where = f"{one.place} -> {other.place}: {one.label}"
        return f"{where} differs: the two modules have different `from __future__` imports"
    end = Token("its end", one.tokens[-1].line), Token("its end", other.tokens[-1].line)
    pairs = zip([*one.tokens, end[0]], [*other.tokens, end[1]], strict=False)
    a, b = next((a, b) for a, b in pairs if a.key != b.key)
    places = f"{one.module.path}:{a.line} -> {other.module.path}:{b.line}"
    return f"{places}: {one.label} differs: old {a.key}, new {b.key}"


def _compared(one: Definition, other: Definition | None, paths: tuple[str, ...]) -> bool:
    return _within_any(one.module.path, paths) or (other is not None and _within_any(other.module.path, paths))


def _within(path: str, folder: str) -> bool:
    return not folder or path == folder or path.startswith(f"{folder.rstrip('/')}/")


def _within_any(path: str, folders: tuple[str, ...]) -> bool:
    return not folders or any(_within(path, folder) for folder in folders)


# Reading of commits and rules


def read_commit(commit: str) -> dict[str, bytes]:
    """Return the Python files of a commit of this repository."""
    if commit.startswith("-"):
        raise Unreadable(f"{commit} is no commit")
    done = subprocess.run(["git", "archive", "--format=tar", commit], capture_output=True)
    if done.returncode:
        raise Unreadable(f"git archive {commit}: {done.stderr.decode(errors='replace').strip()}")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        members = [m for m in archive.getmembers() if m.isfile() and m.name.endswith(".py")]
        return {m.name: archive.extractfile(m).read() for m in members}  # type: ignore[union-attr]


def _lines(path: Path | None) -> Iterator[tuple[str, str]]:
    """Yield the lines of a file that are neither empty nor comments, each with its place."""
    if path is None:
        return
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise Unreadable(f"{path}: {error}") from None
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.startswith("#"):
            yield f"{path}:{number}", line


def read_rules(renames: Path | None, text: Path | None) -> Rules:
    """Read the two files of rules. Raises Unreadable."""
    names: list[tuple[str, str, str]] = []
    for place, line in _lines(renames):
        words = line.split()
        if len(words) not in (2, 3) or not all(word.isidentifier() for word in words[:2]):
            raise Unreadable(f"{place}: expected `OLD_NAME NEW_NAME [PATH]`")
        names.append((words[0], words[1], words[2] if len(words) == 3 else ""))
    literals: set[tuple[str, str]] = set()
    for place, line in _lines(text):
        try:
            pair = json.loads(line)
        except ValueError:
            pair = None
        if not (isinstance(pair, list) and len(pair) == 2 and all(isinstance(each, str) for each in pair)):
            raise Unreadable(f'{place}: expected a JSON list of two strings, as ["old", "new"]')
        literals.add((pair[0], pair[1]))
    return Rules(tuple(names), None if text is None else frozenset(literals))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="same_code.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("old", metavar="OLD", help="a commit")
    parser.add_argument("new", metavar="NEW", help="a commit")
    parser.add_argument("paths", metavar="PATH", nargs="*", help="a file or folder, from the root of the repository")
    parser.add_argument("--renames", metavar="FILE", type=Path, help="names that change")
    parser.add_argument("--text", metavar="FILE", type=Path, help="docstrings and listed strings may change")
    options = parser.parse_intermixed_args(arguments)
    try:
        rules = read_rules(options.renames, options.text)
        old = Commit(read_commit(options.old), rules, old=True)
        new = Commit(read_commit(options.new), rules, old=False)
    except Unreadable as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    count = 0
    for difference in differences(old, new, rules, tuple(options.paths)):
        print(difference)
        count += 1
    print(f"{count} differences" if count else f"the same code: {len(new.statements)} top-level statements")
    return 1 if count else 0


if __name__ == "__main__":
    raise SystemExit(main())
