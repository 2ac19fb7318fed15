"""Table of all commands, the overview of `koordgen help`, and the parser of each command.

To add a command, add a line to `COMMANDS` here and to `_COMMANDS` of koordgen/cli/__init__.py. A parser is constructed
only for the command that runs: constructing all parsers takes longer than checking a program.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from functools import cache

from koordgen import __version__
from koordgen.cli.base import options
from koordgen.cli.base.parser import USAGE, Command, Parser, nearest

WRITE, PROVE, RUN, AFTER, ROBOTS, MORE = (
    "write a program", "verify a program", "build and simulate", "examine a run", "operate robots", "more",
)  # fmt: skip
_LINEFORM = "examples/lineform/lineform.koord"
_FLEET = "--fleet examples/lineform/fleet.yaml"

COMMANDS: dict[str, Command] = {
    "new": Command(WRITE, "write a small program and a fleet file as a start", options.new,
        "cli#new-examples-docs", ("koordgen new hello", "koordgen new my_robots")),
    "examples": Command(WRITE, "list the examples, or copy one", options.examples, "cli#new-examples-docs", (
        "koordgen examples copy lineform", "koordgen examples copy task my/tasks")),
    "check": Command(WRITE, "check a program", options.check, "cli", (
        f"koordgen check {_LINEFORM}", f"koordgen check --format sarif {_LINEFORM} > koordgen.sarif")),
    "fmt": Command(WRITE, "format programs in place", options.fmt, "cli#fmt", (
        "koordgen fmt app.koord", "koordgen fmt --diff app.koord other.koord")),
    "explain": Command(WRITE, "explain an error code, a verdict, or reasons for skipped rounds", options.explain,
        "errors", ("koordgen explain K030", "koordgen explain skip")),
    "dump": Command(WRITE, "print a program after a pass of the compiler", options.dump, "cli", (
        f"koordgen dump {_LINEFORM}", f"koordgen dump --after parse {_LINEFORM}")),
    "prove": Command(PROVE, "prove a program's invariants, or show why they do not hold", options.prove,
        "proofs", ("koordgen prove examples/lineform/geofence.koord",
        "koordgen prove --robots 3..5 examples/lineform/geofence.koord")),
    "explore": Command(PROVE, "search all runs of a fleet for the shortest one that violates a property",
        options.explore, "explore", ("koordgen explore examples/election/election.koord",
        f"koordgen explore {_LINEFORM} --env examples/lineform/explore.yaml --rounds 4")),
    "validate": Command(PROVE, "test a program's assumptions about its ports on simulated platforms", options.validate,
        "validate", (f"koordgen validate examples/lineform/geofence.koord {_FLEET}",
        f"koordgen validate examples/lineform/geofence.koord {_FLEET} --samples 20 --seconds 10")),
    "build": Command(RUN, "write a bundle for each robot of a fleet, or for each target", options.build, "cli",
        (f"koordgen build {_LINEFORM} {_FLEET}", f"koordgen build {_LINEFORM} --target quad,car")),
    "campaign": Command(RUN, "simulate a fleet many times, and count the verdicts", options.campaign,
        "cli#campaign", (f"koordgen campaign {_LINEFORM} {_FLEET} --lockstep --vary seed=1:5",
        f"koordgen campaign {_LINEFORM} {_FLEET} --lockstep --runs 8 --vary seed,loss=0:0.3")),
    "report": Command(AFTER, "write a web page about a run: map, rounds, shared variables, network", options.report,
        "sim#the-report", ("koordgen report run-lineform", "koordgen report run-lineform -o lineform.html")),
    "export": Command(AFTER, "convert a run's trace to MCAP, CSV, a picture or a video, or upgrade an old trace",
        options.export, "sim#exports", ("koordgen export run-lineform --to csv",
        "koordgen export old-run --to koord-trace/2")),
    "show": Command(AFTER, "show the values that each robot of a run had at a time", options.show,
        "cli#show", ("koordgen show run-lineform", "koordgen show run-lineform --at 12")),
    "replay": Command(AFTER, "run the program again on a trace's recorded inputs, and compare the results",
        options.replay, "cli#replay", ("koordgen replay run-lineform",
        "koordgen replay run-lineform/robots/bert/trace.jsonl")),
    "audit": Command(AFTER, "check a program's properties on the traces of a whole fleet", options.audit,
        "audit", ("koordgen audit run-lineform", "koordgen audit alice.jsonl bert.jsonl --program app.koord")),
    "deploy": Command(ROBOTS, "build a fleet, and install the release on all robots or on none", options.deploy,
        "deploy", (f"koordgen deploy {_LINEFORM} {_FLEET}",
        f"koordgen deploy {_LINEFORM} {_FLEET} --param laps=3")),
    "rollback": Command(ROBOTS, "return all robots to the previous release, or to another one that they still have",
        options.rollback, "deploy#rollback", ("koordgen rollback fleet.yaml",
        "koordgen rollback fleet.yaml --to 3f0c9b7d12ab45e6")),
    "start": Command(ROBOTS, "start the agents of a deployed fleet", options.start, "cli#start-and-stop", (
        "koordgen start fleet.yaml", "koordgen start fleet.yaml alice bert")),
    "stop": Command(ROBOTS, "stop the agents of a deployed fleet: quads land, cars brake", options.stop,
        "cli#start-and-stop", ("koordgen stop fleet.yaml", "koordgen stop fleet.yaml alice --seconds 60")),
    "logs": Command(ROBOTS, "show the log lines of all robots of a deployed fleet, ordered by time", options.logs,
        "cli#logs", ("koordgen logs fleet.yaml --follow", "koordgen logs fleet.yaml alice --lines 200")),
    "collect": Command(ROBOTS, "copy the traces and logs of a deployed fleet into one run folder", options.collect,
        "cli#collect", ("koordgen collect fleet.yaml -o flight-7",
        "koordgen collect examples/lineform/fleet.yaml -o flight-7")),
    "doctor": Command(ROBOTS, "check whether a robot or a deployed fleet is ready for a mission; nothing moves",
        options.doctor, "cli#doctor", ("koordgen doctor build/lineform/alice",
        "koordgen doctor --fleet fleet.yaml --format json")),
    "key": Command(ROBOTS, "create, replace or list the keys of a fleet", options.key, "safety", (
        "koordgen key new fleet.key", "koordgen key rotate fleet.yaml")),
    "basestation": Command(ROBOTS, "send the poses of a motion capture system to the robots of a fleet",
        options.basestation, "cli#basestation", (
        "koordgen basestation fleet.yaml --system vicon --host 192.168.1.5",
        "koordgen basestation fleet.yaml --system optitrack --host mocap.local --rate 100")),
    "estop": Command(ROBOTS, "emergency stop: stop all robots of a fleet at once", options.estop,
        "cli#estop", ("koordgen estop fleet.yaml",
        "koordgen estop --address 192.168.1.20:47100 --key fleet.key")),
    "status": Command(ROBOTS, "show the state of each robot of a fleet in one table", options.status,
        "cli#status-of-a-fleet", ("koordgen status fleet.yaml", "koordgen status fleet.yaml --watch")),
    "dashboard": Command(ROBOTS, "show a running fleet in a browser: map, rounds, links, batteries, log lines",
        options.dashboard, "dashboard", ("koordgen dashboard fleet.yaml", "koordgen dashboard fleet.yaml --control")),
    "docs": Command(MORE, "list the pages of the documentation, or print one", options.docs, "cli#new-examples-docs", (
        "koordgen docs fleet", "koordgen docs cli#exit-statuses")),
    "help": Command(MORE, "list the commands, or explain one", options.help_, "cli", (
        "koordgen help", "koordgen help build")),
    "completion": Command(MORE, "print a script that completes commands and options in a shell",
        options.completion, "cli#completion", (
        "koordgen completion bash > ~/.local/share/bash-completion/completions/koordgen",
        "koordgen completion fish > ~/.config/fish/completions/koordgen.fish")),
}  # fmt: skip


def parsed(arguments: Sequence[str]) -> Namespace:
    """Return the options, with the command's name as `command`. Raises SystemExit for wrong ones, help and version."""
    first = arguments[0] if arguments else ""
    if first in ("-V", "--version"):
        print(f"koordgen {__version__}")
        raise SystemExit(0)
    if first in ("-h", "--help"):
        first, arguments = "help", ["help"]
    command = command_of(first)
    if command is None:
        print(f"usage: koordgen COMMAND ...\nerror: {wrong(first)}\n  help: {way_out(first)}", file=sys.stderr)
        raise SystemExit(USAGE)
    found = Parser(first, command).parsed(arguments[1:])
    found.command = first
    return found


