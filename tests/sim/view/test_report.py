"""Trace, summary, pictures and report, from canned records."""

from __future__ import annotations

import gzip
import hashlib
import json
import re
from base64 import b64decode, b64encode
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import msgspec
import pytest
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from koordgen.runtime.trace import schema
from koordgen.runtime.trace.schema import End, Violation
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.judging import summary
from targets.sim.trace import files as trace
from targets.sim.view.data.history import gathered
from targets.sim.view.data.tracks import Tracks, tracks
from targets.sim.view.pictures import plots
from targets.sim.view.web import report
from tests.sim.view.canned import header, moving, outcome, write

NAMES = ["alice", "bert", "<script>cleo"]
STARTS = [(-4.0, -1.0, 0.0), (-1.0, 2.0, 0.0), (4.0, 1.0, 0.0)]
ENDS = [(-4.0, -1.0, 1.0), (0.0, 0.0, 0.0), (4.0, 1.0, 1.0)]


def rounds() -> list[dict[str, Any]]:
    def one(number: int, **what: Any) -> dict[str, Any]:
        usual = {"kind": "round", "t": number / 10 - 0.1, "pid": 1, "round": number, "late": 0.001}
        return {**usual, "event": None, "skipped": None, "fault": None, "sensors": {}, **what}

    fault = {"file": "a.koord", "line": 9, "reason": "<img src=x onerror=alert(1)>"}
    return [
        one(1, event="Move"),
        one(2, event="Move", late=0.06),
        one(3, skipped="not current: lacks alice", late=0.06),
        one(4, skipped="not current: lacks bert", late=0.06),
        one(7, event="Go"),  # 5 and 6 were slept through
        one(8, event="Move", skipped="fault", fault=fault),
        one(9, event="Move", skipped="fault", fault=fault),
        one(200, event="Move"),  # after the mission's end
    ]


@pytest.fixture
def canned(tmp_path: Path) -> Path:
    marks: list[Violation | End] = [Violation(0.7, "fault", ("bert",), "a.koord:9: <b>"), End(10.0, "completed")]
    return write(tmp_path / "trace.jsonl", header(NAMES), [*moving(STARTS, ENDS), *rounds()], marks)


def test_the_summary_counts_what_the_trace_says(canned: Path) -> None:
    found = summary.summarise(*trace.read(canned), outcome())
    bert = found.robots[1]
    assert bert.events == {"Move": 2, "Go": 1}
    assert bert.skips == {"not current": 2}
    assert (bert.rounds, bert.faults, bert.late_rounds) == (7, 2, 3)
    assert bert.start == STARTS[1] and bert.final == ENDS[1]
    assert bert.path_length == pytest.approx(5**0.5)
    assert found.robots[0].path_length == pytest.approx(1.0)
    assert found.verdict == "violated" and "bert" in found.why and "0.70 s" in found.why
    assert found.min_separation is not None and found.min_separation.robots == ("alice", "bert")


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({"ended": "interrupted"}, "interrupted"),
        ({"ended": "timeout", "started": False}, "not started"),
        ({"ended": "stopped"}, "held"),
        ({}, "held"),
    ],
)
def test_verdicts(tmp_path: Path, change: dict[str, Any], verdict: str) -> None:
    path = write(tmp_path / "trace.jsonl", header(NAMES), moving(STARTS, ENDS))
    assert summary.summarise(*trace.read(path), outcome(**change)).verdict == verdict


def test_a_run_that_does_not_tell_of_all_properties_is_not_plainly_held(tmp_path: Path) -> None:
    left = schema.Verdict(10.0, "invariant", "Near", "app.koord:7", "out of model", 2.04, (), "bert had left the model")
    known = schema.Verdict(10.0, "axiom", "Sum", "app.koord:9", "unchecked")
    path = write(tmp_path / "trace.jsonl", header(NAMES), moving(STARTS, ENDS), [left, known, End(10.0, "completed")])
    found = summary.summarise(*trace.read(path), outcome())
    assert found.verdict == "held" and "invariant Near (app.koord:7), out of model since 2.04 s" in found.why
    assert "Sum" not in found.why
    assert summary.as_text(found).startswith("line<form>: HELD IN PART: the whole duration")
    summary.write(found, tmp_path)
    report.write(tmp_path / "report.html", path)
    assert "Held in part" in (tmp_path / "report.html").read_text()
    write(path, header(NAMES), moving(STARTS, ENDS), [known, End(10.0, "completed")])
    assert summary.as_text(summary.summarise(*trace.read(path), outcome())).startswith("line<form>: HELD: ")


def test_the_summary_is_the_same_as_json_and_as_text(canned: Path) -> None:
    found = summary.summarise(*trace.read(canned), outcome())
    summary.write(found, canned.parent)
    data = json.loads((canned.parent / "summary.json").read_text())
    assert data["robots"][1]["events"] == {"Move": 2, "Go": 1}
    text = (canned.parent / "summary.txt").read_text()
    for part in ("VIOLATED", "bert", "Move 2", "0.800 m at 4.00 s", "real-time factor 0.998"):
        assert part in text


class Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


def test_the_report_stands_alone_and_escapes_all_it_was_told(canned: Path) -> None:
    found = summary.summarise(*trace.read(canned), outcome(last_lines={"bert": ["</pre><script>x</script>"]}))
    found.reproduce = {"command": "python3 'a & <b>'"}
    summary.write(found, canned.parent)
    report.write(canned.parent / "report.html", canned)
    text = (canned.parent / "report.html").read_text()
    page = Page()
    page.feed(text)
    tags = [tag for tag, _ in page.tags]
    assert tags.count("script") == 3 and not set(tags) & {"link", "iframe", "b", "img"}
    for address in re.findall(r"https?://[^\s\"']*", text):
        assert address == "http://www.w3.org/2000/svg"  # a name, which nothing is fetched from
    assert not any(name.startswith("on") or name == "src" for _, attributes in page.tags for name in attributes)
    assert text.index("Violated") < text.index("<table>")
    assert "a &amp; &lt;b&gt;" in text


def test_the_page_runs_its_own_script_and_three_js_and_no_other(canned: Path) -> None:
    report.write(canned.parent / "report.html", canned)
    text = (canned.parent / "report.html").read_text()
    script = text.rpartition("<script>")[2].partition("</script>")[0]
    packed = text.partition('id="three">')[2].partition("</script>")[0]
    vendor = Path(report.__file__).parent / "page" / "vendor"
    three = gzip.decompress(b64decode(packed))
    assert three == (vendor / "three.min.js").read_bytes() and len(packed) < 205_000
    assert (vendor / "LICENSE").read_text(encoding="utf-8") in text
    own, other = (b64encode(hashlib.sha256(each).digest()).decode() for each in (script.encode(), three))
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    assert policy[1] == (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{own}' 'sha256-{other}'"
    )


def test_a_trace_alone_has_a_report_too(canned: Path) -> None:
    report.write(canned.parent / "page.html", canned)
    text = (canned.parent / "page.html").read_text()
    assert "Violated" in text and "at 0.70 s bert: fault" in text
    assert "Reproduce this run" not in text and "real-time factor" not in text
    assert "at the poses of the trace" in text and "physics step" not in text


def test_another_runs_summary_is_not_taken_for_this_ones(canned: Path) -> None:
    found = summary.summarise(*trace.read(canned), outcome())
    found.seed, found.why = 99, "of another run"
    summary.write(found, canned.parent)
    report.write(canned.parent / "page.html", canned)
    assert "of another run" not in (canned.parent / "page.html").read_text()


def test_violations_are_told_however_much_else_there_is(tmp_path: Path) -> None:
    noise = [{"kind": "log", "t": k / 1000, "pid": 0, "level": "warning", "message": str(k)} for k in range(1000)]
    marks: list[Violation | End] = [Violation(9.0, "collision", ("alice", "bert"), "touched"), End(10.0, "completed")]
    path = write(tmp_path / "trace.jsonl", header(NAMES), noise, marks)
    lines = report.important(*trace.read(path))
    assert len(lines) == report.MOST_LINES + 1 and lines[-1][2] == "collision"


def tracks_of(path: Path) -> Tracks:
    header, records = trace.read(path)
    return tracks(header, gathered(header, records))


def test_a_run_that_never_began_has_pictures_too(tmp_path: Path) -> None:
    path = write(tmp_path / "trace.jsonl", header(NAMES), [], [End(0.0, "timeout")])
    assert len(plots.draw(tracks_of(path), tmp_path / "plots")) == 5


