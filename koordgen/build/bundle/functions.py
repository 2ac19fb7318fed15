"""Functions file: the user's Python file with the extern functions and types of a program. Finds and checks it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from koordgen.build.emit.program import functions_module
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import ExternFunction, ExternTypeDef, Program
from koordgen.lang.source import Span


def functions_file(program: Program, folder: Path, given: str | None) -> Path | None:
    """Return the functions file: `given`, or `<app>_functions.py` in the program's folder.

    Return None if the program needs no such file.
    """
    if not program.externs and not program.extern_types:
        return None
    return Path(given) if given else folder / f"{functions_module(program)}.py"


def check_functions(program: Program, file: Path | None, is_named: bool = False) -> list[Diagnostic]:
    """Return a diagnostic for each extern function or type that is missing in the file or does not fit.

    `is_named`: a fleet file names the program, so the command line cannot name another functions file.
    """
    if file is None:
        return []
    needs: tuple[ExternFunction | ExternTypeDef, ...] = (*program.externs, *program.extern_types)
    first = min(needs, key=lambda need: need.span.line).span
    if not file.is_file():
        help = f"write it in the folder of {program.path}"
        help += "" if is_named else ", or name another file with --functions"
        return [_wrong(f"there is no file {file}, which should have the extern functions", first, help)]
    from koordgen.build.bundle.probe import NotImportable, look

    try:
        offered = look(file, file.parent, [need.name for need in needs])
    except NotImportable as error:
        help = "the build imports it to check its functions, so the import must work on this computer as well"
        return [_wrong(f"{file.name} cannot be imported: {error}", first, help)]
    return [d for need in needs for d in _check(need, offered[need.name], file.name)]


def _check(need: ExternFunction | ExternTypeDef, found: dict[str, Any] | None, file: str) -> Iterator[Diagnostic]:
    if isinstance(need, ExternTypeDef):
        if found is None or not found["class"]:
            help = f"write `class {need.name}:`, a dataclass or msgspec.Struct whose fields all have default values"
            yield _wrong(f"{file} has no class {need.name}", need.span, help)
        elif found["flaw"]:
            help = "write it as a dataclass or msgspec.Struct whose fields all have default values"
            message = f"the class {need.name} in {file} cannot be an extern type: {found['flaw']}"
            yield _wrong(message, need.span, help)
        return
    wanted = [parameter.name for parameter in need.parameters]
    form = f"def {need.name}({', '.join(map(_python, wanted))})"
    if found is None or found["class"]:
        yield _wrong(f"{file} has no function {need.name}", need.span, f"write `{form}:` in {file}")
        return
    names = found["parameters"][: len(wanted)]
    fits = found["any"] or (len(names) == len(wanted) and found["required"] <= len(wanted))
    if not fits or any(a.rstrip("_") != b.rstrip("_") for a, b in zip(names, wanted, strict=False)):
        taken = ", ".join(found["parameters"])
        message = f"{need.name} has the parameters ({taken}) in {file}, but ({', '.join(wanted)}) in the program"
        yield _wrong(message, need.span, f"write `{form}:` in {file}")


def _python(name: str) -> str:
    from keyword import iskeyword

    return f"{name}_" if iskeyword(name) else name


def _wrong(message: str, span: Span, help: str) -> Diagnostic:
    return Diagnostic("B006", "error", message, span, help=help)
