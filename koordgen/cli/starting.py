"""`koordgen new` and `koordgen examples`: write files for a start, and never overwrite a file."""

from __future__ import annotations

import os
import re
import textwrap
from argparse import Namespace
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path

from koordgen.cli.base import console
from koordgen.lang import resources

LONGEST = 40  # characters of a program's name
_KINDS = (".koord", ".yaml", ".py", ".md")  # files of an example; others were written by running it
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def new(options: Namespace) -> int:
    """Write a folder with a program and a fleet file, and print the next commands. Raises Failure."""
    name = options.name
    if not _NAME.fullmatch(name) or len(name) > LONGEST:
        _refuse_name(name)
    folder = Path(name)
    try:
        if folder.exists() and any(folder.iterdir()):
            help = "nothing was written; choose another name"
            raise console.Failure(console.SURROUNDINGS, f"the folder {name} is not empty", help)
    except OSError as error:
        raise console.Failure(console.SURROUNDINGS, f"{name}: {error.strerror}", "choose another name") from None
    starter = resources.templates() / "new"
    program, fleet = folder / f"{name}.koord", folder / "fleet.yaml"
    _write({program: (starter / "program.koord").read_bytes(), fleet: (starter / "fleet.yaml").read_bytes()})
    print(_next_steps(program, fleet))
    return console.HOLDS


def examples(options: Namespace) -> int:
    """List the examples, or copy one. Raises Failure."""
    there = {path.parent.name: path.parent for path in sorted(resources.examples().glob("*/README.md"))}
    if options.action is None:
        print(_listing(there))
        return console.HOLDS
    if options.name not in there:
        near = get_close_matches(options.name or "", there, 1)
        help = f"did you mean {near[0]}? " if near else "for example `koordgen examples copy lineform`; "
        what = f"no example {options.name!r}" if options.name else "the name of the example is missing"
        raise console.Failure(console.USAGE, what, f"{help}`koordgen examples` lists all examples")
    usual = f"examples/{options.name}"
    folder = Path(options.folder or usual)
    files = {path.name: path.read_bytes() for path in there[options.name].iterdir() if path.suffix in _KINDS}
    # Commands in README.md contain the default folder.
    files["README.md"] = files["README.md"].replace(f"{usual}/".encode(), f"{folder.as_posix()}/".encode())
    _write({folder / name: data for name, data in files.items()})
    print(f"{folder}: {len(files)} files; {folder / 'README.md'} says how to run the example")
    return console.HOLDS


def _refuse_name(name: str) -> None:
    """Raise Failure for a name that is not allowed. The help proposes a similar name that is."""
    proposed = re.sub(r"[^A-Za-z0-9_]", "_", Path(name).name.encode("ascii", "ignore").decode()).strip("_")
    proposed = f"app_{proposed}" if proposed[:1].isdigit() else proposed
    fits = _NAME.fullmatch(proposed) and len(proposed) <= LONGEST
    rule = f"use at most {LONGEST} letters, digits and _, and begin with a letter"
    help = f"{rule}: for example `koordgen new {proposed}`" if fits else rule
    raise console.Failure(console.USAGE, f"{name!r} cannot be a program's name", help)


def _next_steps(program: Path, fleet: Path) -> str:
    app = program.as_posix()
    with_fleet = f"{app} --fleet {fleet.as_posix()}"
    commands = {
        f"check {app}": "find errors in the program",
        f"prove {app}": "prove its invariants (needs koordgen[prove])",
        f"build {with_fleet}": "write a folder for each robot",
        f"sim {with_fleet} --lockstep --out {fleet.parent / 'run'}": "simulate the fleet (needs koordgen[sim])",
    }
    width = max(map(len, commands))
    return "\n".join(
        [
            f"{app}: a program for a fleet, with comments; read it first",
            f"{fleet.as_posix()}: two quads and a car that run it",
            "",
            *(f"  koordgen {command:{width}}  # {what}" for command, what in commands.items()),
        ]
    )


def _listing(there: Mapping[str, Path]) -> str:
    width = max(map(len, there)) + 4
    lines = ["`koordgen examples copy NAME` copies an example to examples/NAME, or to FOLDER: `copy NAME FOLDER`", ""]
    for name, folder in there.items():
        wrapper = textwrap.TextWrapper(100, initial_indent=f"  {name:{width - 2}}", subsequent_indent=" " * width)
        lines += wrapper.wrap(_summary((folder / "README.md").read_text(encoding="utf-8")))
    return "\n".join(lines)


def _summary(page: str) -> str:
    """Return the first sentence of a page."""
    paragraph = page.split("\n\n")[1]
    return " ".join(paragraph.split()).partition(". ")[0]


def _write(files: Mapping[Path, bytes]) -> None:
    """Write all files, or none if one of them already exists. Raises Failure."""
    standing = [path for path in files if os.path.lexists(path)]
    if standing:
        help = "nothing was written; choose another folder, or move these files away"
        raise console.Failure(console.SURROUNDINGS, f"{', '.join(map(str, standing))}: already there", help)
    try:
        for path, data in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as file:
                file.write(data)
    except OSError as error:
        raise console.Failure(console.SURROUNDINGS, f"{error.filename}: {error.strerror}") from None
