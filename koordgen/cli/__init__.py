"""The command line: the only room that prints and exits. Thin; what a command does not need is never imported."""

from __future__ import annotations

import errno
import gc
import sys
from typing import TYPE_CHECKING

from koordgen.cli.commands import parsed

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Collection, Mapping, Sequence
    from typing import TextIO

    from koordgen.check.params import Value
    from koordgen.diagnostics import Diagnostic
    from koordgen.pipeline import Rejected
    from koordgen.source import Source

# One table for every command; docs/cli.md prints it.
HOLDS, WRONG, USAGE, VIOLATED, INCONCLUSIVE, SURROUNDINGS, HOST, INTERNAL, INTERRUPTED = 0, 1, 2, 3, 4, 5, 6, 70, 130


class Failure(Exception):
    """Ends the command with a message, a way out, and an exit status."""

    def __init__(self, status: int, message: str, help: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.help = help


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    collecting = gc.isenabled()
    gc.disable()  # nothing here lives long enough to be collected, and trees have no cycles
    try:
        try:
            return _run(parsed(arguments))
        finally:
            sys.stdout.flush()
    except OSError as error:
        return _unwritten(error)
    finally:
        if collecting:
            gc.enable()


def _unwritten(error: OSError) -> int:
    """End a command whose output cannot be written: quietly when its reader has gone, as in `koordgen help | head -1`.
    Python flushes once more at its end, and complains where that fails."""
    import os

    if not isinstance(error, BrokenPipeError):
        _say(f"error: {error.filename or 'standard output'}: {error.strerror}")
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return SURROUNDINGS


def _run(options: Namespace) -> int:
    try:
        return _COMMANDS.get(options.command, _harness)(options)
    except Failure as failure:
        _say(f"error: {failure}" + (f"\n  help: {failure.help}" if failure.help else ""))
        return failure.status
    except KeyboardInterrupt:
        _say("interrupted")
        return INTERRUPTED
    except Exception as error:
        from koordgen.pipeline import Rejected

        if isinstance(error, ModuleNotFoundError) and not (error.name or "koordgen").startswith(
            ("koordgen", "targets")
        ):
            _say(f"error: the Python package {error.name} is missing\n  help: {install('koordgen[sim]')}")
            return SURROUNDINGS
        if isinstance(error, OSError) and error.errno in (errno.EPIPE, errno.ENOSPC):
            raise  # `main` ends the command
        if not isinstance(error, Rejected):
            return _internal(error)
        _show(error, options)
        return WRONG


def install(what: str) -> str:
    """Return how to install koordgen with an extra, as in "koordgen[prove]", for the running Python."""
    from koordgen.runtime.ops.host import pip_install

    return pip_install(f"'{what}'")


def _help(options: Namespace) -> int:
    from koordgen.cli import commands
    from koordgen.cli.parser import Parser

    if options.topic is None:
        print(commands.overview())
        return HOLDS
    command = commands.command_of(options.topic)
    if command is None:
        raise Failure(USAGE, commands.wrong(options.topic), commands.way_out(options.topic))
    Parser(options.topic, command).print_help()
    return HOLDS


def _check(options: Namespace) -> int:
    from koordgen.pipeline import check_file

    checked = check_file(options.program)
    _tell([(checked.source, d) for d in checked.noticed], options)
    return HOLDS


def _dump(options: Namespace) -> int:
    from koordgen.pipeline import dump

    print(dump(options.program, options.after), end="")
    return HOLDS


def _build(options: Namespace) -> int:
    from pathlib import Path

    if options.target is None and options.fleet is None:
        raise Failure(USAGE, "neither --fleet nor --target is given", f"--target names some of {_there_are()}")
    targets = None if options.target is None else _targets(options.target)
    bundles, app = _planned(options, targets)
    if targets is not None and (missing := _left_out(bundles, targets)):
        _say(f"note: --target {options.target} leaves out {', '.join(missing)}; without --target all robots are built")
    folder = Path(options.out) / app
    _write(bundles, folder)
    for name, files in bundles.items():
        print(f"{folder / name}  {len(files)} files", file=_output(options))
    return HOLDS


def _harness(options: Namespace) -> int:
    from koordgen.cli.harness import harness

    return harness(options)


def _fmt(options: Namespace) -> int:
    from koordgen.check import check
    from koordgen.format.files import format_file, output
    from koordgen.pipeline import Rejected

    dry = options.check or options.diff
    checker = check if options.upgrade else None
    results = [format_file(path, checker, write=not dry) for path in options.files]
    sys.stdout.buffer.write(output(results, options.format, options.check, options.diff))
    mistakes = [(r.source, d) for r in results for d in r.mistakes]
    if mistakes and options.format == "text":
        _show(Rejected(mistakes), options)
    refused = [r.refused for r in results if r.refused]
    if refused:
        raise Failure(SURROUNDINGS, "; ".join(refused), "what could not be written stands as it was")
    return WRONG if mistakes or (dry and any(r.changed for r in results)) else HOLDS


def _prove(options: Namespace) -> int:
    from koordgen.cli.prove import run

    return run(options)


def _explore(options: Namespace) -> int:
    from koordgen.cli.explore import explore

    return explore(options)


def _explain(options: Namespace) -> int:
    from koordgen.diagnostics import CATALOGUE
    from koordgen.explain import explanation, show, topic, topics

    if not options.code:
        print("\n".join(f"{code}  {title}" for code, title in CATALOGUE.items()))
        print(f"words: {', '.join(topics())}")
        return HOLDS
    word = " ".join(options.code)
    code = word.upper()
    text = show(explanation(code)) if code in CATALOGUE else topic(word)
    if not text:
        from koordgen.cli.parser import nearest

        near = nearest(code, [*CATALOGUE, *topics()]) if word else ""
        help = f"did you mean {near}? " if near else ""
        raise Failure(USAGE, f"no code {word!r}", f"{help}`koordgen explain` lists all codes and words")
    print(text)
    return HOLDS


def _estop(options: Namespace) -> int:
    from koordgen.estop import BY_HAND, BadAddress, CannotStop, show, stop_fleet

    if options.fleet is None and not options.address:
        raise Failure(USAGE, "no fleet file is named, and no --address", f"nobody was called; {BY_HAND}")
    try:
        results = stop_fleet(options.fleet, options.key, _say, options.address, options.application)
    except CannotStop as error:
        status = USAGE if isinstance(error, BadAddress) else WRONG
        raise Failure(status, str(error), f"{error.help}nobody was called; {BY_HAND}") from None
    print(show(results, options.format), flush=True)
    if silent := sum(not result.phase for result in results):
        raise Failure(SURROUNDINGS, f"{silent} of {len(results)} robots did not answer", BY_HAND)
    return HOLDS


def _status(options: Namespace) -> int:
    from koordgen.cli.status import status

    return status(options)


def _dashboard(options: Namespace) -> int:
    from koordgen.cli.dashboard import dashboard

    return dashboard(options)


def _basestation(options: Namespace) -> int:
    import os

    from koordgen.basestation import CannotServe, WrongFiles, all_targets, station
    from koordgen.cli.terminal import Line
    from koordgen.pipeline import read_fleet

    fleet, _ = read_fleet(options.fleet, all_targets(), None)
    line = Line(sys.stderr)
    try:
        serving = station(fleet, options.fleet, options.key, options.system, options.host, options.rate, _say)
        try:
            serving.serve(line.show)
        except KeyboardInterrupt:
            line.end()
            if not serving.camera.end():  # it waits for a frame within its library, and would crash Python's own end
                _say("interrupted")
                os._exit(INTERRUPTED)
            raise
    except CannotServe as error:
        line.end()
        status = WRONG if isinstance(error, WrongFiles) else SURROUNDINGS
        raise Failure(status, str(error), error.help) from None
    return HOLDS


def _fleet_command(options: Namespace) -> int:
    from koordgen.cli import collect, fleet_commands

    commands = {"start": fleet_commands.start, "stop": fleet_commands.stop, "logs": fleet_commands.logs}
    return {**commands, "collect": collect.collect}[options.command](options)


def _doctor(options: Namespace) -> int:
    from koordgen.doctor import CannotExamine, NoBundle, examine

    if (options.bundle is None) == (options.fleet is None):
        raise Failure(USAGE, "one of BUNDLE and --fleet FLEET is expected", "`koordgen help doctor` shows examples")
    if options.fleet is not None:
        from koordgen.cli.fleet_commands import doctor

        return doctor(options)
    try:
        return examine(options.bundle, options.settings, options.format)
    except CannotExamine as error:
        status = WRONG if isinstance(error, NoBundle) else SURROUNDINGS
        raise Failure(status, str(error), error.help) from None


def _deploy(options: Namespace) -> int:
    from koordgen.cli import deploy

    return {"deploy": deploy.deploy, "rollback": deploy.rollback, "key": deploy.key}[options.command](options)


def _campaign(options: Namespace) -> int:
    from koordgen.cli.campaign import campaign

    return campaign(options)


def _validate(options: Namespace) -> int:
    from koordgen.cli.validate import validate

    return validate(options)


def _replay(options: Namespace) -> int:
    from koordgen.cli.replay import replay

    return replay(options)


def _audit(options: Namespace) -> int:
    from koordgen.cli.audit import audit

    return audit(options)


def _afterwards(options: Namespace) -> int:
    from koordgen.cli.afterwards import afterwards

    return afterwards(options)


def _docs(options: Namespace) -> int:
    from koordgen.cli.docs import docs

    return docs(options)


def _new(options: Namespace) -> int:
    from koordgen.cli.starting import new

    return new(options)


def _examples(options: Namespace) -> int:
    from koordgen.cli.starting import examples

    return examples(options)


def _completion(options: Namespace) -> int:
    from koordgen.cli.completion import completion

    return completion(options)


_COMMANDS: dict[str, Callable[[Namespace], int]] = {
    "help": _help, "completion": _completion, "check": _check, "dump": _dump, "build": _build,
    "prove": _prove, "explore": _explore, "fmt": _fmt, "explain": _explain, "estop": _estop,
    "status": _status, "dashboard": _dashboard, "basestation": _basestation, "doctor": _doctor,
    "key": _deploy,
    "start": _fleet_command, "stop": _fleet_command, "logs": _fleet_command, "collect": _fleet_command,
    "deploy": _deploy, "rollback": _deploy, "report": _afterwards, "export": _afterwards, "show": _afterwards,
    "campaign": _campaign, "replay": _replay, "validate": _validate, "audit": _audit, "docs": _docs, "new": _new,
    "examples": _examples,
}  # fmt: skip


def _targets(text: str) -> list[str]:
    from koordgen import manifest

    wanted = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in wanted if name not in manifest.available()]
    if unknown or not wanted:
        message = f"no target {unknown[0]!r}" if unknown else "--target names no target"
        raise Failure(USAGE, message, f"the targets are {_there_are()}")
    return list(dict.fromkeys(wanted))