def command_of(name: str) -> Command | None:
    """Return the command `name`; None if it does not exist."""
    return COMMANDS.get(name) or harnesses().get(name)


def wrong(name: str) -> str:
    """Return the error message for a name that is not a command."""
    if not name:
        return "no command is given"
    return f"no command {name!r}" if not name.startswith("-") else f"the option {name} comes before the command"


def way_out(name: str) -> str:
    """Return the help for a name that is not a command."""
    near = "" if not name or name.startswith("-") else nearest(name, [*COMMANDS, *harnesses()])
    return (f"did you mean {near}? " if near else "") + "`koordgen help` lists the commands"


def overview() -> str:
    """Return the list of all commands, by part."""
    everything = {**COMMANDS, **harnesses()}
    width = max(map(len, everything))
    lines = ["usage: koordgen COMMAND ...", "", "Compile Koord programs for fleets of robots, and verify them."]
    for part in dict.fromkeys(command.part for command in COMMANDS.values()):
        lines += ["", f"{part}:"]
        lines += [f"  {n:<{width}}  {c.summary}" for n, c in everything.items() if c.part == part]
    lines += ["", "First steps: `koordgen new hello`, or `koordgen docs` for the documentation."]
    return "\n".join([*lines, "`koordgen help COMMAND` explains a command. More: `koordgen docs cli`"])


@cache
def harnesses() -> dict[str, Command]:
    """Return the commands that build and run a bundle for a whole fleet: one for each target that is a harness."""
    from koordgen.fleet import manifest

    return {
        t.name: Command(
            RUN, "build the agents of a fleet and run them together on this computer", options.harness,
            t.name,
            (f"koordgen {t.name} {_LINEFORM} {_FLEET} --lockstep",
            f"koordgen {t.name} {_LINEFORM} {_FLEET} --live --loss 0.2"),
        )
        for t in map(manifest.load, manifest.available()) if t.kind == "harness"
    }  # fmt: skip
