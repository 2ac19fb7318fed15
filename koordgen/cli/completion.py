"""`koordgen completion`: a script for bash, zsh or fish that completes commands, options and files.

The package shtab generates the script from the parsers of the commands. The script runs without Python.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

from koordgen.cli.base.console import HOLDS, SURROUNDINGS, Failure
from koordgen.cli.base.parser import Parser
from koordgen.cli.commands import COMMANDS, command_of, harnesses

_FOLDERS = {"DIR", "BUNDLE"}
_FILES = {"FILE", "APP.koord", "FLEET", "TRACE", "PATH"}


def completion(options: argparse.Namespace) -> int:
    """Print the completion script of a shell. Raises Failure."""
    try:
        import shtab
    except ModuleNotFoundError:
        help = f"{sys.executable} -m pip install shtab"
        raise Failure(SURROUNDINGS, "the package shtab is missing", help) from None
    print(shtab.complete(_all_commands(shtab), shell=options.shell))
    return HOLDS


def _all_commands(shtab: Any) -> argparse.ArgumentParser:
    """Return a parser with all commands; arguments that are files or folders have shtab's marks."""
    parser = argparse.ArgumentParser("koordgen", description="fleets of robots")
    parser.add_argument("-V", "--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(parser_class=_parser)  # type: ignore[call-overload]
    for name, command in {**COMMANDS, **harnesses()}.items():
        for action in commands.add_parser(name, help=command.summary)._actions:
            if action.metavar in _FOLDERS | _FILES:
                complete = shtab.DIRECTORY if action.metavar in _FOLDERS else shtab.FILE
                action.complete = complete
    return parser


def _parser(prog: str, **_: Any) -> Parser:
    name = prog.rpartition(" ")[2]
    command = command_of(name)
    assert command is not None
    return Parser(name, command)
