"""Inspection of a user's Python file in a child process: its functions and classes, or the error of its import.

Run as a script, this module is the child: it imports one file and writes the result as JSON. So effects of the import
(output, exceptions, exit, an endless loop) do not reach the compiler.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

TIMEOUT = 10.0  # seconds until an import is abandoned
METHODS = ("sense", "command", "call", "plan")  # methods of drivers and planners; the child reports which a class has


class NotImportable(Exception):
    """Raised for a file that cannot be imported. The message gives the reason, without the file's name."""


def look(file: Path, root: Path, names: list[str]) -> dict[str, dict[str, Any] | None]:
    """Return the description (see `_described`) of each of these names in `file`; None for a missing name.

    Dotted imports of the file begin at `root`. Raises NotImportable.
    """
    package = Path(__file__).resolve().parents[3]
    command = [sys.executable, "-B", __file__, str(file), str(root), str(package), *names]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=TIMEOUT)
    except subprocess.TimeoutExpired:
        raise NotImportable(f"its import did not end within {TIMEOUT:.0f} s") from None
    try:
        found = json.loads(done.stdout)
    except ValueError:
        raise NotImportable(f"its import ended the process (status {done.returncode})") from None
    if "error" in found:
        raise NotImportable(found["error"])
    offered: dict[str, dict[str, Any] | None] = found["offers"]
    return offered


def _main(file: str, root: str, package: str, names: list[str]) -> None:
    import importlib.util

    answer = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # output of the file goes to stderr
    sys.path[:1] = [root, package]  # in place of the folder of this script
    spec = importlib.util.spec_from_file_location(Path(file).stem, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their module there
    try:
        spec.loader.exec_module(module)
        found: dict[str, Any] = {"offers": {name: _described(getattr(module, name, None)) for name in names}}
    except BaseException as error:  # the file may raise SystemExit, too
        found = {"error": f"{type(error).__name__}: {error}{_where(error, file)}"}
    json.dump(found, answer)
    answer.close()
    os._exit(0)  # ends at once: threads of the file may still run, and its exit handlers may never end


def _where(error: BaseException, file: str) -> str:
    line, trace = 0, error.__traceback__
    while trace is not None:
        line = trace.tb_lineno if trace.tb_frame.f_code.co_filename == file else line
        trace = trace.tb_next
    return f" (line {line})" if line else ""


def _described(thing: Any) -> dict[str, Any] | None:
    """Describe a function or class as JSON values; None for other objects.

    parameters: names of the positional parameters.
    required: number of parameters without a default; 1000 more for each keyword-only one, which no call can give.
    any: True if it takes any number of positional arguments.
    Classes only: `class` is True; `sensors` and `actuators`, None if not a dict of texts; `methods`, those of METHODS;
    `flaw`, the reason why a value cannot be constructed and packed, or "".
    """
    import inspect

    if not callable(thing):
        return None
    found: dict[str, Any] = {"class": isinstance(thing, type)}
    try:
        parameters = inspect.signature(thing).parameters.values()
    except (ValueError, TypeError):  # a function written in C, whose parameters are unknown
        return {**found, "parameters": [], "required": 0, "any": True}
    by_position = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    found["parameters"] = [p.name for p in by_position]
    keywords = [p for p in parameters if p.kind == p.KEYWORD_ONLY and p.default is p.empty]
    found["required"] = len([p for p in by_position if p.default is p.empty]) + 1000 * len(keywords)
    found["any"] = any(p.kind == p.VAR_POSITIONAL for p in parameters)
    if isinstance(thing, type):
        for table in ("sensors", "actuators"):
            ports = getattr(thing, table, {})
            usable = isinstance(ports, dict) and all(isinstance(x, str) for pair in ports.items() for x in pair)
            found[table] = ports if usable else None
        found["methods"] = [name for name in METHODS if callable(getattr(thing, name, None))]
        found["flaw"] = _flaw(thing)
    return found


def _flaw(cls: type) -> str:
    import importlib

    try:
        packing: Any = importlib.import_module("msgspec.msgpack")
    except ModuleNotFoundError:  # on a computer that only builds bundles, msgspec may be missing
        return ""
    try:
        packing.decode(packing.encode(cls()), type=cls)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


if __name__ == "__main__":
    _main(sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:])
