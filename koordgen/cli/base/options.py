"""Options of each command, in groups; koordgen/cli/commands.py lists the commands."""

from __future__ import annotations

from argparse import _ArgumentGroup as Group

from koordgen.cli.base import values
from koordgen.cli.base.parser import Parser


def check(command: Parser) -> None:
    """Options of `koordgen check`."""
    _program_or_fleet(command)
    _fleet(command.add_argument_group("fleet"), "a fleet file (YAML): make all checks of `build`")
    command.set_defaults(param=[], functions=None)
    _diagnostics(command.add_argument_group("output"))


def new(command: Parser) -> None:
    """Options of `koordgen new`."""
    name = "name of the program and of its folder: letters, digits and _"
    command.positional.add_argument("name", metavar="NAME", help=name)


def examples(command: Parser) -> None:
    """Options of `koordgen examples`."""
    action = "`copy` copies an example (default: list all examples)"
    command.positional.add_argument("action", metavar="copy", choices=("copy",), nargs="?", help=action)
    command.positional.add_argument("name", metavar="NAME", nargs="?", help="the example to copy")
    folder = "the folder of the copy (default: examples/NAME)"
    command.positional.add_argument("folder", metavar="FOLDER", nargs="?", help=folder)


def docs(command: Parser) -> None:
    """Options of `koordgen docs`."""
    page = "a page, for example fleet, or a section, for example fleet#safety (default: list all pages)"
    command.positional.add_argument("page", metavar="PAGE", nargs="?", help=page)


def dump(command: Parser) -> None:
    """Options of `koordgen dump`."""
    _program(command)
    output = command.add_argument_group("output")
    after = "pass after which to print: `parse` prints the syntax tree, `check` the typed IR (default: check)"
    output.add_argument("--after", metavar="PASS", choices=("parse", "check"), default="check", help=after)
    _diagnostics(output)


def build(command: Parser) -> None:
    """Options of `koordgen build`."""
    _program_or_fleet(command)
    wanted = command.add_argument_group("what to build")
    targets = "targets to build for, for example quad,car (default: those of the robots in the fleet file)"
    wanted.add_argument("--target", metavar="A,B", help=targets)
    _fleet(wanted, "the fleet file (YAML): write a folder for each robot")
    _params(wanted)
    output = command.add_argument_group("output")
    output.add_argument(
        "-o",
        "--out",
        metavar="DIR",
        default="build",
        help="write DIR/APP/, or DIR/FLEET/ for a fleet file (default: build)",
    )
    _diagnostics(output)


def prove(command: Parser) -> None:
    """Options of `koordgen prove`."""
    _program_or_fleet(command)
    question = command.add_argument_group("what to prove")
    many = "number of robots: `any`, a number, or a range such as 3..15 (default: any)"
    question.add_argument("--robots", metavar="N", type=values.robots, default="any", help=many)
    _fleet(question, "a fleet file (YAML), for the values of params, and for robots that are fleets themselves")
    value = "value of a param; other params may have any value; may be repeated"
    question.add_argument("--param", metavar="NAME=VALUE", action="append", default=[], help=value)
    inner = "program of the fleets that are the robots of APP: prove that it keeps what APP assumes of its modules"
    question.add_argument("--inner", metavar="INNER.koord", help=inner)
    validation = "report of `koordgen validate` (validation.json): assumptions that its runs kept are VALIDATED"
    question.add_argument("--validation", metavar="FILE", help=validation)
    solving = command.add_argument_group("solver")
    solving.add_argument("--solver", choices=("z3", "cvc5", "both"), default="z3", help="SMT solver (default: z3)")
    timeout = "time limit of one query, in seconds (default: 10)"
    solving.add_argument("--timeout", metavar="S", type=values.seconds, default=10.0, help=timeout)
    attack = "time of the search for states that contradict a PROVED, in seconds; 0: no search (default: 0.05)"
    solving.add_argument("--attack", metavar="S", type=values.seconds_or_none, default=0.05, help=attack)
    again = "run a contradiction again that an earlier command wrote to FILE; prove nothing"
    solving.add_argument("--attack-from", metavar="FILE", help=again)
    output = command.add_argument_group("output")
    output.add_argument(
        "--emit", metavar="DIR", help="write each obligation as SMT-LIB, and a script run.sh that checks them"
    )
    output.add_argument("--trace", metavar="FILE", help="write the first counterexample as a trace")
    _format(output)


