"""What can be asked on the command line. Of a known command only its own parser is made: all of them take 1 ms."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any

from koordgen import __version__

MOST_ROBOTS = 128  # of a fleet, as koordgen/runtime/wire.py allows (a test compares them)


class _Parser(argparse.ArgumentParser):
    """Asks how wide the terminal is only when there is something to show: argparse itself does so at every argument,
    and what it imports for that takes 3 ms."""

    def __init__(self, **given: Any) -> None:
        super().__init__(formatter_class=_of_any_width, **given)

    def format_usage(self) -> str:
        self.formatter_class = argparse.HelpFormatter
        return super().format_usage()

    def format_help(self) -> str:
        self.formatter_class = argparse.HelpFormatter
        return super().format_help()


def _of_any_width(prog: str) -> argparse.HelpFormatter:
    return argparse.HelpFormatter(prog, width=80)


def parsed(arguments: list[str]) -> argparse.Namespace:
    """The options, `command` among them. Exits where they are wrong, or help or the version is asked for."""
    parser = _Parser(prog="koordgen", description="Compiles Koord programs to agents for robots.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"koordgen {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    asked = arguments[0] if arguments else ""
    for name, (summary, fill) in _COMMANDS.items():
        if asked == name or asked not in _COMMANDS:
            fill(commands.add_parser(name, help=summary))
        for harness, what in _harnesses() if name == "build" and asked not in _COMMANDS else ():
            _harness(commands.add_parser(harness, help=f"build and run: {what}"))
    return parser.parse_args(arguments)


def _check(command: argparse.ArgumentParser) -> None:
    command.add_argument("program", metavar="APP.koord")
    _format(command)


def _dump(command: argparse.ArgumentParser) -> None:
    command.add_argument("program", metavar="APP.koord")
    command.add_argument("--after", metavar="PASS", choices=("parse", "check"), default="check", help="parse or check")
    _format(command)


def _build(command: argparse.ArgumentParser) -> None:
    command.add_argument("program", metavar="APP.koord")
    command.add_argument("--target", metavar="A,B", required=True, help="the targets to build for")
    command.add_argument("-o", "--out", metavar="DIR", default="build", help="DIR/<app>/ is written (default: build)")
    _of_a_build(command)


def _prove(command: argparse.ArgumentParser) -> None:
    from koordgen.cli.prove import numbers

    def robots(text: str) -> str:
        numbers(text)
        return text

    command.add_argument("program", metavar="APP.koord")
    many = "`any` (default), a number or a range as 3..15"
    command.add_argument("--robots", metavar="N", type=robots, default="any", help=many)
    value = "a param's value; params without one may have any"
    command.add_argument("--param", metavar="NAME=VALUE", action="append", default=[], help=value)
    command.add_argument("--fleet", metavar="FILE", help="a fleet file (YAML) for the values of params")
    command.add_argument("--emit", metavar="DIR", help="write each obligation as a file of SMT-LIB, and run.sh")
    command.add_argument("--solver", choices=("z3", "cvc5", "both"), default="z3", help="default: z3")
    command.add_argument("--timeout", metavar="S", type=_seconds, default=10.0, help="of one query (default: 10)")
    command.add_argument("--trace", metavar="FILE", help="write the first counterexample as koord-trace/1")
    attack = "look for so long for a state that contradicts a PROVED; 0: do not (default: 0.05)"
    command.add_argument("--attack", metavar="S", type=_attack_seconds, default=0.05, help=attack)
    again = "run a contradiction again that an earlier command wrote, and prove nothing"
    command.add_argument("--attack-from", metavar="FILE", help=again)
    command.add_argument("--format", choices=("text", "json"), default="text", help="of what is told (default: text)")


def _explore(command: argparse.ArgumentParser) -> None:
    command.add_argument("program", metavar="APP.koord")
    command.add_argument("--robots", metavar="N", type=_fleet_size, help="how many (default: the fleet file's, or 3)")
    command.add_argument("--rounds", metavar="R", type=_count, help="go no farther (default: to the end)")
    command.add_argument("--env", metavar="FILE", help="the values of sensors, what callable ports may answer (YAML)")
    command.add_argument("--states", metavar="K", type=_count, help="end after so many states")
    command.add_argument("--seconds", metavar="S", type=_seconds, help="end after so long")
    apart = "tell robots apart also where the program does not"
    command.add_argument("--no-symmetry", dest="symmetry", action="store_false", help=apart)
    orders = "try every order of robots, also where it makes no difference"
    command.add_argument("--no-independence", dest="independence", action="store_false", help=orders)
    unread = "keep apart what differs only in what nobody reads any more"
    command.add_argument("--no-forgetting", dest="forgetting", action="store_false", help=unread)
    quiet = "let robots wait for ever without `stop`"
    command.add_argument("--no-deadlock", dest="deadlock", action="store_false", help=quiet)
    command.add_argument("--fleet", metavar="FILE", help="a fleet file (YAML): values of params, how many robots")
    command.add_argument("--param", metavar="NAME=VALUE", action="append", default=[], help="a param's value")
    command.add_argument("--functions", metavar="FILE", help="Python of the extern functions")
    command.add_argument("--trace", metavar="FILE", help="write the run to a violation as koord-trace/1")
    command.add_argument("--itf", metavar="FILE", help="write it in the Informal Trace Format (JSON)")
    command.add_argument("--format", choices=("text", "json"), default="text", help="of what is told (default: text)")


def _seconds(text: str) -> float:
    return _number(text, 0.01, 86400.0, "time in seconds")


def _attack_seconds(text: str) -> float:
    return _number(text, 0.0, 86400.0, "time in seconds")


def _fmt(command: argparse.ArgumentParser) -> None:
    command.add_argument("files", metavar="FILE", nargs="+", help="`-` reads standard input, writes standard output")
    command.add_argument("--check", action="store_true", help="write nothing; status 1 when a file would change")
    command.add_argument("--diff", action="store_true", help="like --check, and show what would change")
    command.add_argument("--upgrade", action="store_true", help="rewrite the 2020 dialect as well")
    command.add_argument("--format", choices=("text", "json"), default="text", help="of what is told (default: text)")


def _explain(command: argparse.ArgumentParser) -> None:
    command.add_argument("code", metavar="CODE", nargs="?", help="for example K030; without one, all codes are listed")


def _estop(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "fleet", metavar="FLEET", nargs="?", help="the fleet file (YAML), or a folder that build wrote"
    )
    address = "another robot, by its address as in a fleet file; may be given several times"
    command.add_argument("--address", metavar="HOST:PORT", action="append", default=[], help=address)
    number = "the fleet's application_id (default: the fleet file's, or 0)"
    command.add_argument("--application", metavar="N", type=int, help=number)
    command.add_argument("--key", metavar="FILE", help="the fleet's key (default: beside the fleet file, or here)")
    command.add_argument("--format", choices=("text", "json"), default="text", help="of what is told (default: text)")


def _basestation(command: argparse.ArgumentParser) -> None:
    command.add_argument("fleet", metavar="FLEET", help="the fleet file (YAML)")
    systems = "vicon, optitrack, qualisys, vrpn: what the package motioncapture knows"
    command.add_argument("--system", metavar="NAME", required=True, help=systems)
    command.add_argument("--host", metavar="HOST", required=True, help="where the motion capture system's server is")
    command.add_argument("--key", metavar="FILE", help="the fleet's key (default: beside the fleet file, or here)")
    rate = "poses a second to each robot, at most (default: 50)"
    command.add_argument("--rate", metavar="HZ", type=_rate, default=50.0, help=rate)
    _format(command)


def _rate(text: str) -> float:
    return _number(text, 1.0, 1000.0, "rate in Hz")


def _doctor(command: argparse.ArgumentParser) -> None:
    command.add_argument("bundle", metavar="BUNDLE", help="a robot's folder, as build wrote it")
    command.add_argument("--settings", metavar="FILE", help="JSON laid over the bundle's settings.json")
    command.add_argument("--format", choices=("text", "json"), default="text", help="of what is told (default: text)")


def _key(command: argparse.ArgumentParser) -> None:
    command.add_argument("action", choices=("new",))
    command.add_argument("file", metavar="FILE")


# Of all links between robots, over what the scenario says.
_NETWORK = {
    "loss": ("P", "the part of the datagrams between robots that is lost"),
    "delay": ("S", "seconds that a datagram is under way"),
    "jitter": ("S", "seconds that come on top at random, at most"),
    "duplication": ("P", "the part of the datagrams that comes twice"),
    "reordering": ("P", "the part of the datagrams that others overtake"),
}
# Options of a harness's bundle that have the same name here.
PASSED = ("duration", "seed", "live", "pace", *_NETWORK)


def _harness(command: argparse.ArgumentParser) -> None:
    command.add_argument("program", metavar="APP.koord")
    command.add_argument("--duration", metavar="S", type=float, help="seconds of mission, from its first round")
    command.add_argument("--seed", metavar="N", type=int, help="seed of all that is random")
    command.add_argument("--lockstep", action="store_true", help="all in one process: repeatable, as fast as it goes")
    command.add_argument("--gui", action="store_true", help="show PyBullet's window")
    pace = "of a run in lockstep: at most so many times real time"
    command.add_argument("--pace", metavar="FACTOR", type=float, help=pace)
    live = "show the run while it goes on, on a page of 127.0.0.1, at PORT or any free one"
    command.add_argument("--live", metavar="PORT", type=int, nargs="?", const=0, help=live)
    command.add_argument("--out", metavar="DIR", help="where trace, summary, pictures and report go")
    later = "no report and no pictures; `koordgen report` and `export` make them later"
    command.add_argument("--no-report", action="store_true", help=later)
    command.add_argument("--quiet", action="store_true", help="no progress")
    command.add_argument("--scenario", metavar="FILE", help="what goes wrong in the run, and when (YAML)")
    follow = "let the agents run this counterexample, as `explore` or `prove --trace` wrote it"
    command.add_argument("--follow", metavar="TRACE", help=follow)
    for name, (metavar, help) in _NETWORK.items():
        command.add_argument(f"--{name}", metavar=metavar, type=float, help=help)
    _of_a_build(command, fleet_required=True)


def _campaign(command: argparse.ArgumentParser) -> None:
    command.add_argument("program", metavar="APP.koord")
    command.add_argument("--runs", metavar="N", type=_count, help="how many runs (default: every combination once)")
    vary = "what differs from run to run: seed, seed=1:70, NAME=LO:HI, NAME=A,B,C, with commas between them"
    command.add_argument("--vary", metavar="NAME[=VALUES]", action="append", default=[], help=vary)
    command.add_argument("--duration", metavar="S", type=float, help="seconds of each mission, from its first round")
    command.add_argument("--lockstep", action="store_true", help="on the simulated clock: repeatable, and faster")
    command.add_argument("--verdict", metavar="FILE", help="a Python script that judges each run's folder")
    jobs = "runs at a time (default: as many as there are cores; one in real time)"
    command.add_argument("--jobs", metavar="N", type=_count, help=jobs)
    command.add_argument("--out", metavar="DIR", help="where runs, table and pictures go (default: campaign-<app>)")
    reports = "of each run make its report and pictures, too: some seconds a run"
    command.add_argument("--reports", action="store_true", help=reports)
    command.add_argument("--resume", action="store_true", help="go on with what DIR holds")
    command.add_argument("--cluster", metavar="ADDRESS", help="hand the runs to this Dask scheduler")
    command.add_argument("--quiet", action="store_true", help="no progress")
    _of_a_build(command, fleet_required=True)


def _validate(command: argparse.ArgumentParser) -> None:
    command.add_argument("program", metavar="APP.koord")
    command.add_argument("--fleet", metavar="FILE", required=True, help="the fleet file (YAML)")
    samples = "runs, each from a start of its own (default: as many as epsilon and gamma want)"
    command.add_argument("--samples", metavar="N", type=_count, help=samples)
    epsilon = "a run violates with a probability below E (default: 0.05)"
    command.add_argument("--epsilon", metavar="E", type=_part, default=0.05, help=epsilon)
    gamma = "said with confidence 1 - G (default: 0.05)"
    command.add_argument("--gamma", metavar="G", type=_part, default=0.05, help=gamma)
    command.add_argument("--seconds", metavar="S", type=_seconds, default=30.0, help="of each run (default: 30)")
    command.add_argument("--seed", metavar="K", type=_natural, default=1, help="of the first run (default: 1)")
    command.add_argument(
        "--jobs", metavar="J", type=_count, help="runs at a time (default: as many as there are cores)"
    )
    command.add_argument("--cluster", metavar="ADDRESS", help="hand the runs to this Dask scheduler")
    command.add_argument("--out", metavar="DIR", help="where runs, table and picture go (default: validate-<app>)")
    command.add_argument("--reachsets", action="store_true", help="also where each platform can get to on its way")
    offset = "of the target, for reachsets: metres, east, north, up (default: 0.7,0.4,0)"
    command.add_argument("--offset", metavar="X,Y,Z", type=_offset, default=(0.7, 0.4, 0.0), help=offset)
    command.add_argument("--quiet", action="store_true", help="no progress")
    command.add_argument("--param", metavar="NAME=VALUE", action="append", default=[], help="a param's value")
    command.add_argument("--functions", metavar="FILE", help="Python of the extern functions")
    command.add_argument("--format", choices=("text", "json"), default="text", help="of what is told (default: text)")


def _part(text: str) -> float:
    return _number(text, 0.000001, 0.999, "probability")


def _number(text: str, least: float, most: float, what: str) -> float:
    """Raises ArgumentTypeError, whose message argparse tells as it is."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{text} is no {what}; give {least:g} to {most:g}")
    return value


