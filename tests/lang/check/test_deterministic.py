"""What is found does not depend on the order of Python's sets: it is the same in every process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
SHOW = """
from koordgen.lang.analyze.program import check
from koordgen.lang.diagnostics import to_json, together
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse
from tests.lang.test_lang import CASES

assert len(CASES) > 100
for case in CASES:
    source = Source(case.name, case.text)
    tree, unread = parse(source)
    print(to_json([(source, d) for d in together(unread, check(tree, source)[1])]))
"""


def found(seed: str) -> list[str]:
    environment = os.environ | {"PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", SHOW]
    return subprocess.run(
        command, env=environment, cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.splitlines()


def test_every_literate_case_is_told_the_same_whatever_the_hash_seed() -> None:
    assert found("1") == found("2")
