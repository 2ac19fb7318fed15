"""Architecture: rooms import downwards only, checked on the syntax trees."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "koordgen"
TARGETS_FOLDER = ROOT / "targets"
TARGETS = sorted(p.parent for p in (ROOT / "targets").glob("*/manifest.toml"))

# Rooms of each folder, from bottom to top: a room may import those before it. "." are the folder's own modules.
LAYERS = {
    "koordgen": ("runtime", "lang", "fleet", "build", "verify", "experiment", "operate", "cli", "."),
    "koordgen.runtime": (
        *("values", "config", "program", "native", "net", "replication", "vehicle", "trace", "monitor", "ops", "agent"),
    ),
    "koordgen.lang": (".", "explain", "syntax", "ir", "semantics", "check", "analyze", "format"),
    "koordgen.lang.syntax": ("_generated", "."),
    "koordgen.lang.check": (".", "expressions", "statements", "sections"),
    "koordgen.lang.analyze": ("facts", "rules", "."),
    "koordgen.build": ("emit", "bundle", "."),
    "koordgen.build.emit": ("_generated", "."),
    "koordgen.build.emit._generated": (".", "templates"),
    "koordgen.verify": ("replay", "prove", "follow", "explore", "audit", "attack"),
    "koordgen.verify.explore": (".", "system"),
    "koordgen.verify.prove": ("smt", "encode", "obligations", "report"),
    "koordgen.experiment": ("campaign", "validate"),
    "koordgen.operate": ("host_tool", "."),
    "koordgen.cli": ("base", "verify", "experiment", "operate", "."),
    "targets": ("mavlink", "planning", "quad", "car", "sim"),
    "targets.quad": ("autopilot", "motion", "platform"),
    "targets.car": ("base", "planning", "control", "drive", "platform"),
    "targets.car.control": ("solver", "."),
    "targets.sim": (
        *("base", "physics", "sensing", "autopilots", "trace", "run", "judging", "realtime", "lockstep", "follow"),
        *("view", "."),
    ),
    "targets.sim.view": ("data", "pictures", "foxglove", "web", "."),
}
# Of the rooms of robots, those that each room of the compiler uses.
RUNTIME = {
    "lang": {"values", "program"},
    "fleet": set(),
    "build": set(),
    "verify": {"values", "program", "trace", "config", "agent"},  # agent: records of outer robots in traces
    "experiment": {"ops"},
    "operate": {"values", "config", "net", "vehicle", "ops", "trace"},
    "cli": {"ops", "net", "trace"},
}
HOST_TOOL = PACKAGE / "operate" / "host_tool"  # becomes a package of its own on robots, so its imports are relative
MOST_MODULES = 20  # in a folder, without its __init__
HEAVY = {
    "pybullet",
    "mujoco",
    "casadi",
    "ompl",
    "pymavlink",
    "z3",
    "cvc5",
    "numpy",
    "matplotlib",
    "serial",
    "msgspec",
    "motioncapture",
    "distributed",
}


@cache
def imports(path: Path) -> tuple[str, ...]:
    """Return every module that a file imports, also inside functions."""
    return tuple(_imports(path))


def _imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level <= (path.parent == HOST_TOOL), f"{path}: relative import"
            module = node.module or ""
            if node.level:
                module = f"koordgen.operate.host_tool.{module}".rstrip(".")
            yield from (f"{module}.{alias.name}" for alias in node.names)


SOURCES = sorted([*PACKAGE.rglob("*.py"), *TARGETS_FOLDER.rglob("*.py")])
MODULES = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in SOURCES}


def imported_modules(path: Path) -> set[str]:
    """Return the modules of this repository that a file imports, without their packages."""
    found = set()
    for name in imports(path):
        while name and name not in MODULES:
            name = name.rpartition(".")[0]
        found.add(name)
    return {name for name in found if name and MODULES[name] != path}


def room(module: str) -> str:
    """Return the folder of a module, as a dotted name."""
    return module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the nodes on cycles: nodes without a predecessor or successor are removed until none is left."""
    left = {node: {other for other in others if other != node} for node, others in graph.items()}
    while True:
        reached = set().union(*left.values()) if left else set()
        kept = {node: others & left.keys() for node, others in left.items() if others & left.keys() and node in reached}
        if kept == left:
            return [sorted(left)] if left else []
        left = kept