def explore(command: Parser) -> None:
    """Options of `koordgen explore`."""
    _program_or_fleet(command)
    fleet = command.add_argument_group("fleet")
    many = f"number of robots, 1 to {values.MOST_ROBOTS} (default: that of the fleet file; without one, 3)"
    fleet.add_argument("--robots", metavar="N", type=values.fleet_size, help=many)
    fleet.add_argument("--env", metavar="FILE", help="values of sensors and answers of callable ports (YAML)")
    _fleet(fleet, "a fleet file (YAML), for the values of params and the number of robots")
    _params(fleet)
    limits = command.add_argument_group("limits")
    limits.add_argument("--rounds", metavar="R", type=values.count, help="most rounds to explore (default: all)")
    limits.add_argument("--states", metavar="K", type=values.count, help="most states to visit (default: all)")
    limits.add_argument("--seconds", metavar="S", type=values.seconds, help="time limit, in seconds (default: none)")
    search = command.add_argument_group("search")
    apart = "explore also states that differ only in the order of robots"
    search.add_argument("--no-symmetry", dest="symmetry", action="store_false", help=apart)
    orders = "explore every order of robots, also if the order makes no difference"
    search.add_argument("--no-independence", dest="independence", action="store_false", help=orders)
    unread = "explore also states that differ only in values that are never read again"
    search.add_argument("--no-forgetting", dest="forgetting", action="store_false", help=unread)
    quiet = "do not report robots that wait for ever without `stop`"
    search.add_argument("--no-deadlock", dest="deadlock", action="store_false", help=quiet)
    output = command.add_argument_group("output")
    output.add_argument("--trace", metavar="FILE", help="write the run that violates a property as a trace")
    output.add_argument("--itf", metavar="FILE", help="write that run in the Informal Trace Format (JSON)")
    _format(output)


def fmt(command: Parser) -> None:
    """Options of `koordgen fmt`."""
    files = "programs; `-` reads standard input and writes standard output"
    command.positional.add_argument("files", metavar="FILE", type=values.program, nargs="+", help=files)
    mode = command.add_argument_group("what to do")
    mode.add_argument("--check", action="store_true", help="write nothing; exit status 1 if a file would change")
    mode.add_argument("--diff", action="store_true", help="like --check, and show the changes")
    mode.add_argument("--upgrade", action="store_true", help="also convert programs in the Koord dialect of 2020")
    _format(command.add_argument_group("output"))


def explain(command: Parser) -> None:
    """Options of `koordgen explain`."""
    code = "a code such as K030, a verdict such as NOT INDUCTIVE, or `skip` (default: list all codes)"
    command.positional.add_argument("code", metavar="CODE", nargs="*", help=code)


def estop(command: Parser) -> None:
    """Options of `koordgen estop`."""
    fleet = "the fleet file (YAML), or a folder that `koordgen build` wrote"
    command.positional.add_argument("fleet", metavar="FLEET", nargs="?", help=fleet)
    whom = command.add_argument_group("robots to stop")
    address = "address of another robot, as in a fleet file; may be repeated"
    whom.add_argument("--address", metavar="HOST:PORT", action="append", default=[], help=address)
    number = "the fleet's application_id (default: that of the fleet file, else 0)"
    whom.add_argument("--application", metavar="N", type=values.application, help=number)
    _key(whom)
    _format(command.add_argument_group("output"))


def status(command: Parser) -> None:
    """Options of `koordgen status`."""
    fleet = "the fleet file (YAML), or a folder that `koordgen build` wrote"
    command.positional.add_argument("fleet", metavar="FLEET", help=fleet)
    asking = command.add_argument_group("status")
    _key(asking)
    asking.add_argument("--watch", action="store_true", help="ask again every second, until Ctrl-C")
    _ssh(command)
    _format(command.add_argument_group("output"))


