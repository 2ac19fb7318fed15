"""Argument parser of one command: help with options in groups, and errors that propose a similar option."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple, NoReturn

USAGE = 2  # exit status after wrong options or arguments
_NEGATIVE = re.compile(r"-[\d.]")


class Command(NamedTuple):
    """A command: part of the overview, summary, function that adds its options, documentation page, two examples."""

    part: str
    summary: str
    fill: Callable[[Parser], None]
    page: str
    examples: tuple[str, str]


class Parser(argparse.ArgumentParser):
    """Parser of `koordgen NAME`. Options cannot be abbreviated.

    argparse determines the terminal's width for every argument, which takes 3 ms. This parser determines it only to
    print help.
    """

    def __init__(self, name: str, command: Command) -> None:
        super().__init__(
            prog=f"koordgen {name}",
            description=sentence(command.summary),
            epilog=_epilog(command),
            formatter_class=_of_any_width,
            allow_abbrev=False,
            add_help=False,
        )
        self._arguments: Sequence[str] = ()
        self.positional = self.add_argument_group("arguments")
        command.fill(self)
        self.add_argument_group("help").add_argument("-h", "--help", action="help", help="show this help and exit")

    def parsed(self, arguments: Sequence[str]) -> argparse.Namespace:
        """Return the options. Raises SystemExit if they are wrong, and after printing help."""
        self._arguments = arguments
        options, more = self.parse_known_args(arguments)
        if more and not any(argument.startswith("-") for argument in more):
            # argparse puts the arguments before an option into a list of arguments, but not those after the option.
            for action in self._actions:
                if action.nargs == "*" and not action.option_strings:
                    getattr(options, action.dest).extend(more)
                    more = []
        if more:
            self.error(f"unexpected argument: {more[0]}")
        return options

    def format_usage(self) -> str:
        self.usage = self._usage()
        self.formatter_class = argparse.RawDescriptionHelpFormatter
        return super().format_usage()

    def format_help(self) -> str:
        self.usage = self._usage()
        self.formatter_class = argparse.RawDescriptionHelpFormatter
        return super().format_help()

    def error(self, message: str) -> NoReturn:
        """Print the usage of this command, the error and a help text; exit with status 2."""
        before, unknown = self._unknown()
        help = f"`{self.prog} --help` lists its options"
        if unknown:
            message = f"no option {unknown}"
            options = [name for action in self._actions for name in action.option_strings]
            if before in options and _NEGATIVE.match(unknown):
                help = f"write a value that begins with '-' as {before}={unknown}"
            elif near := nearest(unknown, options):
                help = f"did you mean {near}? {help}"
        from koordgen.cli.base.terminal import coloured_message

        text = f"{self.format_usage()}error: {message}\n  help: {help}\n"
        self.exit(USAGE, coloured_message(text, sys.stderr))

    def _unknown(self) -> tuple[str, str]:
        """Return (argument before it, option) for the first unknown option; ("", "") if all are known."""
        known = {name for action in self._actions for name in action.option_strings}
        for before, argument in pairwise(["", *self._arguments]):
            if argument == "--":
                break
            name = argument.partition("=")[0]
            number = _NEGATIVE.match(name) and re.fullmatch(r"-\d*\.?\d+", name)
            if len(name) > 1 and name[0] == "-" and " " not in name and not number:
                short = name[1] != "-" and name[:2] in known
                if name not in known and not short:
                    return before, name
        return "", ""

    def _usage(self) -> str:
        """Return the usage line: arguments and required options. Other options are in the list below it."""
        words = [self.prog]
        for action in self._actions:
            metavar = str(action.metavar or action.dest)
            if action.option_strings and action.required:
                words.append(f"{action.option_strings[-1]} {metavar}")
            elif not action.option_strings:
                words.append(
                    {"+": f"{metavar}...", "?": f"[{metavar}]", "*": f"[{metavar}...]"}.get(str(action.nargs), metavar)
                )
        return " ".join([*words, "[options]"]).replace("%", "%%")


def nearest(word: str, known: Iterable[str]) -> str:
    """Return the known words that begin with `word`, or else the most similar one, as text."""
    from difflib import get_close_matches

    known = sorted(set(known))
    found = [each for each in known if each.startswith(word)] or get_close_matches(word, known, 1)
    return " or ".join(found[:4])


def sentence(summary: str) -> str:
    """Return a summary as a sentence, with a capital letter and a full stop."""
    return f"{summary[0].upper()}{summary[1:]}."


def _epilog(command: Command) -> str:
    examples = "\n".join(f"  {each}" for each in command.examples)
    names = dict.fromkeys(re.findall(r"examples/([a-z]+)/", examples))
    files = f" (their files: {', '.join(f'`koordgen examples copy {name}`' for name in names)})" if names else ""
    return f"examples{files}:\n{examples}\n\nmore: `koordgen docs {command.page}`"


def _of_any_width(prog: str) -> argparse.HelpFormatter:
    return argparse.HelpFormatter(prog, width=80)
