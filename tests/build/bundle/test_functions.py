"""Functions files are checked before the build writes anything, and their code cannot harm the build."""

from __future__ import annotations

from pathlib import Path

import pytest

from koordgen.build.bundle import probe
from koordgen.build.bundle.functions import check_functions, functions_file
from tests.build.emit.generated import checked

PROGRAM = checked(
    "extern fun half(float x) -> float\n"
    "extern type Ticket\n"
    "extern fun stamp(Ticket t, int class) -> Ticket\n"
    "local:\n  float x = 1\n  Ticket t\n"
    "E:\n  pre: True\n  eff:\n    x = half(x)\n    t = stamp(t, 1)\n"
)
RIGHT = """
from dataclasses import dataclass
print("hello")

@dataclass
class Ticket:
    number: int = 0

def half(x): return x / 2
def stamp(t, class_, more=None): return t
"""


def told(tmp_path: Path, text: str | None) -> list[tuple[int, str]]:
    file = functions_file(PROGRAM, tmp_path, None)
    assert file == tmp_path / "a_functions.py"
    if text is not None:
        file.write_text(text)
    found = check_functions(PROGRAM, file)
    assert all(d.code == "B006" and d.help for d in found)
    return [(d.span.line, d.message) for d in found]


def test_right_functions(tmp_path: Path) -> None:
    assert told(tmp_path, RIGHT) == []
    assert not (tmp_path / "__pycache__").exists()


def test_any_parameters_serve(tmp_path: Path) -> None:
    assert told(tmp_path, RIGHT + "\nhalf = lambda *args: 1.0\nstamp = max\n") == []


@pytest.mark.parametrize(
    ("added", "line", "message"),
    [
        ("del half", 1, "a_functions.py has no function half"),
        ("half = 3", 1, "a_functions.py has no function half"),
        ("class half: pass", 1, "a_functions.py has no function half"),
        ("def half(y): pass", 1, "half has the parameters (y) in a_functions.py, but (x) in the program"),
        ("def half(): pass", 1, "half has the parameters () in a_functions.py, but (x) in the program"),
        ("def half(x, y): pass", 1, "half has the parameters (x, y) in a_functions.py, but (x) in the program"),
        ("def half(x, *, y): pass", 1, "half has the parameters (x) in a_functions.py, but (x) in the program"),
        ("del Ticket", 2, "a_functions.py has no class Ticket"),
        ("def Ticket(): pass", 2, "a_functions.py has no class Ticket"),
        (
            "class Ticket:\n  def __init__(self, n): pass",
            2,
            "the class Ticket in a_functions.py cannot be an extern type: ",
        ),
        ("class Ticket: pass", 2, "the class Ticket in a_functions.py cannot be an extern type: "),
        ("1 / 0", 1, "a_functions.py cannot be imported: ZeroDivisionError: division by zero (line 11)"),
        ("import no_such_thing", 1, "a_functions.py cannot be imported: ModuleNotFoundError: No module named"),
        ("def half(x: pass", 1, "a_functions.py cannot be imported: SyntaxError"),
        ("raise SystemExit(0)", 1, "a_functions.py cannot be imported: SystemExit: 0 (line 11)"),
        ("import os; os._exit(7)", 1, "a_functions.py cannot be imported: its import ended the process (status 7)"),
        ("import os; os.kill(os.getpid(), 9)", 1, "a_functions.py cannot be imported: its import ended the process"),
    ],
)
def test_what_is_wrong_is_told_at_its_declaration(tmp_path: Path, added: str, line: int, message: str) -> None:
    ((at, said),) = told(tmp_path, RIGHT + f"{added}\n")
    assert (at, said[: len(message)]) == (line, message)


def test_no_file(tmp_path: Path) -> None:
    ((line, message),) = told(tmp_path, None)
    assert line == 1 and message.endswith("a_functions.py, which should have the extern functions")


def test_an_import_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "TIMEOUT", 0.5)
    ((line, message),) = told(tmp_path, "while True: pass")
    assert line == 1 and message.startswith("a_functions.py cannot be imported: its import did not end within")


def test_threads_and_exit_handlers_of_the_file_do_not_keep_the_build(tmp_path: Path) -> None:
    forever = "import atexit, threading\natexit.register(lambda: threading.Event().wait())\n"
    assert told(tmp_path, RIGHT + forever + "threading.Thread(target=threading.Event().wait).start()\n") == []


def test_another_file_may_be_named_and_a_program_without_any_needs_none(tmp_path: Path) -> None:
    assert functions_file(PROGRAM, tmp_path, "other.py") == Path("other.py")
    none = checked("local: int i\nE:\n  pre: True\n  eff: i = 1\n")
    assert functions_file(none, tmp_path, None) is None and check_functions(none, None) == []