def dashboard(command: Parser) -> None:
    """Options of `koordgen dashboard`."""
    fleet = "the fleet file (YAML), a folder that `koordgen build` wrote, or the folder of a simulated run"
    command.positional.add_argument("fleet", metavar="FLEET", help=fleet)
    robots = command.add_argument_group("robots")
    _key(robots)
    robots.add_argument(
        "--control", action="store_true", help="show a button that stops all robots when it is held down"
    )
    page = command.add_argument_group("page")
    port = "port of the page; 0: any free port (default: 8470)"
    page.add_argument("--port", metavar="N", type=values.port_or_any, default=8470, help=port)
    bind = (
        "address of this computer for the page; another one than the default needs the three options below "
        "(default: 127.0.0.1)"
    )
    page.add_argument("--bind", metavar="ADDRESS", default="127.0.0.1", help=bind)
    page.add_argument("--tls-cert", metavar="FILE", help="certificate of the page (PEM), for https")
    page.add_argument("--tls-key", metavar="FILE", help="private key of that certificate (PEM, without a password)")
    token = "file of the token that a browser must send once; created if it does not exist"
    page.add_argument("--token", metavar="FILE", help=token)
    page.add_argument("--no-browser", dest="browser", action="store_false", help="do not open a browser")
    _foxglove(page, "fleet")


def basestation(command: Parser) -> None:
    """Options of `koordgen basestation`."""
    command.positional.add_argument("fleet", metavar="FLEET", help="the fleet file (YAML)")
    source = command.add_argument_group("motion capture system")
    systems = "vicon, optitrack, qualisys, vrpn: any system that the package motioncapture knows"
    source.add_argument("--system", metavar="NAME", required=True, help=systems)
    source.add_argument("--host", metavar="HOST", required=True, help="host name or address of the system's server")
    sending = command.add_argument_group("sending")
    _key(sending)
    rate = "most poses per second for each robot, 1 to 1000 (default: 50)"
    sending.add_argument("--rate", metavar="HZ", type=values.rate, default=50.0, help=rate)
    _diagnostics(command.add_argument_group("output"))


def doctor(command: Parser) -> None:
    """Options of `koordgen doctor`."""
    bundle = "a robot's folder on this computer, written by `koordgen build`"
    command.positional.add_argument("bundle", metavar="BUNDLE", nargs="?", help=bundle)
    settings = "JSON file whose entries replace those of the bundle's settings.json"
    command.add_argument_group("settings").add_argument("--settings", metavar="FILE", help=settings)
    _fleet(command.add_argument_group("fleet"), "check all robots of this fleet file over SSH, instead of a BUNDLE")
    _ssh(command)
    _format(command.add_argument_group("output"))


def start(command: Parser) -> None:
    """Options of `koordgen start`."""
    _deployed(command)
    _ssh(command)


def stop(command: Parser) -> None:
    """Options of `koordgen stop`."""
    _deployed(command)
    seconds = "time within which a robot must have stopped and its agent must have ended (default: 30)"
    stopping = command.add_argument_group("stopping")
    stopping.add_argument("--seconds", metavar="S", type=values.seconds, default=30.0, help=seconds)
    _ssh(command)


def logs(command: Parser) -> None:
    """Options of `koordgen logs`."""
    _deployed(command)
    lines = command.add_argument_group("lines")
    lines.add_argument(
        "--lines", metavar="N", type=values.natural, default=50, help="number of lines for each robot (default: 50)"
    )
    lines.add_argument("--follow", action="store_true", help="show new lines as they are written, until Ctrl-C")
    _ssh(command)


def collect(command: Parser) -> None:
    """Options of `koordgen collect`."""
    _named_fleet(command)
    output = command.add_argument_group("output")
    folder = "the run folder to write; an earlier collection in it is continued"
    output.add_argument("-o", "--out", metavar="FOLDER", required=True, help=folder)
    _quiet(output)
    _ssh(command)


def key(command: Parser) -> None:
    """Options of `koordgen key`."""
    action = "`new` creates a key; `rotate` installs a new key on all robots of a deployed fleet, or on none; `list` "
    action += "shows the keys that each robot needs"
    command.positional.add_argument("action", choices=("new", "rotate", "list"), help=action)
    file = "new: the file of the key, which must not exist yet; rotate, list: the fleet file (YAML)"
    command.positional.add_argument("file", metavar="FILE", help=file)
    _key(command.add_argument_group("rotate and list"))
    _ssh(command)
    _deployment_output(command)


def deploy(command: Parser) -> None:
    """Options of `koordgen deploy`."""
    _program_or_fleet(command)
    what = command.add_argument_group("what to deploy")
    _fleet(what, f"{_FLEET_OF_PROGRAM}; it has a `host` for each robot")
    _params(what)
    _key(what)
    over = "replace the release of another fleet in the same folder of a host"
    what.add_argument("--take-over", action="store_true", help=over)
    _ssh(command)
    _deployment_output(command)