@pytest.mark.parametrize("module", sorted(MODULES))
def test_rooms_import_downwards(module: str) -> None:
    for other in imported_modules(MODULES[module]):
        if "." not in other or other.split(".")[0] != module.split(".")[0]:
            continue  # the version, or one of the runtime's modules in a target
        own, its = [*room(module).split("."), "."], [*room(other).split("."), "."]
        level = next((i for i, (a, b) in enumerate(zip(own, its, strict=False)) if a != b), None)
        if level is None:
            continue
        folder = ".".join(own[:level])
        order = LAYERS[folder]
        assert order.index(its[level]) < order.index(own[level]), f"{module} imports {other}: see LAYERS[{folder!r}]"
        if own[0] == "koordgen" and own[1] in RUNTIME and its[1] == "runtime":
            assert its[2] in RUNTIME[own[1]], f"{module} imports {other}: see RUNTIME"


def test_no_modules_import_one_another() -> None:
    assert not cycles({module: imported_modules(path) for module, path in MODULES.items()})


def test_no_rooms_import_one_another() -> None:
    """The package's __init__ has only the version, and __main__ only calls the command line."""
    graph: dict[str, set[str]] = {}
    for module, path in MODULES.items():
        if module not in ("koordgen", "koordgen.__main__"):
            graph.setdefault(room(module), set()).update(map(room, imported_modules(path) - {"koordgen"}))
    assert not cycles(graph)


def test_cycles_are_found() -> None:
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == [["b", "c"]]
    assert not cycles({"a": {"b", "c"}, "b": {"c"}, "c": set()})


def test_folders_hold_few_modules() -> None:
    entries = {path.relative_to(PACKAGE).parts[0] for path in PACKAGE.rglob("*.py")}
    assert len(entries - {"_data"}) <= 10, sorted(entries)
    for top in (PACKAGE, TARGETS_FOLDER, ROOT / "tests"):
        for folder in [top, *(p for p in top.rglob("*") if p.is_dir())]:
            count = len([path for path in folder.glob("*.py") if path.name != "__init__.py"])
            assert count <= MOST_MODULES, f"{folder.relative_to(ROOT)} has {count} modules"


def test_each_room_says_what_it_is() -> None:
    """Each says what it owns, what it offers, and what it must not import."""
    for path in SOURCES:
        if (
            path.name == "__init__.py"
            and "_generated" not in path.parts
            and path.parent not in (PACKAGE, TARGETS_FOLDER)
        ):
            doc = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            missing = [word for word in ("Owns: ", "Offers: ", "Must not import: ") if word not in doc]
            assert not missing, f"{path.relative_to(ROOT)} does not say: {missing}"


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_the_compiler_needs_no_robot_package(path: Path) -> None:
    allowed = {"msgspec"} if path.is_relative_to(PACKAGE / "runtime") else set()
    if path.name == "basestation.py":
        allowed = {"motioncapture"}  # within the function that connects
    if path.name == "cvc5_driver.py":
        allowed = {"cvc5"}  # a process of its own
    if path.relative_to(PACKAGE).as_posix() == "verify/audit/plot.py":  # within the function that draws
        allowed = {"matplotlib"}
    if path.parent.name == "campaign":  # within the functions that draw, and that connect to a cluster
        allowed = {"plots.py": {"matplotlib"}, "executor.py": {"distributed"}}.get(path.name, set())
    if path.parent.name == "validate":  # it needs the simulator's packages anyway
        allowed = {"numpy", "matplotlib"}
    assert {m.split(".")[0] for m in imports(path)} & HEAVY <= allowed


def test_what_is_found_can_be_told_without_any_package() -> None:
    code = "import sys; sys.modules['msgspec'] = None; import koordgen.runtime.ops.checks"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_the_runtime_is_an_island() -> None:
    for path in (PACKAGE / "runtime").rglob("*.py"):
        for module in imports(path):
            top = module.split(".")[0]
            own = module.startswith("koordgen.runtime") or top in sys.stdlib_module_names or top == "msgspec"
            chosen = (path.name, top) == ("zenoh_transport.py", "zenoh")  # loaded when the settings ask for it
            assert own or chosen, f"{path.name} imports {module}"


def test_the_host_tool_is_an_island() -> None:
    """It runs with any Python of 3.10 or later that a robot has."""
    for path in HOST_TOOL.glob("*.py"):
        ast.parse(path.read_text(encoding="utf-8"), feature_version=(3, 10))
        for module in imports(path):
            own = module.startswith("koordgen.operate.host_tool")
            assert own or module.split(".")[0] in sys.stdlib_module_names, f"{path.name} imports {module}"


