"""The pages to work through: their files, commands and outputs, from an empty folder to the last command."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from koordgen.build.pipeline import Rejected, check_file, read_fleet
from koordgen.cli.commands import parsed
from koordgen.fleet import manifest
from koordgen.verify.prove.report.verdict import Question, prove
from koordgen.verify.prove.smt.solve import Limits, Solver

DOCS = Path(__file__).parents[1] / "docs"
TUTORIAL = "tutorial/first-fleet.md"
# Pages with all their files, and the files that their last command leaves.
FOLLOWED = {
    TUTORIAL: ["run/report.html", "crash/report.html", "build/line/ann/program.py"],
    "how-to/own-planner.md": ["run/report.html"],
    "how-to/own-platform.md": ["run/report.html"],
}
HOW_TO = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.glob("how-to/*.md"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"-?\d+\.\d+|\d+")
VARYING = re.compile(r"\d+ ms|\d+ states")  # times, and how far an attack came within its time
NEAR = 0.15  # metres and seconds: contact engines, and builds of them, differ


def steps(name: str) -> Iterator[tuple[str, str, str]]:
    """(kind, file, text) of each listing: `save` a file, `edit` one, or `run` commands."""
    page = (DOCS / name).read_text(encoding="utf-8")
    for match in BLOCK.finditer(page):
        kind, text = match[1], match[2]
        above = page[: match.start()].rstrip().rpartition("\n\n")[2]
        if saved := re.match(r"Save this as `([\w.]+)`", above):
            yield "save", saved[1], text
        elif edited := re.match(r"In `([\w.]+)`:", above):
            assert kind == "diff", f"an edit of {edited[1]} as {kind}"
            yield "edit", edited[1], text
        else:
            assert kind == "console", f"a listing of kind {kind} that nothing reads:\n{text}"
            yield "run", "", text


def edit(path: Path, diff: str) -> None:
    old, new = ("".join(line[1:] + "\n" for line in diff.splitlines() if line[0] == sign) for sign in "-+")
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1, old
    path.write_text(text.replace(old, new), encoding="utf-8")


def run(command: str, folder: Path) -> list[str]:
    """The lines that the command writes on both streams."""
    prelude = f'koordgen() {{ {shlex.quote(sys.executable)} -m koordgen "$@"; }}; exec 2>&1; '
    done = subprocess.run(["bash", "-c", prelude + command], cwd=folder, capture_output=True, text=True, check=False)
    return done.stdout.splitlines()


def agree(shown: str, real: str) -> bool:
    """Whether a line of the page is a line of an output: `...` ends it, numbers with a point may differ a little."""
    cut = shown.endswith("...")
    shown, real = (VARYING.sub("*", " ".join(line.removesuffix("...").split())) for line in (shown, real))
    if cut:
        return real.startswith(shown.rstrip())
    if NUMBER.sub("#", shown).replace("-#", "#") != NUMBER.sub("#", real).replace("-#", "#"):
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(real), strict=True)
    return all(abs(float(a) - float(b)) <= (NEAR if "." in a else 0) for a, b in pairs)


def compare(shown: list[str], real: list[str], command: str) -> None:
    """A line `...` of the page stands for any number of lines."""
    left, skipping = list(real), False
    for line in shown:
        if line == "...":
            skipping = True
            continue
        while skipping and left and not agree(line, left[0]):
            left.pop(0)
        assert left and agree(line, left[0]), f"$ {command}\npage: {line}\nreal:\n" + "\n".join(real)
        left.pop(0)
        skipping = False
    assert skipping or not left, f"$ {command}\nthe page lacks:\n" + "\n".join(left)


@pytest.mark.parametrize("name", FOLLOWED)
def test_every_command_does_what_the_page_shows(name: str, tmp_path: Path) -> None:
    commands = 0
    for kind, file, text in steps(name):
        if kind == "save":
            (tmp_path / file).write_text(text, encoding="utf-8")
        elif kind == "edit":
            edit(tmp_path / file, text)
        else:
            for each in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
                command, *shown = each.splitlines()
                compare(shown, run(command, tmp_path), command)
                commands += 1
    assert commands == len(re.findall(r"^\$ ", (DOCS / name).read_text(encoding="utf-8"), re.MULTILINE)) >= 1
    assert all((tmp_path / left).exists() for left in FOLLOWED[name])


def programs(name: str) -> list[tuple[str, str]]:
    """The programs of a page, with the text from each to the next listing."""
    parts = re.split(
        r"^```koord\n(.*?)^```$", (DOCS / name).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    return list(zip(parts[1::2], parts[2::2], strict=True))


@pytest.mark.parametrize("name", [TUTORIAL, *HOW_TO])
def test_every_program_checks_without_a_word(name: str, tmp_path: Path) -> None:
    for number, (text, _) in enumerate(programs(name)):
        path = tmp_path / f"p{number}.koord"
        path.write_text(text, encoding="utf-8")
        try:
            assert check_file(str(path)).diagnostics == (), text
        except Rejected as error:
            pytest.fail(f"{error.found}\n{text}")


def commands() -> list[tuple[str, str]]:
    """(page, command) of each call of koordgen in a listing, in one line and without `...`."""
    found = []
    for path in sorted(DOCS.rglob("*.md")):
        for listing in re.findall(r"^```.*?\n(.*?)^```", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
            for line in listing.splitlines():
                line = re.sub(r"^(\$|[a-z]+[$@][a-z$]*) ", "", line).partition("; echo")[0]
                if (
                    path.parent.name != "adr"
                    and line.startswith("koordgen ")
                    and not re.search(r"\.\.\.|\\$|[<>]", line)
                ):
                    found.append((path.relative_to(DOCS).as_posix(), line))
    return found


@pytest.mark.parametrize(("page", "command"), [pair for pair in commands() if "duraton" not in pair[1]])
def test_every_command_of_a_page_can_be_called_so(page: str, command: str) -> None:
    parsed(shlex.split(command, comments=True)[1:])


@pytest.mark.parametrize("name", sorted({*HOW_TO} - {*FOLLOWED}))
def test_every_piece_of_a_fleet_file_fits_into_one(name: str, tmp_path: Path) -> None:
    """Each listing of YAML, in place of the same keys of the tutorial's fleet file."""
    (whole,) = [text for kind, file, text in steps(TUTORIAL) if (kind, file) == ("save", "fleet.yaml")]
    program = tmp_path / "p.koord"
    program.write_text(
        "param float margin = 0.5\nparam Point dock = Point(0, 0, 0)\n"
        "using Lamp:\n  actuators: bool on\nGo:\n  pre: True\n  eff: Lamp.on = True\n"
    )
    targets = {target: manifest.load(target) for target in manifest.available()}
    page = (DOCS / name).read_text(encoding="utf-8")
    for own in re.findall(r"^```yaml\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL):
        path = tmp_path / "fleet.yaml"
        path.write_text(yaml.safe_dump({**yaml.safe_load(whole), **yaml.safe_load(own)}))
        try:
            read_fleet(str(path), targets, check_file(str(program)).program)
        except Rejected as error:
            pytest.fail(f"{error.found}\n{own}")


def test_every_verdict_of_the_page_about_invariants_is_the_provers(tmp_path: Path) -> None:
    """`The verdict is X` below a program is the worst of its verdicts.

    `Without the line Y, the verdict is Z` is tried, too.
    """
    told = 0
    order = ["FALSIFIED", "NOT INDUCTIVE", "UNKNOWN", "PROVED"]

    def worst(text: str) -> str:
        path = tmp_path / "p.koord"
        path.write_text(text, encoding="utf-8")
        with Solver("z3", Limits(query=10.0, total=60.0)) as solver:
            found = prove(Question(check_file(str(path)).program), solver)
        return min((verdict.verdict for verdict in found), key=order.index)

    for text, below in programs("how-to/inductive-invariants.md"):
        words = " ".join(below.split())
        says = re.search(r"The verdict is ([A-Z]+(?: [A-Z]+)*)", words)
        assert says and worst(text) == says[1], text
        told += 1
        if without := re.search(r"Without the line `([^`]+)`, the verdict is ([A-Z]+)", words):
            kept = [line for line in text.splitlines(keepends=True) if not line.strip().startswith(without[1])]
            assert len(kept) == len(text.splitlines()) - 1 and worst("".join(kept)) == without[2], without[1]
            told += 1
    assert told == 6


@pytest.mark.parametrize(
    ("shown", "real", "fits"),
    [
        ("(3 obligations, 21 ms)", "(3 obligations, 9 ms)", True),
        ("(3 obligations, 21 ms)", "(4 obligations, 21 ms)", False),
        ("(-4.00, 0.01)", "(-4.05,  -0.02)", True),
        ("(-4.00, 0.01)", "(4.00, 0.01)", False),
        ("does not hold: ...", "does not hold: 1", True),
        ("HELD", "VIOLATED", False),
    ],
)
def test_lines_are_compared_by_their_numbers(shown: str, real: str, fits: bool) -> None:
    assert agree(shown, real) == fits
