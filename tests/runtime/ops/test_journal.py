"""What a robot tells, and of which round."""

from __future__ import annotations

import io
import json

from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.ops.journal import METRICS_EVERY, Journal
from koordgen.runtime.program.program import Effects
from koordgen.runtime.trace.writer import RoundRecord, Trace
from koordgen.runtime.values.clock import SimulatedClock


def test_lines_of_an_event_are_of_its_round_not_of_the_one_in_which_it_became_certain() -> None:
    file, told = io.BytesIO(), list[str]()
    clock = SimulatedClock()
    trace = Trace(file, told.append)
    journal = Journal("alice", trace, lambda level, line: told.append(line), clock, FleetClock(0), Metrics(0, 1), ())
    journal.round = 7
    effects = Effects({}, {}, {}, False, (("Log.stdout", "here"),))
    journal.observe(RoundRecord(4, 0.4, 0.0, {}, None, "Speak", effects), {"rounds": 7})
    for now in (METRICS_EVERY, METRICS_EVERY + 1, 2 * METRICS_EVERY):
        journal.measure({"replayed": 1}, now)
    lines = [json.loads(line) for line in file.getvalue().splitlines()]
    assert [(t["round"], t["text"]) for t in lines if t["kind"] == "stream"] == [(4, "here")]
    assert [(t["time"], t["rejected"]) for t in lines if t["kind"] == "metrics"] == [
        (METRICS_EVERY, {"replayed": 1}),
        (2 * METRICS_EVERY, {"replayed": 1}),
    ]
    assert told == ["0.000 round 7 alice: info: Log.stdout: here"]
