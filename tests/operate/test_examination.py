"""All robots' doctors in one table."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from koordgen.operate.examination import HostExamination, examine, table, to_json, worst
from koordgen.operate.hosts import HostError
from tests.operate.fakes import FakeSession, reached, unreachable

KEY = {"name": "key", "state": "warn", "found": "INSECURE", "wanted": "a key", "why": "make one"}
PORT = {"name": "port", "state": "fail", "found": "47100 is in use", "wanted": "", "why": "end the other process"}
FINE = {"name": "settings", "state": "ok", "found": "robot alice", "wanted": "", "why": ""}


class Doctors(FakeSession):
    """alice is well, bert must be warned of, cleo is ill, dora's doctor does not start."""

    def answer_doctor(self, robot: str) -> dict[str, Any]:
        if robot == "dora":
            raise HostError(self.host, "missing", "there is no release", "deploy it")
        findings = {"alice": [FINE], "bert": [FINE, KEY], "cleo": [FINE, PORT, KEY]}[robot]
        return {"status": 5 if robot == "cleo" else 0, "document": {"app": "a", "checks": findings}}


def looked() -> list[HostExamination]:
    return asyncio.run(examine(reached(Doctors("alice", "bert"), Doctors("cleo"), Doctors("dora"))))


def test_the_table_shows_what_is_not_well() -> None:
    assert table(looked()).splitlines() == [
        "robot    ok  warn  fail",
        "alice     1     0     0",
        "bert      1     1     0",
        "  warn  key: INSECURE; wanted: a key; make one",
        "cleo      1     1     1",
        "  FAIL  port: 47100 is in use; end the other process",
        "  warn  key: INSECURE; wanted: a key; make one",
        "dora      -     -     -  there is no release; deploy it",
    ]
    assert worst(looked()) == 5 and worst(looked()[:2]) == 0 and worst(looked()[3:]) == 1


def test_one_document_has_all_findings() -> None:
    document = json.loads(to_json(looked()))
    assert document["status"] == 5 and document["robots"][1]["checks"] == [FINE, KEY]


def test_a_host_that_cannot_be_asked_is_as_bad_as_the_worst() -> None:
    cut = Doctors("alice")
    cut.broken.add("doctor")
    found = asyncio.run(examine(reached(cut, failed=(unreachable("emil"),))))
    assert [(each.robot, each.status) for each in found] == [("emil", 5), ("alice", 5)]
    assert "refuses connections" in table(found)