def _there_are() -> str:
    from koordgen import manifest

    return ", ".join(manifest.available())


def _left_out(bundles: Mapping[str, Mapping[str, bytes]], targets: Collection[str]) -> list[str]:
    """Return the robots that get no bundle of their own, where bundles of robots are built at all."""
    import json

    from koordgen import manifest

    if "fleet" not in bundles or all(manifest.load(name).kind != "agent" for name in targets):
        return []
    robots = json.loads(bundles["fleet"]["fleet.json"])["peers"]
    return [robot["name"] for robot in robots if robot["name"] not in bundles]


def _planned(
    options: Namespace, targets: list[str] | None, more: Mapping[str, Value] = {}
) -> tuple[dict[str, dict[str, bytes]], str]:
    """The bundles, and the app's name; `more` are params that neither the fleet nor the command names.

    Warnings and notes are told, or, for a command that prints a document of its own, put into `options.collected`.
    """
    from koordgen.check.params import BadParam
    from koordgen.manifest import ManifestError
    from koordgen.pipeline import plan_file

    try:
        given = {**more, **_params(options.param)}
        checked, bundles = plan_file(options.program, targets, options.fleet, given, options.functions)
    except BadParam as error:
        raise Failure(USAGE, str(error)) from None
    except ManifestError as error:
        raise Failure(SURROUNDINGS, str(error), "the target's folder is damaged; install koordgen anew") from None
    noticed = [(checked.source, d) for d in checked.noticed]
    if options.format == "json" and (collected := getattr(options, "collected", None)) is not None:
        collected += noticed
    else:
        _tell(noticed, options)
    return bundles, checked.program.name


