"""`koordgen sim` and its child process: a signal reaches the run once, and a killed run is reported."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

# The command with a bundle of our own in place of the simulator.
COMMAND = """
import sys
from pathlib import Path
from koordgen import cli
from koordgen.cli.base import building

def write(bundles, folder):
    (folder / "sim").mkdir()
    (folder / "sim/__main__.py").write_text(sys.argv[1])

building.planned = lambda *given, **more: ({"sim": {}}, "app")
building.require_packages = lambda: None
building.write = write
sys.exit(cli.main(["sim", "app.koord", "--fleet", "fleet.yaml"]))
"""
COUNTING = """
import signal, sys, time
counted = []
for each in (signal.SIGINT, signal.SIGTERM):
    signal.signal(each, lambda number, _: counted.append(number))
print("ready", flush=True)
while not counted:
    time.sleep(0.01)
time.sleep(0.3)
print(len(counted), __file__, flush=True)
sys.exit(130)
"""


def start(program: str, command: str = COMMAND) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", command, program],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )  # fmt: skip


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("send", [os.kill, os.killpg], ids=["to the command", "to its group"])
def test_a_signal_reaches_the_run_once(send: Callable[[int, int], None], number: signal.Signals) -> None:
    command = start(COUNTING)
    assert command.stdout is not None
    assert command.stdout.readline() == "ready\n"
    send(command.pid, number)
    out, err = command.communicate(timeout=20)
    count, file = out.split()
    assert (command.returncode, count) == (130, "1"), err
    assert not Path(file).exists(), "the temporary bundle is gone"


def test_a_run_that_is_killed_is_told() -> None:
    command = start("import os; os.kill(os.getpid(), 9)")
    _, err = command.communicate(timeout=20)
    assert command.returncode == 5
    assert "SIGKILL" in err


def test_signals_have_their_handlers_of_before_when_the_run_has_ended() -> None:
    handlers = "import signal\nkept = [signal.getsignal(n) for n in (2, 15, 1)]\n"
    same = "sys.exit(7 if kept == [signal.getsignal(n) for n in (2, 15, 1)] else 8)"
    command = start("pass", handlers + COMMAND.replace("sys.exit(cli.main", "print(cli.main") + same)
    out, err = command.communicate(timeout=20)
    assert (out, command.returncode) == ("0\n", 7), err