def rollback(command: Parser) -> None:
    """Options of `koordgen rollback`."""
    command.positional.add_argument("fleet", metavar="FLEET", type=values.fleet, help="the fleet file (YAML)")
    what = command.add_argument_group("release")
    to = "a release that all robots still have (default: the previous release)"
    what.add_argument("--to", metavar="ID", type=values.release, help=to)
    _key(what)
    _ssh(command)
    _deployment_output(command)


_FLEET_OF_PROGRAM = "the fleet file (YAML), if APP.koord is a program"
# Conditions of all links between robots, which replace those of the scenario.
_NETWORK = {
    "loss": ("P", values.share, "share of datagrams that are lost, 0 to 1"),
    "delay": ("S", values.short_time, "delay of each datagram, in seconds, 0 to 10"),
    "jitter": ("S", values.short_time, "random additional delay, at most this many seconds, 0 to 10"),
    "duplication": ("P", values.share, "share of datagrams that arrive twice, 0 to 1"),
    "reordering": ("P", values.share, "share of datagrams that later datagrams overtake, 0 to 1"),
}
# Options that are passed to a harness's bundle under the same name.
PASSED = ("duration", "seed", "live", "foxglove", "pace", *_NETWORK)


def harness(command: Parser) -> None:
    """Options of a command that runs a harness's bundle."""
    _program_or_fleet(command)
    run = command.add_argument_group("run")
    _fleet(run, "the fleet file (YAML) (default: one simulated robot)")
    _duration(run, "length of the mission from its first round, in seconds (default: 30)")
    run.add_argument("--lockstep", action="store_true", help="run all robots in one process: deterministic and faster")
    run.add_argument("--seed", metavar="N", type=int, help="seed of all random numbers (default: 0)")
    follow = "run this counterexample of `koordgen explore` or `koordgen prove`"
    run.add_argument("--follow", metavar="TRACE", help=follow)
    _params(run)
    faults = command.add_argument_group("faults")
    faults.add_argument("--scenario", metavar="FILE", help="faults of the run, with their times (YAML)")
    for name, (metavar, type_, help) in _NETWORK.items():
        faults.add_argument(f"--{name}", metavar=metavar, type=type_, help=help)
    watch = command.add_argument_group("watch")
    live = "show the run in a browser, on a page of 127.0.0.1 (default of PORT: any free port)"
    watch.add_argument("--live", metavar="PORT", type=values.port, nargs="?", const=0, help=live)
    _foxglove(watch, "run")
    watch.add_argument("--gui", action="store_true", help="show PyBullet's window (MuJoCo has none: use --live)")
    pace = "limit the speed in lockstep to a multiple of real time (default: no limit)"
    watch.add_argument("--pace", metavar="FACTOR", type=values.factor, help=pace)
    output = command.add_argument_group("output")
    output.add_argument(
        "--out",
        metavar="DIR",
        help="folder for trace, summary and report (default: run-APP, or run-FLEET for a fleet file)",
    )
    later = "write no report; `koordgen report` can write it later"
    output.add_argument("--no-report", action="store_true", help=later)
    _quiet(output)
    _results(output)


def campaign(command: Parser) -> None:
    """Options of `koordgen campaign`."""
    _program_or_fleet(command)
    runs = command.add_argument_group("runs")
    _fleet(runs, _FLEET_OF_PROGRAM)
    runs.add_argument("--runs", metavar="N", type=values.count, help="number of runs (default: each combination once)")
    vary = (
        "settings that differ between runs, separated by commas: seed, seed=1:70, NAME=LO:HI, NAME=A,B,C; may be "
        "repeated"
    )
    runs.add_argument("--vary", metavar="NAME[=VALUES]", action="append", default=[], help=vary)
    _duration(runs, "length of each mission from its first round, in seconds (default: 30)")
    runs.add_argument("--lockstep", action="store_true", help="run on the simulated clock: deterministic and faster")
    runs.add_argument("--verdict", metavar="FILE", help="a Python script that judges the folder of each run")
    _params(runs)
    where = command.add_argument_group("where to run")
    jobs = "number of simultaneous runs (default: the number of cores; 1 in real time)"
    where.add_argument("--jobs", metavar="N", type=values.count, help=jobs)
    where.add_argument("--cluster", metavar="ADDRESS", help="the Dask scheduler that distributes the runs")
    output = command.add_argument_group("output")
    output.add_argument("--out", metavar="DIR", help="folder for runs, table and plots (default: campaign-APP)")
    output.add_argument("--reports", action="store_true", help="write the report of each run: some seconds for each")
    output.add_argument("--resume", action="store_true", help="continue the campaign in DIR")
    _quiet(output)
    _results(output)