def _params(given: list[str]) -> dict[str, Value]:
    if not given:
        return {}
    from koordgen.check.params import BadParam, parse_value

    values = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals:
            raise Failure(USAGE, f"--param {text}: NAME=VALUE is expected")
        try:
            values[name] = parse_value(value)
        except BadParam as error:
            raise Failure(USAGE, f"--param {text}: {error}") from None
    return values


def _write(bundles: dict[str, dict[str, bytes]], folder: object) -> None:
    from pathlib import Path

    from koordgen.bundle.write import CannotWrite, write

    try:
        write(bundles, Path(str(folder)))
    except CannotWrite as error:
        raise Failure(SURROUNDINGS, str(error), error.hint) from None


def _require_packages() -> None:
    """The harness and the agents run with this very Python."""
    from importlib.metadata import PackageNotFoundError, version

    from koordgen import manifest
    from koordgen.runtime.ops.host import needed

    def is_missing(name: str) -> bool:
        try:
            version(name)
        except PackageNotFoundError:
            return True
        return False

    missing = set()
    for target in map(manifest.load, manifest.available()):
        wanted = set(filter(None, map(needed, target.requirements)))
        missing |= set(filter(is_missing, wanted - set(target.one_of)))
        if target.one_of and all(map(is_missing, target.one_of)):
            missing.add(" or ".join(target.one_of))
    if missing:
        message = f"packages are missing: {', '.join(sorted(missing))}"
        raise Failure(SURROUNDINGS, message, install("koordgen[sim]"))


