"""Command line: the only package that prints and exits. Each command imports only what it needs.

Owns: the table of commands, their options, exit statuses, error messages with their help.
Offers: `main`.
Must not import: targets; commands that run a harness load it by name.
"""

from __future__ import annotations

import errno
import gc
import sys
from typing import TYPE_CHECKING

from koordgen.cli.base.building import available_targets, left_out, planned, target_names, write
from koordgen.cli.base.console import (
    HOLDS,
    INTERRUPTED,
    SURROUNDINGS,
    USAGE,
    WRONG,
    Failure,
    install,
    internal_error,
    notify,
    output,
    print_diagnostics,
    show_rejected,
)
from koordgen.cli.commands import parsed

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command. Return its exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    collecting = gc.isenabled()
    gc.disable()  # saves time: a command ends before there is much to collect, and trees have no cycles
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
    """End a command whose output cannot be written; without a message if the reader closed the pipe (`| head -1`).

    Python flushes the streams once more when it exits, and would report an error. So streams that cannot be written are
    replaced by the null device.
    """
    import os

    if not isinstance(error, BrokenPipeError):
        notify(f"error: {error.filename or 'standard output'}: {error.strerror}")
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
        notify(f"error: {failure}" + (f"\n  help: {failure.help}" if failure.help else ""))
        return failure.status
    except KeyboardInterrupt:
        notify("interrupted")
        return INTERRUPTED
    except Exception as error:
        from koordgen.build.pipeline import Rejected

        if isinstance(error, ModuleNotFoundError) and not (error.name or "koordgen").startswith(
            ("koordgen", "targets")
        ):
            notify(f"error: the Python package {error.name} is missing\n  help: {install('koordgen[sim]')}")
            return SURROUNDINGS
        if isinstance(error, OSError) and error.errno in (errno.EPIPE, errno.ENOSPC):
            raise  # `main` ends the command
        if not isinstance(error, Rejected):
            return internal_error(error)
        show_rejected(error, options)
        return WRONG


def _help(options: Namespace) -> int:
    from koordgen.cli import commands
    from koordgen.cli.base.parser import Parser

    if options.topic is None:
        print(commands.overview())
        return HOLDS
    command = commands.command_of(options.topic)
    if command is None:
        raise Failure(USAGE, commands.wrong(options.topic), commands.way_out(options.topic))
    Parser(options.topic, command).print_help()
    return HOLDS


def _check(options: Namespace) -> int:
    from koordgen.build.pipeline import check_part, check_system
    from koordgen.cli.base.values import is_fleet

    if options.fleet is not None:
        planned(options, None, squads=True)
        return HOLDS
    parts = check_system(options.program).parts if is_fleet(options.program) else (check_part(options.program),)
    once = {part.source.path: part for part in parts}
    print_diagnostics([(part.source, d) for part in once.values() for d in part.diagnostics], options)
    return HOLDS


def _dump(options: Namespace) -> int:
    from koordgen.build.pipeline import dump

    print(dump(options.program, options.after), end="")
    return HOLDS


def _build(options: Namespace) -> int:
    from pathlib import Path

    from koordgen.cli.base.values import is_fleet

    if options.target is None and options.fleet is None and not is_fleet(options.program):
        help = f"name a fleet file with --fleet, or targets with --target; possible targets: {available_targets()}"
        raise Failure(USAGE, "neither --fleet nor --target is given", help)
    targets = None if options.target is None else target_names(options.target)
    bundles, app = planned(options, targets, squads=True)
    if targets is not None and (missing := left_out(bundles, targets)):
        notify(
            f"note: --target {options.target} leaves out {', '.join(missing)}; without --target all robots are built"
        )
    folder = Path(options.out) / app
    write(bundles, folder)
    for name, files in bundles.items():
        print(f"{folder / name}  {len(files)} files", file=output(options))
    return HOLDS


def _harness(options: Namespace) -> int:
    from koordgen.cli.experiment.harness import harness

    return harness(options)


def _fmt(options: Namespace) -> int:
    from koordgen.build.pipeline import Rejected
    from koordgen.lang.analyze.program import check
    from koordgen.lang.format.files import format_file, output

    dry = options.check or options.diff
    checker = check if options.upgrade else None
    results = [format_file(path, checker, write=not dry) for path in options.files]
    sys.stdout.buffer.write(output(results, options.format, options.check, options.diff))
    mistakes = [(r.source, d) for r in results for d in r.mistakes]
    if mistakes and options.format == "text":
        show_rejected(Rejected(mistakes), options)
    refused = [r.refused for r in results if r.refused]
    if refused:
        raise Failure(SURROUNDINGS, "; ".join(refused), "files that could not be written are unchanged")
    return WRONG if mistakes or (dry and any(r.changed for r in results)) else HOLDS


