"""Driver classes, named in the fleet file, that serve a program's other modules: where they are, what they offer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from koordgen.build.emit.program import functions_module
from koordgen.fleet.manifest import Target
from koordgen.fleet.offered import Driver
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import Module, Port, Program

_OURS = ("koordgen", "targets", "program", "__main__")  # in every bundle


def driver_files(drivers: Mapping[str, Driver], program: Program, folders: list[Path]) -> dict[str, Path]:
    """Where each module's driver stands: the first of these folders that has it. Modules that the program does not use
    need none."""
    used = [m.name for m in program.modules if m.name in drivers]
    return {name: find(drivers[name].path, folders) for name in used}


def check_drivers(
    program: Program, drivers: Mapping[str, Driver], files: Mapping[str, Path], targets: tuple[Target, ...]
) -> list[Diagnostic]:
    """One diagnostic for each module or port that its driver cannot serve."""
    used = [m for m in program.modules if m.name in files]
    return [d for m in used for d in _module(m, drivers[m.name], files[m.name], program, targets)]


def own_class(driver: Driver, methods: tuple[str, ...], program: Program, folders: list[Path]) -> str:
    """What is wrong with a class of the user's own that is made with one argument and must have these methods, in
    words; "" for one that fits."""
    file = find(driver.path, folders)
    reason = _unfit(driver, file, program)
    if reason:
        return reason
    from koordgen.build.bundle.probe import Unusable, look

    try:
        found = look(file, _root(driver, file), [driver.name])[driver.name]
    except Unusable as error:
        return f"{driver.path} cannot be imported: {error}"
    if found is None or not found["class"]:
        return f"{driver.path} has no class {driver.name}"
    lacking = [method for method in methods if method not in found["methods"]]
    if lacking:
        return f"the class {driver.name} in {driver.path} has no method {lacking[0]}"
    if found["required"] > 1 or not (found["parameters"] or found["any"]):
        return f"{driver.name} in {driver.path} cannot be made with one argument"
    return ""


def _unfit(driver: Driver, file: Path, program: Program) -> str:
    """Why a file cannot be copied into bundles, in words."""
    if driver.module.split(".")[0] in (*_OURS, functions_module(program)):
        return f"a file of yours cannot be called {driver.path}: every bundle has one of that name"
    if not file.is_file():
        return f"{file}, which should have the class {driver.name}, is not there"
    if not file.resolve().is_relative_to(_root(driver, file).resolve()):
        return f"{file} leads out of its folder: bundles hold copies of what stands beside fleet file or program"
    return ""


def _root(driver: Driver, file: Path) -> Path:
    return Path(str(file)[: -len(driver.path)])


def find(path: str, folders: list[Path]) -> Path:
    """The file of the first folder that has it; else that which is missing in the first."""
    found = (folder / path for folder in folders)
    return next((file for file in found if file.is_file()), folders[0] / path)


def _module(
    module: Module, driver: Driver, file: Path, program: Program, targets: tuple[Target, ...]
) -> Iterator[Diagnostic]:
    own = next((t for t in targets if module.name in t.modules), None)
    if own is not None:
        yield _wrong(module, f"{module.name} is served by target {own.name} itself", "name no driver for it")
        return
    if driver.module.split(".")[0] in (*_OURS, functions_module(program)):
        yield _wrong(module, f"a driver's file cannot be called {driver.path}", "every bundle has a file of that name")
        return
    root = Path(str(file)[: -len(driver.path)])
    if not file.is_file():
        yield _wrong(module, f"{file}, which has the driver of {module.name}, is not there", "")
        return
    if not file.resolve().is_relative_to(root.resolve()):
        yield _wrong(module, f"{file} leads out of its folder", "bundles hold copies of what stands beside them")
        return
    from koordgen.build.bundle.probe import Unusable, look

    try:
        found = look(file, root, [driver.name])[driver.name]
    except Unusable as error:
        help = "the build looks at its ports, so it must be importable on this host as well"
        yield _wrong(module, f"{driver.path} cannot be imported: {error}", help)
        return
    if found is None or not found["class"]:
        yield _wrong(module, f"{driver.path} has no class {driver.name}", "")
        return
    yield from _class(module, driver, found)


def _class(module: Module, driver: Driver, found: dict[str, Any]) -> Iterator[Diagnostic]:
    methods = ["sense", "command", *(["call"] if any(p.direction == "callable" for p in module.ports) else [])]
    for method in methods:
        if method not in found["methods"]:
            yield _wrong(module, f"the class {driver.name} in {driver.path} has no method {method}", "")
    if found["required"]:
        yield _wrong(module, f"{driver.name} in {driver.path} cannot be made without arguments", "")
    for table in ("sensors", "actuators"):
        if found[table] is None:
            yield _wrong(
                module, f"{driver.name}.{table} is no dict of port names to types", 'such as {"temp": "float"}'
            )
            return
    for port in module.ports:
        if port.direction in ("sensor", "actuator"):
            yield from _port(module, port, driver, found)


def _port(module: Module, port: Port, driver: Driver, found: dict[str, Any]) -> Iterator[Diagnostic]:
    offered = found[f"{port.direction}s"]
    name = f"{module.name}.{port.name}"
    type_ = offered.get(port.name)
    if type_ is None:
        there = ", ".join(offered) or "none"
        message = f"the driver {driver.name} offers no {port.direction} {port.name} for {module.name}"
        yield Diagnostic("B005", "error", message, port.span, help=f"its {port.direction}s: {there}")
    elif _plain(type_) != _plain(str(port.type)):
        message = f"{name} is of type {type_} in the driver {driver.name}, not {port.type}"
        yield Diagnostic("B005", "error", message, port.span)


def _plain(type_: str) -> str:
    return type_.replace(" ", "")


def _wrong(module: Module, message: str, help: str) -> Diagnostic:
    return Diagnostic("B005", "error", message, module.span, help=help)
