"""`koordgen new` and `koordgen examples`: files to begin with, never written over files that are there."""

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
_KINDS = (".koord", ".yaml", ".py", ".md")  # what an example consists of, beside what running it has left
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def new(options: Namespace) -> int:
    """Write a folder with a program and a fleet file, and say what can be done with them. Raises Failure."""
    name = options.name
    if not _NAME.fullmatch(name) or len(name) > LONGEST:
        _refuse_name(name)
    folder = Path(name)
    try:
        if folder.exists() and any(folder.iterdir()):
            raise console.Failure(console.SURROUNDINGS, f"the folder {name} is not empty", "choose another name")
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
        what = f"no example {options.name!r}" if options.name else "which example is to be copied?"
        raise console.Failure(console.USAGE, what, f"{help}`koordgen examples` lists all examples")
    usual = f"examples/{options.name}"
    folder = Path(options.folder or usual)
    files = {path.name: path.read_bytes() for path in there[options.name].iterdir() if path.suffix in _KINDS}
    # The page's commands name the files in their usual place.
    files["README.md"] = files["README.md"].replace(f"{usual}/".encode(), f"{folder.as_posix()}/".encode())
    _write({folder / name: data for name, data in files.items()})
    print(f"{folder}: {len(files)} files; its page, {folder / 'README.md'}, says how to run it")
    return console.HOLDS


def _refuse_name(name: str) -> None:
    """Raises Failure; a name that fits is proposed where one is near."""
    proposed = re.sub(r"[^A-Za-z0-9_]", "_", Path(name).name.encode("ascii", "ignore").decode()).strip("_")
    proposed = f"app_{proposed}" if proposed[:1].isdigit() else proposed
    fits = _NAME.fullmatch(proposed) and len(proposed) <= LONGEST
    rule = f"use letters, digits and _, at most {LONGEST} of them, and begin with a letter"
    help = f"{rule}: for example `koordgen new {proposed}`" if fits else rule
    raise console.Failure(console.USAGE, f"{name!r} cannot be a program's name", help)


def _next_steps(program: Path, fleet: Path) -> str:
    app = program.as_posix()
    with_fleet = f"{app} --fleet {fleet.as_posix()}"
    commands = {
        f"check {app}": "finds mistakes",
        f"prove {app}": "proves its invariants (extra: prove)",
        f"build {with_fleet}": "writes a folder for each robot",
        f"sim {with_fleet} --lockstep --out {fleet.parent / 'run'}": "simulates (extra: sim)",
    }
    width = max(map(len, commands))
    return "\n".join(
        [
            f"{app}: a program for a fleet; read it first",
            f"{fleet.as_posix()}: two quads and a car that run it",
            "",
            *(f"  koordgen {command:{width}}  # {what}" for command, what in commands.items()),
        ]
    )


def _listing(there: Mapping[str, Path]) -> str:
    width = max(map(len, there)) + 4
    lines = ["`koordgen examples copy NAME` copies one to examples/NAME, `... copy NAME FOLDER` elsewhere:", ""]
    for name, folder in there.items():
        wrapper = textwrap.TextWrapper(100, initial_indent=f"  {name:{width - 2}}", subsequent_indent=" " * width)
        lines += wrapper.wrap(_summary((folder / "README.md").read_text(encoding="utf-8")))
    return "\n".join(lines)


def _summary(page: str) -> str:
    """The first sentence of a page."""
    paragraph = page.split("\n\n")[1]
    return " ".join(paragraph.split()).partition(". ")[0]


def _write(files: Mapping[Path, bytes]) -> None:
    """Write all files, or none when one of them is there already. Raises Failure."""
    standing = [path for path in files if os.path.lexists(path)]
    if standing:
        help = "nothing was written; choose another folder, or move what is there"
        raise console.Failure(console.SURROUNDINGS, f"{', '.join(map(str, standing))}: there already", help)
    try:
        for path, data in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as file:
                file.write(data)
    except OSError as error:
        raise console.Failure(console.SURROUNDINGS, f"{error.filename}: {error.strerror}") from None