def _prove(options: Namespace) -> int:
    from koordgen.cli.verify.prove import run

    return run(options)


def _explore(options: Namespace) -> int:
    from koordgen.cli.base.values import is_fleet
    from koordgen.cli.verify.explore import explore
    from koordgen.cli.verify.explore_system import explore_system

    return explore_system(options) if is_fleet(options.program) else explore(options)


def _explain(options: Namespace) -> int:
    from koordgen.lang.diagnostics import CATALOGUE
    from koordgen.lang.explain import explanation, show, topic, topics

    if not options.code:
        print("\n".join(f"{code}  {title}" for code, title in CATALOGUE.items()))
        print(f"other topics: {', '.join(topics())}")
        return HOLDS
    word = " ".join(options.code)
    code = word.upper()
    text = show(explanation(code)) if code in CATALOGUE else topic(word)
    if not text:
        from koordgen.cli.base.parser import nearest

        near = nearest(code, [*CATALOGUE, *topics()]) if word else ""
        help = f"did you mean {near}? " if near else ""
        raise Failure(USAGE, f"no code {word!r}", f"{help}`koordgen explain` lists all codes and topics")
    print(text)
    return HOLDS


def _estop(options: Namespace) -> int:
    from koordgen.operate.estop import BY_HAND, BadAddress, CannotStop, show, stop_fleet

    if options.fleet is None and not options.address:
        raise Failure(USAGE, "no fleet file is named, and no --address", f"no robot was called; {BY_HAND}")
    try:
        results = stop_fleet(options.fleet, options.key, notify, options.address, options.application)
    except CannotStop as error:
        status = USAGE if isinstance(error, BadAddress) else WRONG
        raise Failure(status, str(error), f"{error.help}no robot was called; {BY_HAND}") from None
    print(show(results, options.format), flush=True)
    if silent := sum(not result.phase for result in results):
        raise Failure(SURROUNDINGS, f"{silent} of {len(results)} robots did not answer", BY_HAND)
    return HOLDS


def _status(options: Namespace) -> int:
    from koordgen.cli.operate.status import status

    return status(options)


def _dashboard(options: Namespace) -> int:
    from koordgen.cli.operate.dashboard import dashboard

    return dashboard(options)


def _basestation(options: Namespace) -> int:
    import os

    from koordgen.build.pipeline import read_fleet
    from koordgen.cli.base.terminal import ProgressLine
    from koordgen.operate.basestation import CannotServe, WrongFiles, all_targets, station

    fleet, _ = read_fleet(options.fleet, all_targets(), None, squads=True)
    line = ProgressLine(sys.stderr)
    try:
        serving = station(fleet, options.fleet, options.key, options.system, options.host, options.rate, notify)
        try:
            serving.serve(line.show)
        except KeyboardInterrupt:
            line.end()
            if not serving.camera.end():  # its library still waits for a frame, and would crash Python at its exit
                notify("interrupted")
                os._exit(INTERRUPTED)
            raise
    except CannotServe as error:
        line.end()
        status = WRONG if isinstance(error, WrongFiles) else SURROUNDINGS
        raise Failure(status, str(error), error.help) from None
    return HOLDS


def _fleet_command(options: Namespace) -> int:
    from koordgen.cli.operate import collect, fleet_commands

    commands = {"start": fleet_commands.start, "stop": fleet_commands.stop, "logs": fleet_commands.logs}
    return {**commands, "collect": collect.collect}[options.command](options)


def _doctor(options: Namespace) -> int:
    from koordgen.operate.doctor import CannotExamine, NoBundle, examine

    if (options.bundle is None) == (options.fleet is None):
        raise Failure(USAGE, "one of BUNDLE and --fleet FLEET is expected", "`koordgen help doctor` shows examples")
    if options.fleet is not None:
        from koordgen.cli.operate.fleet_commands import doctor

        return doctor(options)
    try:
        return examine(options.bundle, options.settings, options.format)
    except CannotExamine as error:
        status = WRONG if isinstance(error, NoBundle) else SURROUNDINGS
        raise Failure(status, str(error), error.help) from None


def _deploy(options: Namespace) -> int:
    from koordgen.cli.operate import deploy

    return {"deploy": deploy.deploy, "rollback": deploy.rollback, "key": deploy.key}[options.command](options)


def _campaign(options: Namespace) -> int:
    from koordgen.cli.experiment.campaign import campaign

    return campaign(options)


def _validate(options: Namespace) -> int:
    from koordgen.cli.experiment.validate import validate

    return validate(options)


def _replay(options: Namespace) -> int:
    from koordgen.cli.verify.replay import replay

    return replay(options)


def _audit(options: Namespace) -> int:
    from koordgen.cli.verify.audit import audit

    return audit(options)


def _afterwards(options: Namespace) -> int:
    from koordgen.cli.experiment.afterwards import afterwards

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
