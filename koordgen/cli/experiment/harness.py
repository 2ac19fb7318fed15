"""Commands of harnesses, such as `koordgen sim`: build a simulation bundle and run it with the command's options."""

from __future__ import annotations

import json
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from koordgen.cli.base import building, console
from koordgen.cli.base.options import PASSED
from koordgen.cli.base.values import is_fleet
from koordgen.fleet import manifest

# Default fleet file: one robot in the middle of an empty space. Metres (local ENU), radians, seconds.
ALONE = """\
delta: 0.1
origin: {{latitude: 47.397742, longitude: 8.545594, altitude: 488.0}}
geofence: {{lo: [-10, -10, -1], hi: [10, 10, 10]}}
robots:
  - {{name: robot, target: {target}, address: 127.0.0.1:47100, start: {{position: [0, 0, 0], yaw: 0}}}}
"""


def harness(options: Namespace) -> int:
    """Build a simulation bundle, run it, and return the exit status of the run.

    Without a fleet file, one robot runs alone. Raises Failure."""
    if options.fleet is not None or is_fleet(options.program):
        return _harness(options)
    if options.follow is not None:
        raise console.Failure(
            console.USAGE, "--follow needs --fleet", "give a fleet file with as many robots as the trace has"
        )
    with tempfile.TemporaryDirectory(prefix="koordgen-") as folder:
        options.fleet = f"{folder}/fleet.yaml"
        target = manifest.load(options.command).alone
        Path(options.fleet).write_text(ALONE.format(target=target), encoding="utf-8")
        more = "for more robots, see `koordgen docs fleet`"
        console.notify(f"note: no --fleet: one simulated {target} runs alone; {more}")
        return _harness(options)


def _harness(options: Namespace) -> int:
    options.collected = []
    more, plan = _followed(options)
    bundles, app = building.planned(options, [options.command], more, squads=options.follow is None)
    building.require_packages()
    bundle = bundles[options.command]
    scenario = read_scenario(options.scenario, bundle, options.duration) if options.scenario else None
    passed = [f"--{key}={value}" for key in PASSED if (value := getattr(options, key)) is not None]
    out = Path(options.out or f"run-{app}")
    passed.append(f"--out={out}")
    passed.append(f"--invoked-as={shlex.join(['koordgen', *sys.argv[1:]])}")
    flags = ("lockstep", "gui", "quiet", "no-report")
    passed += [f"--{flag}" for flag in flags if getattr(options, flag.replace("-", "_"))]
    with tempfile.TemporaryDirectory(prefix="koordgen-") as folder:
        building.write({options.command: bundle}, Path(folder))
        if plan is not None:
            follow = Path(folder) / "follow.json"
            follow.write_text(json.dumps(plan), encoding="utf-8")
            passed.append(f"--follow={follow}")
        if scenario is not None:
            file = Path(folder) / "scenario.json"
            file.write_text(json.dumps(scenario), encoding="utf-8")
            passed.append(f"--scenario={file}")
        began = time.time()
        status = _run([sys.executable, f"{folder}/{options.command}", *passed], options)
    if options.format == "json":
        _print_verdict(options, out, status, began)
    return status


def _print_verdict(options: Namespace, out: Path, status: int, began: float) -> None:
    """Print the results of a run as JSON.

    A run that failed leaves no `summary.json`. Nothing is printed then, because the run has reported its error."""
    summary = out / "summary.json"
    try:
        if summary.stat().st_mtime < began:
            return
        found = json.loads(summary.read_bytes())
    except (OSError, ValueError):
        return
    results = {"verdict": found["verdict"], "status": status, "folder": str(out), "summary": found}
    console.print_document(options, results)


def _followed(options: Namespace) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Return the params and the plan for executing the counterexample in `--follow`; ({}, None) without the option."""
    if options.follow is None:
        return {}, None
    from koordgen.cli.experiment.follow import plan_of_trace

    return plan_of_trace(options)


def _run(command: list[str], options: Namespace) -> int:
    # At the first signal, the run ends and writes its report; at a second signal, it ends immediately. The run has its
    # own process group, so that a Ctrl-C in the terminal does not reach it twice: directly and by `pass_on`.
    started: list[subprocess.Popen[bytes]] = []
    early: list[int] = []

    def pass_on(number: int, _: object) -> None:
        asked = signal.SIGTERM if number == signal.SIGHUP else number
        started[0].send_signal(asked) if started else early.append(asked)

    watched = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
    # This process passes on no signal that it ignores, such as SIGHUP under nohup: the run ignores that signal as well.
    heard = [each for each in watched if signal.getsignal(each) != signal.SIG_IGN]
    before = {each: signal.signal(each, pass_on) for each in heard}
    try:
        started.append(subprocess.Popen(command, stdout=console.output(options), process_group=0))
        for asked in early:
            started[0].send_signal(asked)
        status = started[0].wait()
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    if status < 0:
        message = f"the run was killed by {signal.Signals(-status).name} and left no report"
        raise console.Failure(console.SURROUNDINGS, message)
    return status


def read_scenario(path: str, bundle: Mapping[str, bytes], duration: float | None) -> Any:
    """Read and check a scenario file, and return its content as the simulation bundle expects it.

    `duration`: length of the run in seconds; None for the default length. Raises Rejected with all errors."""
    from koordgen.build.pipeline import Rejected, read_source
    from koordgen.fleet.scenario import read
    from koordgen.lang.diagnostics import Diagnostic
    from koordgen.lang.resources import targets
    from koordgen.lang.source import Source, Span

    sys.path.append(str(targets().parent))
    from targets.sim.base.schedule import DURATION
    from targets.sim.base.schedule import read as check

    robots = [robot["name"] for robot in json.loads(bundle["scenario.json"])["robots"]]
    source = read_source(path)
    found: list[tuple[Source, Diagnostic]] = []

    def report(code: str, message: str, span: Span, help: str) -> None:
        found.append((source, Diagnostic(code, "error", message, span, help=help)))

    data = read(source, lambda plain: check(plain, robots, duration or DURATION)[1], report)
    if found:
        raise Rejected(found)
    return data