def _offset(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is no offset; give X,Y,Z in metres, such as 0.7,0.4,0") from None
    if not 0.1 <= math.hypot(x, y, z) <= 1000.0:
        raise argparse.ArgumentTypeError(f"{text} is no offset; give 0.1 to 1000 m")
    return x, y, z


def _natural(text: str) -> int:
    return _whole(text, 0)


def _replay(command: argparse.ArgumentParser) -> None:
    command.add_argument("trace", metavar="TRACE", help="a run's folder, its trace.jsonl, or a robot's own trace")
    command.add_argument("--program", metavar="APP.koord", help="the program (default: that in the run's folder)")
    command.add_argument("--seconds", metavar="S", type=_seconds, help="end after so long (default: never)")
    _of_a_build(command)


def _audit(command: argparse.ArgumentParser) -> None:
    traces = "robots' own traces, folders of them, a run's folder or its merged trace.jsonl"
    command.add_argument("traces", metavar="TRACE", nargs="+", help=traces)
    command.add_argument("--program", metavar="APP.koord", help="the program (default: that in the run's folder)")
    proof = "ask the prover about each invariant that was violated"
    command.add_argument("--prove", action="store_true", help=proof)
    command.add_argument("--seconds", metavar="S", type=_seconds, help="end the judging after so long (default: never)")
    command.add_argument("--plot", metavar="FILE", help="draw the properties over time (png, svg or pdf)")
    command.add_argument("--fleet", metavar="FILE", help="a fleet file (YAML) for the values of params")
    command.add_argument("--param", metavar="NAME=VALUE", action="append", default=[], help="a param's value")
    command.add_argument("--functions", metavar="FILE", help="Python of the extern functions")
    command.add_argument("--format", choices=("text", "json"), default="text", help="of what is told (default: text)")


def _count(text: str) -> int:
    return _whole(text, 1)


def _fleet_size(text: str) -> int:
    return _whole(text, 1, MOST_ROBOTS)


def _whole(text: str, least: int, most: float = math.inf) -> int:
    """Raises ArgumentTypeError."""
    value = int(text) if text.strip().isdecimal() else -1
    if not least <= value <= most:
        end = "or more" if most == math.inf else f"to {most}"
        raise argparse.ArgumentTypeError(f"{text} is no number that fits; give a whole one, {least} {end}")
    return value


def _report(command: argparse.ArgumentParser) -> None:
    command.add_argument("trace", metavar="TRACE", help="a run's folder, or its trace.jsonl")
    command.add_argument("-o", "--out", metavar="FILE", help="the page (default: report.html beside the trace)")


def _export(command: argparse.ArgumentParser) -> None:
    command.add_argument("trace", metavar="TRACE", help="a run's folder, or its trace.jsonl")
    command.add_argument("--to", choices=("mcap", "csv", "png", "gif", "mp4"), required=True, help="what to write")
    command.add_argument("-o", "--out", metavar="PATH", help="where to (default: beside the trace)")


def _of_a_build(command: argparse.ArgumentParser, fleet_required: bool = False) -> None:
    command.add_argument("--fleet", metavar="FILE", required=fleet_required, help="the fleet file (YAML)")
    command.add_argument(
        "--param", metavar="NAME=VALUE", action="append", default=[], help="a param's value; goes before the fleet's"
    )
    command.add_argument(
        "--functions", metavar="FILE", help="Python of the extern functions (default: <app>_functions.py beside it)"
    )
    _format(command)


def _format(command: argparse.ArgumentParser) -> None:
    help = "of diagnostics (default: text)"
    command.add_argument("--format", choices=("text", "json", "sarif"), default="text", help=help)


def _docs(command: argparse.ArgumentParser) -> None:
    what = "a page's name, with #SECTION for a section of it; without one, all pages are listed"
    command.add_argument("page", metavar="PAGE", nargs="?", help=what)


def _new(command: argparse.ArgumentParser) -> None:
    command.add_argument("name", metavar="NAME", help="the program's name, and that of its folder")


def _examples(command: argparse.ArgumentParser) -> None:
    command.add_argument("action", choices=("copy",), nargs="?", help="without it, all examples are listed")
    command.add_argument("name", metavar="NAME", nargs="?", help="the example to copy")
    where = "the folder that the copy is written to (default: examples/NAME)"
    command.add_argument("folder", metavar="FOLDER", nargs="?", help=where)


_COMMANDS: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]] = {
    "new": ("write a program and a fleet file to begin with", _new),
    "examples": ("list the examples, or copy one", _examples),
    "docs": ("list the pages of the documentation, or print one", _docs),
    "check": ("check a program", _check),
    "build": ("write a bundle for each target, or for each robot of a fleet", _build),
    "prove": ("prove a program's invariants, or show why they do not hold", _prove),
    "explore": ("try all that a fleet can do, and show the shortest way to what must not be", _explore),
    "validate": ("hold what a program assumes of its ports to simulated platforms, many times", _validate),
    "campaign": ("run a fleet many times, and tell what came of it", _campaign),
    "replay": ("run a trace's program again on what its robots saw, and compare what they did", _replay),
    "audit": ("judge a program's properties by the traces of a whole fleet", _audit),
    "report": ("make the page that shows a run: moving pictures, rounds, shared variables, network", _report),
    "export": ("write a run's trace as MCAP, CSV, pictures or a film", _export),
    "doctor": ("look whether a robot is ready for a mission, on its own computer; nothing moves", _doctor),
    "key": ("make a fleet's key", _key),
    "basestation": ("pass the poses of a motion capture system on to the robots of a fleet", _basestation),
    "estop": ("emergency stop: bring all robots of a fleet to rest at once", _estop),
    "fmt": ("format programs in place", _fmt),
    "explain": ("tell more of a code, with a wrong and a right example", _explain),
    "dump": ("show a program as it stands after a pass", _dump),
}


def _harnesses() -> list[tuple[str, str]]:
    """Targets that run a whole fleet are commands."""
    from koordgen import manifest

    return [(t.name, t.summary) for t in map(manifest.load, manifest.available()) if t.kind == "harness"]
