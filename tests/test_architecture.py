"""The house's floors: who may import whom, held by walking the imports."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "koordgen"
TARGETS = sorted(p.parent for p in (ROOT / "targets").glob("*/manifest.toml"))

# A module may import from its own floor and from those named here, nothing else of koordgen.
BASE = {"node", "source", "diagnostics", "resources", "__init__"}
FLOORS = {
    "node": set(),
    "source": {"node"},
    "diagnostics": {"node", "source"},
    "resources": set(),
    "yaml_mistakes": set(),
    "located": {"node", "source", "yaml_mistakes"},
    "explain": {"node", "diagnostics"},
    "sarif": BASE | {"explain"},
    "syntax": BASE,
    "ir": BASE,
    "check": BASE | {"syntax", "ir", "semantics"},  # which evaluates first values
    "format": BASE | {"syntax"},
    "semantics": BASE | {"ir", "runtime"},  # the robots' own values and geometry
    "emit": BASE | {"ir"},
    "prove": BASE | {"ir", "check", "semantics", "runtime"},
    "verify": BASE | {"ir", "check", "semantics", "prove", "runtime"},
    "manifest": {"node", "resources"},
    "mocap": {"node", "located"},
    "deployment": {"node", "located"},
    "mesh": {"node"},
    "obstacles": BASE | {"located", "mesh"},
    "medium": BASE | {"located"},
    "offered": {"node", "located", "manifest"},
    "robots": {"node", "located", "deployment", "manifest", "offered"},
    "world": {"node", "located", "obstacles", "offered"},
    "starts": {"node", "located", "manifest", "obstacles", "robots", "world"},
    "fleet": BASE
    | {"located", "deployment", "manifest", "medium", "obstacles", "mocap", "offered", "robots", "starts", "world"},
    "bundle": BASE | {"ir", "emit", "manifest", "medium", "fleet", "offered", "robots"},
    "estop": BASE | {"fleet", "robots", "runtime"},  # what people and agents say to one another
    "operate": BASE
    | {
        "audit",
        "bundle",
        "check",
        "deployment",
        "emit",
        "estop",
        "fleet",
        "ir",
        "pipeline",
        "replay",
        "robots",
        "runtime",
    },
    "basestation": BASE | {"fleet", "manifest", "mocap", "robots", "runtime"},
    "doctor": BASE,
    "campaign": BASE | {"runtime"},  # how to install a package
    "replay": BASE | {"ir", "emit", "semantics", "runtime"},
    "validate": BASE | {"syntax", "ir", "check", "prove", "campaign", "manifest", "bundle", "fleet", "pipeline"},
    "audit": BASE | {"ir", "emit", "semantics", "prove", "replay", "runtime"},
    "follow": BASE | {"ir", "semantics", "replay"},
    "explore": BASE | {"ir", "check", "located", "emit", "semantics", "prove", "replay", "runtime"},
    "pipeline": BASE | {"syntax", "ir", "check", "emit", "manifest", "fleet", "offered", "bundle"},
    "scenario": {"node", "source", "located"},
    "cli": BASE
    | {
        "runtime",  # which knows whether a requirement is for this computer
        "scenario",
        "pipeline",
        "bundle",
        "check",
        "ir",
        "prove",
        "verify",
        "manifest",
        "explain",
        "sarif",
        "format",
        "estop",
        "fleet",
        "operate",
        "basestation",
        "doctor",
        "campaign",
        "replay",
        "follow",
        "explore",
        "audit",
        "semantics",
        "validate",
        "emit",
    },
    "__main__": {"cli"},
    "__init__": set(),
    "runtime": set(),
    "_generated": set(),
}
HOST_TOOL = PACKAGE / "operate" / "host_tool"  # becomes a package of its own on robots, so its imports are relative
GENERATED_READERS = {"syntax": "koordgen._generated.grammar"}
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
    """Every module that a file imports, also inside functions."""
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


def floor(module: str) -> str:
    return [*module.split("."), "__init__"][1]


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_floors_are_one_way(path: Path) -> None:
    own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    assert own in FLOORS, f"{own} is a new room: give it a floor here and in ARCHITECTURE.md"
    for module in imports(path):
        if module.split(".")[0] == "koordgen":
            other = floor(module)
            if module.startswith(GENERATED_READERS.get(own, "\0")) or other == "__version__":
                continue
            assert other == own or other in FLOORS[own], f"{path.name} imports {module}"


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_the_compiler_needs_no_robot_package(path: Path) -> None:
    allowed = {"msgspec"} if path.is_relative_to(PACKAGE / "runtime") else set()
    if path.name == "basestation.py":
        allowed = {"motioncapture"}  # within the function that connects
    if path.name == "cvc5_driver.py":
        allowed = {"cvc5"}  # a process of its own
    if path.relative_to(PACKAGE).as_posix() == "audit/plot.py":  # within the function that draws
        allowed = {"matplotlib"}
    if path.parent.name == "campaign":  # within the functions that draw, and that connect to a cluster
        allowed = {"plots.py": {"matplotlib"}, "crew.py": {"distributed"}}.get(path.name, set())
    if path.parent.name == "validate":  # it needs the simulator's packages anyway
        allowed = {"numpy", "matplotlib"}
    assert {m.split(".")[0] for m in imports(path)} & HEAVY <= allowed


def test_what_is_found_can_be_told_without_any_package() -> None:
    code = "import sys; sys.modules['msgspec'] = None; import koordgen.runtime.ops.findings"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_the_runtime_is_an_island() -> None:
    for path in (PACKAGE / "runtime").rglob("*.py"):
        for module in imports(path):
            top = module.split(".")[0]
            own = module.startswith("koordgen.runtime") or top in sys.stdlib_module_names or top == "msgspec"
            chosen = (path.name, top) == ("zenoh_transport.py", "zenoh")  # loaded when the settings ask for it
            assert own or chosen, f"{path.name} imports {module}"


def test_the_host_tool_is_an_island() -> None:
    """It runs with whatever Python of 3.10 or later a robot has."""
    for path in HOST_TOOL.glob("*.py"):
        ast.parse(path.read_text(encoding="utf-8"), feature_version=(3, 10))
        for module in imports(path):
            own = module.startswith("koordgen.operate.host_tool")
            assert own or module.split(".")[0] in sys.stdlib_module_names, f"{path.name} imports {module}"


def files_of(module: str) -> Iterator[Path]:
    """The files of this repository that importing a module, or a name of a module, executes."""
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
    ["koordgen.syntax.generate", "koordgen.syntax.page", "koordgen.emit.generate", "targets.car.solver.generate"],
)
def test_what_is_generated_is_fresh(generator: str) -> None:
    subprocess.run([sys.executable, "-m", generator, "--check"], cwd=ROOT, check=True)