def validate(command: Parser) -> None:
    """Options of `koordgen validate`."""
    _program_or_fleet(command)
    runs = command.add_argument_group("runs")
    _fleet(runs, _FLEET_OF_PROGRAM)
    application = "the application whose assumptions to test, if several of a fleet file have assumptions"
    runs.add_argument("--application", metavar="NAME", help=application)
    samples = "number of runs, each from another start (default: as many as --epsilon and --gamma need)"
    runs.add_argument("--samples", metavar="N", type=values.count, help=samples)
    epsilon = "VALIDATED means: a run violates an assumption with a probability below E (default: 0.05)"
    runs.add_argument("--epsilon", metavar="E", type=values.probability, default=0.05, help=epsilon)
    gamma = "the confidence of the verdict is 1 - G (default: 0.05)"
    runs.add_argument("--gamma", metavar="G", type=values.probability, default=0.05, help=gamma)
    runs.add_argument(
        "--seconds", metavar="S", type=values.seconds, default=30.0, help="length of each run (default: 30)"
    )
    runs.add_argument("--seed", metavar="K", type=values.natural, default=1, help="seed of the first run (default: 1)")
    _params(runs)
    reach = command.add_argument_group("reach sets")
    reach.add_argument("--reachsets", action="store_true", help="also compute the places that each platform can reach")
    offset = "target of a platform, relative to its start: metres east, north, up (default: 0.7,0.4,0)"
    reach.add_argument("--offset", metavar="X,Y,Z", type=values.offset, default=(0.7, 0.4, 0.0), help=offset)
    where = command.add_argument_group("where to run")
    jobs = "number of simultaneous runs (default: the number of cores)"
    where.add_argument("--jobs", metavar="J", type=values.count, help=jobs)
    where.add_argument("--cluster", metavar="ADDRESS", help="the Dask scheduler that distributes the runs")
    output = command.add_argument_group("output")
    output.add_argument(
        "--out",
        metavar="DIR",
        help="folder for runs, table and picture (default: validate-APP, or validate-FLEET-NAME)",
    )
    _quiet(output)
    _format(output)


def replay(command: Parser) -> None:
    """Options of `koordgen replay`."""
    trace = "a run's folder, its trace.jsonl, or a robot's own trace"
    command.positional.add_argument("trace", metavar="TRACE", help=trace)
    _of_a_trace(command)
    limits = command.add_argument_group("limits")
    limits.add_argument("--seconds", metavar="S", type=values.seconds, help="time limit, in seconds (default: none)")
    _diagnostics(command.add_argument_group("output"))


def audit(command: Parser) -> None:
    """Options of `koordgen audit`."""
    traces = "traces of robots, folders with such traces, a run's folder, or its trace.jsonl"
    command.positional.add_argument("traces", metavar="TRACE", nargs="+", help=traces)
    _of_a_trace(command)
    judging = command.add_argument_group("checks")
    proof = "run the prover for each invariant that was violated"
    judging.add_argument("--prove", action="store_true", help=proof)
    judging.add_argument("--seconds", metavar="S", type=values.seconds, help="time limit, in seconds (default: none)")
    output = command.add_argument_group("output")
    output.add_argument("--plot", metavar="FILE", help="draw the properties over time (png, svg or pdf)")
    _format(output)


def report(command: Parser) -> None:
    """Options of `koordgen report`."""
    _trace(command)
    output = command.add_argument_group("output")
    page = "the page to write (default: report.html beside the trace)"
    output.add_argument("-o", "--out", metavar="FILE", help=page)


def export(command: Parser) -> None:
    """Options of `koordgen export`."""
    _trace(command)
    output = command.add_argument_group("output")
    formats = ("mcap", "csv", "png", "gif", "mp4", "koord-trace/2")
    output.add_argument("--to", choices=formats, required=True, help="the format to write")
    output.add_argument("-o", "--out", metavar="PATH", help="file or folder to write (default: beside the trace)")