def _print_document(options: Namespace, results: Mapping[str, object]) -> None:
    """Print the one JSON document of a command: the diagnostics that were collected, and its results."""
    import json

    from koordgen.diagnostics import as_data

    diagnostics = [as_data(source, diagnostic) for source, diagnostic in options.collected]
    print(json.dumps({"diagnostics": diagnostics, **results}, indent=2), flush=True)


def _show(rejected: Rejected, options: Namespace) -> None:
    _tell(rejected.found, options)
    codes = [d.code for _, d in rejected.found if d.severity == "error"]
    if options.format == "text":
        _say(f"{len(codes)} error{'s' if len(codes) != 1 else ''}; `koordgen explain {codes[0]}` tells more")


def _tell(found: Collection[tuple[Source, Diagnostic]], options: Namespace) -> None:
    """All that a command has to say of the user's files, once: for machines a document, even when it is nothing."""
    if options.format == "json":
        from koordgen.diagnostics import to_json

        print(to_json(found), flush=True)
    elif options.format == "sarif":
        from pathlib import Path

        from koordgen.sarif import to_sarif

        print(to_sarif(found, Path.cwd()), flush=True)
    elif found:
        from koordgen.diagnostics import render

        for source, diagnostic in found:
            _say(render(diagnostic, source))


def _output(options: Namespace) -> TextIO | None:
    """Where a command's own words go: aside when a document for machines has standard output, which None means."""
    return None if options.format == "text" else sys.stderr


def _say(text: str) -> None:
    from koordgen.cli.terminal import coloured_message

    print(coloured_message(text, sys.stderr), file=sys.stderr)


def _internal(error: Exception) -> int:
    import traceback

    traceback.print_exception(error)
    _say(
        f"internal error: {error}\n"
        "  this is a mistake of koordgen, not of your program: please report it with the above"
    )
    return INTERNAL