@pytest.mark.parametrize(
    "shape",
    [
        Block(Point(-5.0, 2.0, 0.0), Point(-3.0, 4.0, 1.0)),
        pytest.param(Sphere(Point(-4.0, 3.0, 1.0), 1.0), marks=pytest.mark.slow),
        pytest.param(Cylinder(Point(-4.0, 3.0, 0.0), 1.0, 2.0), marks=pytest.mark.slow),
        pytest.param(
            Mesh((Point(-5, 2, 0), Point(-3, 2, 0), Point(-3, 4, 2), Point(-5, 4, 2)), ((0, 1, 2), (0, 2, 3))),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_top_view_shows_the_obstacles(shape: Obstacle, tmp_path: Path) -> None:
    def stones(head: schema.Header) -> int:
        path = write(tmp_path / "trace.jsonl", head, moving(STARTS, ENDS))
        picture = plt.imread(plots.draw(tracks_of(path), tmp_path / "plots")["Top view"])
        return int((abs(picture[:, :, :3] - 0xCC / 0xFF).max(axis=2) < 0.01).sum())

    bare = stones(header(NAMES))
    assert stones(msgspec.structs.replace(header(NAMES), obstacles=(shape,))) > bare + 1000


def test_the_separation_over_time_is_that_of_the_closest_pair(tmp_path: Path) -> None:
    path = write(tmp_path / "trace.jsonl", header(NAMES), moving(STARTS, ENDS))
    near = tracks_of(path).near
    assert near[0] == pytest.approx([-1.0, (3**2 + 3**2) ** 0.5], abs=1e-3)
    assert near[-1] == pytest.approx([12.0, (4**2 + 1 + 1) ** 0.5], abs=1e-3)


def test_a_file_that_is_no_trace_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "trace.jsonl"
    for text in ("", "{}\n", '{"kind":"pose","t":0,"pid":0,"position":[0,0,0],"yaw":0}\n', "\xff"):
        path.write_text(text)
        with pytest.raises(schema.BadTrace):
            trace.read(path)
    with pytest.raises(schema.BadTrace):
        trace.read(tmp_path / "none")


def test_what_is_not_known_here_is_kept_by_merging_and_passed_over_by_reading(tmp_path: Path) -> None:
    own, path = tmp_path / "own.jsonl", tmp_path / "trace.jsonl"
    lines: list[dict[str, Any]] = [
        {"kind": "metrics", "time": 101.0, "late_ms": {"p50": 1.0}, "rejected": {}, "peers": {}},
        {"kind": "stream", "time": 102.0, "round": 3, "port": "Log.out", "text": "hello"},
        {"kind": "of tomorrow", "time": 103.0, "more": [1]},
    ]
    own.write_bytes(b"".join(msgspec.json.encode(line) + b"\n" for line in lines))
    trace.merge(path, header(["alice"]), 100.0, tmp_path / "none", [own], [End(10.0, "completed")])
    _, *written = (json.loads(line) for line in path.read_bytes().splitlines())
    assert [(r["kind"], r["t"], r.get("pid")) for r in written[:3]] == [
        ("metrics", 1.0, 0), ("stream", 2.0, 0), ("of tomorrow", 3.0, 0),
    ]  # fmt: skip
    assert written[2]["more"] == [1]
    assert [type(record).__name__ for record in trace.read(path)[1]] == ["MetricsRecord", "StreamLine", "End"]


def test_merged_records_are_in_order_although_a_round_is_told_only_when_it_is_certain(tmp_path: Path) -> None:
    told: dict[str, list[tuple[str, float, dict[str, Any]]]] = {
        "a": [("log", 100.5, {"message": "x"}), ("round", 100.25, {"round": 1}), ("round", 100.5, {"round": 2})],
        "b": [("round", 102.0, {"round": 3}), ("log", 101.0, {"message": "y"}), ("round", 100.75, {"round": 2})],
    }
    files, path = [tmp_path / name for name in told], tmp_path / "trace.jsonl"
    for file, records in zip(files, told.values(), strict=True):
        rows = [{"kind": kind, "time": time, **more} for kind, time, more in records]
        # A header is no record, nor is what is broken, nor what was cut off.
        lines = [b'{"kind":"header"}', b"\xff", *map(msgspec.json.encode, rows), b'{"ki']
        file.write_bytes(b"\n".join(lines))
    trace.merge(path, header(["alice", "bert"]), 100.0, tmp_path / "none", files, [End(0.6, "completed")])
    _, *written = (json.loads(line) for line in path.read_bytes().splitlines())
    assert [(r["t"], r.get("pid"), r.get("round", r["kind"])) for r in written] == [
        (0.25, 0, 1), (0.5, 0, "log"), (0.5, 0, 2), (0.6, None, "end"), (0.75, 1, 2), (1.0, 1, "log"), (2.0, 1, 3),
    ]  # fmt: skip


def test_a_trace_that_is_cut_off_is_told_with_its_place(canned: Path) -> None:
    whole = canned.read_bytes()
    canned.write_bytes(whole[:-20])
    with pytest.raises(schema.BadTrace, match=rf"trace.jsonl:{whole.count(10)}: .*cut off"):
        list(trace.read(canned)[1])


def test_following_an_agents_file_waits_for_whole_lines_and_passes_over_the_rest(tmp_path: Path) -> None:
    path = tmp_path / "trace.jsonl"
    tail = trace.Tail(path)
    assert tail.read() == []
    path.write_bytes(b'{"kind":"header","format":"koord-trace/1","robot":"a"}\nnonsense\n{"kind":"phase","ti')
    assert tail.read() == [] and tail.malformed == 1
    with path.open("ab") as file:
        file.write(b'me":5.0,"phase":"starting"}\n')
    assert tail.read() == [schema.Phase("starting", time=5.0)]


def test_names_of_robots_that_end_near_one_another_do_not_overlap() -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.set(xlim=(0, 10), ylim=(0, 10))
    places = [(5.0, 5.0), (5.1, 5.05), (5.0, 5.3), (8.0, 5.0)]
    names = [axes.annotate("robot (0)", place, xytext=(9, 7), textcoords="offset points") for place in places]
    plots.move_apart(figure, names)
    boxes = [name.get_window_extent() for name in names]
    assert not any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])
    assert [names[0].xyann, names[3].xyann] == [(9, 7)] * 2, "others stay where they are"