def show(command: Parser) -> None:
    """Options of `koordgen show`."""
    _trace(command)
    time = command.add_argument_group("time")
    when = "seconds since round 1 (default: the first violation; without one, the mission's end)"
    time.add_argument("--at", metavar="S", type=values.time_of_run, help=when)
    _format(command.add_argument_group("output"))


def help_(command: Parser) -> None:
    """Options of `koordgen help`."""
    command.positional.add_argument("topic", metavar="COMMAND", nargs="?", help="a command (default: list all)")


def completion(command: Parser) -> None:
    """Options of `koordgen completion`."""
    command.positional.add_argument("shell", choices=("bash", "zsh", "fish"), help="the shell that reads the script")


def _program(command: Parser) -> None:
    command.positional.add_argument("program", metavar="APP.koord", type=values.program, help="the program")


def _program_or_fleet(command: Parser) -> None:
    file = "the program, or a fleet file (YAML) that names the programs of its applications"
    command.positional.add_argument("program", metavar="APP.koord", help=file)


def _trace(command: Parser) -> None:
    command.positional.add_argument("trace", metavar="TRACE", help="a run's folder, or its trace.jsonl")


def _of_a_trace(command: Parser) -> None:
    program = command.add_argument_group("the trace's program")
    where = "the program (default: the copy in the run's folder)"
    program.add_argument("--program", metavar="APP.koord", type=values.program, help=where)
    _fleet(program, "a fleet file (YAML), for the values of params")
    _params(program)


def _fleet(group: Group, help: str, required: bool = False) -> None:
    group.add_argument("--fleet", metavar="FILE", type=values.fleet, required=required, help=help)


def _params(group: Group) -> None:
    value = "value of a param, which replaces that of the fleet file; may be repeated"
    group.add_argument("--param", metavar="NAME=VALUE", action="append", default=[], help=value)
    functions = "Python file of the extern functions (default: APP_functions.py beside the program)"
    group.add_argument("--functions", metavar="FILE", help=functions)


def _duration(group: Group, help: str) -> None:
    group.add_argument("--duration", metavar="S", type=values.seconds, help=help)


def _key(group: Group) -> None:
    where = "file of the fleet's key (default: beside the fleet file, or in the working directory)"
    group.add_argument("--key", metavar="FILE", help=where)


def _deployed(command: Parser) -> None:
    _named_fleet(command)
    robots = "names of robots (default: all robots of the fleet)"
    command.positional.add_argument("robots", metavar="ROBOT", nargs="*", help=robots)


def _named_fleet(command: Parser) -> None:
    command.positional.add_argument("fleet", metavar="FLEET", type=values.fleet, help="the fleet file (YAML)")
    command.set_defaults(format="text")  # of errors in the fleet file


def _ssh(command: Parser) -> None:
    group = command.add_argument_group("ssh")
    config = "SSH configuration file (default: ~/.ssh/config)"
    group.add_argument("--ssh-config", metavar="FILE", help=config)
    known = "file of trusted host keys (default: as SSH is configured, ~/.ssh/known_hosts)"
    group.add_argument("--known-hosts", metavar="FILE", help=known)
    identity = "file of your private key (default: as SSH is configured, or that of ssh-agent)"
    group.add_argument("--identity", metavar="FILE", help=identity)


def _deployment_output(command: Parser) -> None:
    output = command.add_argument_group("output")
    _quiet(output)
    _format(output)


def _quiet(group: Group) -> None:
    group.add_argument("--quiet", action="store_true", help="show no progress")


def _foxglove(group: Group, what: str) -> None:
    help = f"stream the {what} to Foxglove, at this port of 127.0.0.1; 0: any free port (default of PORT: 8765)"
    group.add_argument("--foxglove", metavar="PORT", type=values.port_or_any, nargs="?", const=8765, help=help)


def _format(group: Group) -> None:
    help = "format of the results (default: text)"
    group.add_argument("--format", choices=("text", "json"), default="text", help=help)


def _results(group: Group) -> None:
    _diagnostics(group, "text; json: diagnostics and verdict as one document; sarif: diagnostics only (default: text)")


def _diagnostics(group: Group, help: str = "format of the diagnostics (default: text)") -> None:
    group.add_argument("--format", choices=("text", "json", "sarif"), default="text", help=help)