def files_of(module: str) -> Iterator[Path]:
    """Return the files of this repository that run when a module, or a name of a module, is imported."""
    place = ROOT
    for part in module.split("."):
        place /= part
        yield from (file for file in (place / "__init__.py", place.with_suffix(".py")) if file.is_file())


def test_benchmarks_need_no_test() -> None:
    """Benchmarks run where neither pytest nor hypothesis is installed. Tests import shared code from them."""
    reached = dict.fromkeys(sorted((ROOT / "benchmarks").rglob("*.py")), "")
    waiting = list(reached)
    while waiting:
        path = waiting.pop()
        for module in imports(path):
            chain = f"{reached[path]}{path.relative_to(ROOT)} imports "
            assert module.split(".")[0] not in {"tests", "pytest", "hypothesis"}, chain + module
            for file in files_of(module):
                if file not in reached:
                    reached[file] = chain
                    waiting.append(file)
    assert ROOT / "targets" / "planning" / "rrt.py" in reached  # imports are followed


@pytest.mark.parametrize("folder", TARGETS, ids=lambda p: p.name)
def test_a_target_stands_on_the_runtime_and_itself_alone(folder: Path) -> None:
    also = tomllib.loads((folder / "manifest.toml").read_text()).get("also", [])
    own = tuple(f"targets.{name}" for name in (folder.name, *also))
    for path in folder.rglob("*.py"):
        for module in imports(path):
            if module.split(".")[0] in ("koordgen", "targets"):
                assert module.startswith(("koordgen.runtime", *own)), f"{path} imports {module}"


def test_no_targets_name_occurs_in_the_compiler() -> None:
    names = re.compile(rf"""["']({"|".join(t.name for t in TARGETS)})["']""")
    for path in PACKAGE.rglob("*.py"):
        if path.parent.name != "templates":
            found = names.search(path.read_text(encoding="utf-8"))
            assert not found, f"{path}: {found}"


FIELDS = re.compile(r"__match_args__|__dataclass_fields__|koordgen\.lang\.node import .*\bnodes\b")
# Nodes in general; syntax trees, which are compared, shown and measured by all their fields; a class that is no node.
GO_THROUGH_FIELDS = {
    *("lang/node.py", "lang/syntax/walk.py", "lang/format/__init__.py", "lang/syntax/lr.py", "lang/syntax/printer.py"),
    "operate/installed.py",
}


def test_one_module_goes_through_trees_of_the_ir() -> None:
    for path in PACKAGE.rglob("*.py"):
        name = path.relative_to(PACKAGE).as_posix()
        if not name.startswith("lang/ir/") and FIELDS.search(path.read_text(encoding="utf-8")):
            assert name in GO_THROUGH_FIELDS, f"{name}: go through trees of the IR by koordgen.lang.ir.tree"


def test_tools_overwrite_nothing_private_of_other_objects() -> None:
    for path in (PACKAGE / "verify").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and node.attr.startswith("_"):
                own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
                assert own and node.attr != "__class__", f"{path.relative_to(ROOT)}:{node.lineno} writes {node.attr}"


def test_functions_and_templates_keep_to_their_size() -> None:
    for path in [*PACKAGE.rglob("*.py"), *(ROOT / "targets").rglob("*.py")]:
        if "_generated" in path.parts:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                assert (node.end_lineno or 0) - node.lineno <= 60, f"{path}: {node.name}"
    for path in (ROOT / "templates").glob("*.j2"):
        assert path.read_text(encoding="utf-8").count("\n") <= 80, path


@pytest.mark.parametrize(
    "generator",
    [
        "koordgen.lang.syntax.generate",
        "koordgen.lang.syntax.page",
        "koordgen.build.emit.generate",
        "tools.generate_solver",
    ],
)
def test_what_is_generated_is_fresh(generator: str) -> None:
    subprocess.run([sys.executable, "-m", generator, "--check"], cwd=ROOT, check=True)


def test_every_file_of_tests_is_collected(pytestconfig: pytest.Config) -> None:
    left_out = pytestconfig.getini("norecursedirs")
    folders = {path.parent.relative_to(ROOT) for path in (ROOT / "tests").rglob("test_*.py")}
    assert Path("tests/build/emit") in folders
    assert [f for f in folders for part in f.parts if any(fnmatch(part, pattern) for pattern in left_out)] == []
