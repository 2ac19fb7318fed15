"""Time of `koordgen check` and `koordgen build` as whole processes, relative to the time of their imports alone.

The peer is `python -c "import lark, jinja2"`, run in turn with ours, so a machine whose speed changes affects both.
Also measured: how the time of `check` grows with the length of the program; it must be linear. With `--first PATH`, a
checkout of the first working version (`git worktree add PATH 8d43803`), it is compared with that version on 10,000
lines.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Byte code is kept between runs, as on any machine.
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
LINEFORM = str(ROOT / "examples/lineform/lineform.koord")


def seconds(command: list[str], root: Path = ROOT) -> float:
    """Return the wall-clock time of one process, with the koordgen of that checkout."""
    environment = ENVIRONMENT | {"PYTHONPATH": str(root)}
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=root, env=environment)
    return time.perf_counter() - start


def in_turn(commands: dict[str, list[str]], runs: int, output: Path) -> dict[str, list[float]]:
    """Run each command once in each lap, after a warm-up lap. `output` is removed between laps."""
    times: dict[str, list[float]] = {name: [] for name in commands}
    for lap in range(runs + 1):
        shutil.rmtree(output, ignore_errors=True)
        for name, command in commands.items():
            taken = seconds(command)
            if lap:
                times[name].append(taken)
    return times


def program(lines: int) -> str:
    """Return a well-formed program of about this many lines: events of five lines over a few variables."""
    head = (
        "using Motion:\n  sensors: Point position\n  actuators: Point target\n"
        "allread: Point x[N_SYS]\nallwrite: int total\nlocal:\n  int count\n  float level = 0.5\n"
    )
    events = [
        f"Event{i}:\n  pre: pid == {i} and count < {i} + 3\n  eff:\n"
        f"    count = count + {i}\n    if level > {i}.5:\n      Motion.target = (x[pid] + Motion.position) / 2\n"
        for i in range(max(1, (lines - 8) // 6))
    ]
    return head + "".join(events)


def ratios(times: dict[str, list[float]], peer: str) -> dict[str, float]:
    """Return the median over all laps of own time / peer's time in the same lap."""
    return {
        name: statistics.median(a / b for a, b in zip(values, times[peer], strict=True))
        for name, values in times.items()
        if name != peer
    }


def beside(command: list[str], first: Path, laps: int) -> list[tuple[float, float]]:
    """Return wall-clock times of a command with this koordgen and another checkout, in turn, after a warm-up lap."""
    return [(seconds(command), seconds(command, first)) for _ in range(laps + 1)][1:]


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--quick", action="store_true", help="fewer runs, under a minute")
    options.add_argument("--json", metavar="FILE", type=Path, help="write the figures there as well")
    options.add_argument("--first", metavar="PATH", type=Path, help="a checkout of the first working version")
    arguments = options.parse_args()
    runs = 15 if arguments.quick else 51
    koordgen = [sys.executable, "-m", "koordgen"]
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "build"
        times = in_turn(
            {
                "import lark, jinja2": [sys.executable, "-c", "import lark, jinja2"],
                "check": [*koordgen, "check", LINEFORM],
                "build": [*koordgen, "build", LINEFORM, "--target", "quad,car", "-o", str(output)],
            },
            runs,
            output,
        )
        growth = {}
        for lines in (100, 1_000, 10_000):
            path = Path(folder) / f"long{lines}.koord"
            path.write_text(program(lines), encoding="utf-8")
            command = [*koordgen, "check", str(path)]
            growth[lines] = statistics.median(seconds(command) for _ in range(3 if arguments.quick else 7))
        pairs = beside(command, arguments.first.resolve(), 7 if arguments.quick else 21) if arguments.first else []
    found = ratios(times, "import lark, jinja2")
    for name, values in times.items():
        print(f"{name:22} median {statistics.median(values) * 1e3:7.1f} ms   min {min(values) * 1e3:7.1f} ms")
    print(f"ratio check / imports  {found['check']:.2f}   (wanted: at most 1.0)")
    print(f"ratio build / imports  {found['build']:.2f}   (wanted: at most 1.5)")
    base = statistics.median(times["check"])
    for lines, taken in growth.items():
        print(
            f"check {lines:6} lines: {taken * 1e3:8.1f} ms, {(taken - base) / lines * 1e6:6.1f} us a line over start-up"
        )
    if pairs:
        found["check of 10,000 lines / first version"] = statistics.median(now / then for now, then in pairs)
        now, then = (statistics.median(times) for times in zip(*pairs, strict=True))
        print(f"check 10000 lines: {now:.3f} s, first version {then:.3f} s; median ratio of pairs", end=" ")
        print(f"{found['check of 10,000 lines / first version']:.2f}   (wanted: at most 0.33)")
    if arguments.json:
        figures = {"median_seconds": {n: statistics.median(v) for n, v in times.items()}, "ratios": found,
                   "check_seconds_by_lines": growth}  # fmt: skip
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
