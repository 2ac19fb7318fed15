"""The Python beside a program: where it is, and whether it has the extern functions and types that are declared."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from koordgen.build.emit.program import functions_module
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import ExternFunction, ExternType, Program
from koordgen.lang.source import Span


def functions_file(program: Program, folder: Path, given: str | None) -> Path | None:
    """The file of a program's extern functions: the one that was named, or else `<app>_functions.py` beside it; None
    when the program needs none."""
    if not program.externs and not program.extern_types:
        return None
    return Path(given) if given else folder / f"{functions_module(program)}.py"


def check_functions(program: Program, file: Path | None) -> list[Diagnostic]:
    """One diagnostic for each extern function or type that the file lacks or has in another form."""
    if file is None:
        return []
    needs: tuple[ExternFunction | ExternType, ...] = (*program.externs, *program.extern_types)
    first = min(needs, key=lambda need: need.span.line).span
    if not file.is_file():
        help = f"write it beside {program.path}, or name another file with --functions"
        return [_wrong(f"{file}, which has the extern functions, is not there", first, help)]
    from koordgen.build.bundle.probe import Unusable, look

    try:
        offered = look(file, file.parent, [need.name for need in needs])
    except Unusable as error:
        help = "the build looks at its functions, so it must be importable on this host as well"
        return [_wrong(f"{file.name} cannot be imported: {error}", first, help)]
    return [d for need in needs for d in _check(need, offered[need.name], file.name)]


def _check(need: ExternFunction | ExternType, found: dict[str, Any] | None, file: str) -> Iterator[Diagnostic]:
    if isinstance(need, ExternType):
        if found is None or not found["class"]:
            help = f"write a dataclass or msgspec.Struct `class {need.name}:` whose fields all have defaults"
            yield _wrong(f"{file} has no class {need.name}", need.span, help)
        elif found["flaw"]:
            help = "a dataclass or msgspec.Struct is wanted that can be made without arguments"
            yield _wrong(f"the class {need.name} in {file} serves no extern type: {found['flaw']}", need.span, help)
        return
    wanted = [parameter.name for parameter in need.parameters]
    form = f"def {need.name}({', '.join(map(_python, wanted))})"
    if found is None or found["class"]:
        yield _wrong(f"{file} has no function {need.name}", need.span, f"write `{form}:` there")
        return
    names = found["parameters"][: len(wanted)]
    fits = found["any"] or (len(names) == len(wanted) and found["required"] <= len(wanted))
    if not fits or any(a.rstrip("_") != b.rstrip("_") for a, b in zip(names, wanted, strict=False)):
        taken = ", ".join(found["parameters"])
        yield _wrong(
            f"{need.name} takes ({taken}) in {file}, not ({', '.join(wanted)})", need.span, f"write `{form}:` there"
        )


def _python(name: str) -> str:
    from keyword import iskeyword

    return f"{name}_" if iskeyword(name) else name


def _wrong(message: str, span: Span, help: str) -> Diagnostic:
    return Diagnostic("B006", "error", message, span, help=help)
