"""A newcomer's questions: the answer to each is at most two clicks from README.md."""

from __future__ import annotations

from pathlib import Path

import pytest

from koordgen.cli.docs import sections
from tests.test_pages import ROOT, links

MAP = "docs/README.md"
# Question, the pages that a reader opens one after the other from README.md, the heading of the answer, words in it.
ASKED = [
    ("How do I add an obstacle?", [MAP, "docs/how-to/change-a-fleet.md"], "Add an obstacle", "obstacles:"),
    ("Why does my robot skip?", ["docs/how-to/skipped-rounds.md"], "Find the reason", "not current: lacks"),
    ("What does NOT INDUCTIVE mean?", ["docs/explanation/proofs.md"], "Verdicts", "NOT INDUCTIVE"),
    ("How do I change the speed?", ["docs/how-to/change-a-fleet.md"], "Change the speed", "max_speed"),
    ("Which Python does the Raspberry Pi need?", ["docs/reference/targets.md"], "Python versions", "3.10 to 3.14"),
    ("How do I stop everything?", ["docs/how-to/stop-a-fleet.md"], "Now, all robots", "koordgen estop fleet.yaml"),
    ("How do I add a robot?", [MAP, "docs/how-to/change-a-fleet.md"], "Add or remove a robot", "address"),
    ("What happens when a robot fails?", ["docs/explanation/safety.md"], "When robots lose each other", "majority"),
    ("What does error K030 mean?", ["docs/reference/errors.md"], "Codes of programs", "| K030 |"),
    ("Has it flown on real hardware?", [MAP, "docs/explanation/real-autopilots.md"], "What was never flown", "No quad"),
    ("How many robots can a fleet have?", [MAP, "docs/explanation/shared-memory.md"], "Limits", "| 128 |"),
    (
        "How do I use my own planner?",
        ["docs/how-to/own-planner.md"],
        "A program and a fleet that use the planner",
        'planner: "own:Over"',
    ),
]


@pytest.mark.parametrize(("question", "clicks", "heading", "words"), ASKED)
def test_an_answer_is_two_clicks_away(question: str, clicks: list[str], heading: str, words: str) -> None:
    assert 1 <= len(clicks) <= 2
    page = Path("README.md")
    for step in map(Path, clicks):
        assert step in {to for to, _ in links(page)}, f"{question} {page} has no link to {step}"
        page = step
    text = (ROOT / page).read_text(encoding="utf-8")
    (anchor,) = [
        name for name, section in sections(text).items() if section.splitlines()[0].lstrip("#") == f" {heading}"
    ]
    assert words in sections(text)[anchor], f"{question} {page}#{anchor}"


def test_the_map_answers_the_questions_at_once() -> None:
    text = (ROOT / MAP).read_text(encoding="utf-8")
    rows = {row.split(" | ")[0].removeprefix("| ") for row in text.splitlines() if row.startswith("| ")}
    asked = {question for question, clicks, _, _ in ASKED if "planner" not in question}
    assert asked <= rows
