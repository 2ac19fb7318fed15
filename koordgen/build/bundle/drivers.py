"""Driver classes: the user's Python classes that serve modules which the target does not offer. Finds and checks them.

The fleet file names them under `modules:`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from koordgen.build.emit.program import functions_module
from koordgen.fleet.manifest import Target
from koordgen.fleet.settings import DriverClass
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import Module, Port, Program

_OURS = ("koordgen", "targets", "program", "__main__")  # names of our own modules and packages in every bundle


def driver_files(drivers: Mapping[str, DriverClass], program: Program, folders: list[Path]) -> dict[str, Path]:
    """Return the driver file of each module. If several of `folders` contain the file, the first of them counts.

    Drivers of modules that the program does not use are left out.
    """
    used = [m.name for m in program.modules if m.name in drivers]
    return {name: find(drivers[name].path, folders) for name in used}


def check_drivers(
    program: Program, drivers: Mapping[str, DriverClass], files: Mapping[str, Path], targets: tuple[Target, ...]
) -> list[Diagnostic]:
    """Return a diagnostic for each module or port that its driver cannot serve."""
    used = [m for m in program.modules if m.name in files]
    return [d for m in used for d in _module(m, drivers[m.name], files[m.name], program, targets)]


def own_class(driver: DriverClass, methods: tuple[str, ...], program: Program, folders: list[Path]) -> str:
    """Return a message that says why a user's class does not fit, or "".

    The class must be constructible with one argument and have these methods.
    """
    file = find(driver.path, folders)
    reason = _unfit(driver, file, program)
    if reason:
        return reason
    from koordgen.build.bundle.probe import NotImportable, look

    try:
        found = look(file, _root(driver, file), [driver.name])[driver.name]
    except NotImportable as error:
        return f"{driver.path} cannot be imported: {error}"
    if found is None or not found["class"]:
        return f"{driver.path} has no class {driver.name}"
    missing = [method for method in methods if method not in found["methods"]]
    if missing:
        return f"the class {driver.name} in {driver.path} has no method {missing[0]}"
    if found["required"] > 1 or not (found["parameters"] or found["any"]):
        return f"the class {driver.name} in {driver.path} cannot be constructed with one argument"
    return ""


def _unfit(driver: DriverClass, file: Path, program: Program) -> str:
    """Return a message that says why a file cannot be copied into bundles, or ""."""
    if driver.module.split(".")[0] in (*_OURS, functions_module(program)):
        return f"the file {driver.path} must have another name: every bundle has a file with this name"
    if not file.is_file():
        return f"there is no file {file}, which should have the class {driver.name}"
    if not file.resolve().is_relative_to(_root(driver, file).resolve()):
        return f"{file} links to a file outside of its folder; put the file itself beside the fleet file or the program"
    return ""


def _root(driver: DriverClass, file: Path) -> Path:
    return Path(str(file)[: -len(driver.path)])


def find(path: str, folders: list[Path]) -> Path:
    """Return the file `path` in the first folder that has it. If no folder has it, return its path in the first one."""
    found = (folder / path for folder in folders)
    return next((file for file in found if file.is_file()), folders[0] / path)


def _module(
    module: Module, driver: DriverClass, file: Path, program: Program, targets: tuple[Target, ...]
) -> Iterator[Diagnostic]:
    own = next((t for t in targets if module.name in t.modules), None)
    if own is not None:
        help = f"remove {module.name} from 'modules:' in the fleet file"
        yield _wrong(module, f"{module.name} is a module of target {own.name} and can have no driver", help)
        return
    if driver.module.split(".")[0] in (*_OURS, functions_module(program)):
        help = "rename it, and change 'modules:' in the fleet file: every bundle has a file with this name"
        yield _wrong(module, f"a driver's file cannot have the name {driver.path}", help)
        return
    root = Path(str(file)[: -len(driver.path)])
    if not file.is_file():
        help = "the file is searched in the folder of the fleet file, then in that of the program"
        yield _wrong(module, f"there is no file {file}, which should have the driver of {module.name}", help)
        return
    if not file.resolve().is_relative_to(root.resolve()):
        help = "copy the file into the folder of the fleet file or of the program"
        yield _wrong(module, f"{file} is a link to a file outside of its folder", help)
        return
    from koordgen.build.bundle.probe import NotImportable, look

    try:
        found = look(file, root, [driver.name])[driver.name]
    except NotImportable as error:
        help = "the build imports it to read its ports, so the import must work on this computer as well"
        yield _wrong(module, f"{driver.path} cannot be imported: {error}", help)
        return
    if found is None or not found["class"]:
        help = f"write `class {driver.name}:` there, or name another class under 'modules:' in the fleet file"
        yield _wrong(module, f"{driver.path} has no class {driver.name}", help)
        return
    yield from _class(module, driver, found)


def _class(module: Module, driver: DriverClass, found: dict[str, Any]) -> Iterator[Diagnostic]:
    methods = ["sense", "command", *(["call"] if any(p.direction == "callable" for p in module.ports) else [])]
    for method in methods:
        if method not in found["methods"]:
            message = f"the class {driver.name} in {driver.path} has no method {method}"
            yield _wrong(module, message, f"add `def {method}` to the class")
    if found["required"]:
        message = f"the class {driver.name} in {driver.path} cannot be constructed without arguments"
        yield _wrong(module, message, "give the parameters of `__init__` default values")
    for table in ("sensors", "actuators"):
        if found[table] is None:
            message = f"{driver.name}.{table} must be a dict from names of ports to Koord types"
            yield _wrong(module, message, 'for example {"temp": "float"}')
            return
    for port in module.ports:
        if port.direction in ("sensor", "actuator"):
            yield from _port(module, port, driver, found)


def _port(module: Module, port: Port, driver: DriverClass, found: dict[str, Any]) -> Iterator[Diagnostic]:
    offered = found[f"{port.direction}s"]
    name = f"{module.name}.{port.name}"
    type_ = offered.get(port.name)
    if type_ is None:
        there = ", ".join(offered) or "none"
        message = f"the driver {driver.name} of {module.name} has no {port.direction} {port.name}"
        yield Diagnostic("B005", "error", message, port.span, help=f"it has these {port.direction}s: {there}")
    elif _plain(type_) != _plain(str(port.type)):
        message = f"{name} has type {type_} in the driver {driver.name}, but {port.type} in the program"
        help = f"declare it as {type_}, or change {driver.name}.{port.direction}s"
        yield Diagnostic("B005", "error", message, port.span, help=help)


def _plain(type_: str) -> str:
    return type_.replace(" ", "")


def _wrong(module: Module, message: str, help: str) -> Diagnostic:
    return Diagnostic("B005", "error", message, module.span, help=help)
