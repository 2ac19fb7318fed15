"""The report and the live view in a real browser, Debian's Chromium. Skipped, and said to be, where there is none."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from koordgen.runtime.trace.schema import Cause, End, Mark, Verdict, Violation
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.trace.files import read
from targets.sim.view.data import show
from targets.sim.view.web import report
from tests.sim.view.browser import CHROMIUM, WEBGL, Browser
from tests.sim.view.canned import header, moving, write
from tests.sim.view.test_export import ENDS, HEAD, STARTS, rounds
from tests.sim.view.test_live import watched
from tests.sim.view.test_rows import big
from tests.sim.view.test_show import HEAD as KNOWING
from tests.sim.view.test_show import records as knowing

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no browser: on Debian, apt install chromium")


def inked(canvas: str) -> str:
    """How many pixels of a canvas are drawn."""
    return (
        f"(() => {{ const c = document.getElementById('{canvas}'), d = c.getContext('2d').getImageData(0, 0, c.width, "
        "c.height).data; let n = 0; for (let k = 3; k < d.length; k += 4) n += d[k] > 0; return n; })()"
    )


def test_the_report_plays_the_run(tmp_path: Path) -> None:
    marks: list[Violation | End] = [Violation(2.0, "fault", ("bert",), "<img src=x>"), End(10.0, "completed")]
    trace = write(tmp_path / "trace.jsonl", HEAD, [*moving(STARTS, ENDS), *rounds()], marks)
    report.write(tmp_path / "report.html", trace)
    with Browser(tmp_path / "profile") as page:
        page.open(f"file://{tmp_path}/report.html#t=2.5")
        assert page.text("time") == "2.50 s"
        assert "tasks\tall\t[]\t0.50 s, round 1, alice $x_{" in page.text("shared")
        assert "3 × 2 cells of 0.50 m, 67 % known" in page.text("shared")
        assert "2.00\tviolation\tfault\tbert\t<img src=x>" in page.text("marks")
        assert page.value("document.querySelectorAll('img').length") == 0
        assert page.text("closest") == "closest: alice $x_{ and bert, 4.11 m"
        assert page.text("alarm") == "violation: fault bert"
        for canvas in ("top", "side", "x-t", "y-t", "z-t", "timeline", "near", "late", "loss"):
            assert page.value(inked(canvas)) > 1000, canvas
        page.value("document.getElementById('scrub').value = 9; document.getElementById('scrub').oninput()")
        page.wait("document.getElementById('time').textContent", lambda said: said == "9.00 s")
        page.value("document.getElementById('speed').value = '10'; document.getElementById('play').click()")
        page.wait("document.getElementById('time').textContent", lambda said: said == "12.00 s")
        said = page.value(
            "hovered(model, charts.timeline, charts.timeline.x(2.02), 10 + ROW * 1.5)"  # the second robot's row
        )
        assert "bert" in said and 'fault a.koord:9: 1 / 0, "twice"' in said and "violation fault" in said
        assert page.complaints == []


def test_squads_are_one_symbol_and_can_be_unfolded(tmp_path: Path) -> None:
    robots = tuple(msgspec.structs.replace(robot, target="squad") for robot in HEAD.robots[:1]) + HEAD.robots[1:]
    records = moving(STARTS, ENDS)
    own = [record for record in records if record["pid"] == 0]
    for name, off in (("ann", 0.6), ("cleo", -0.6)):
        for record in own:
            x, y, z = record["position"]
            records.append({**record, "kind": "member", "member": name, "position": [x + off, y, z]})
    head = msgspec.structs.replace(HEAD, robots=robots)
    report.write(tmp_path / "report.html", write(tmp_path / "trace.jsonl", head, records))
    with Browser(tmp_path / "profile") as page:
        page.open(f"file://{tmp_path}/report.html#t=2.5")
        assert page.text("closest") == f"closest: {HEAD.robots[0].name}.ann and {HEAD.robots[0].name}.cleo, 1.20 m"
        assert page.value("model.drawn(state.unfolded).length") == 2
        page.value("document.getElementById('unfold').click()")
        page.wait("model.robots[0].unfolded", bool)
        assert page.value("model.drawn(state.unfolded).map((robot) => robot.name.split('.').pop()).slice(0, 3)") == [
            HEAD.robots[0].name, "ann", "cleo",
        ]  # fmt: skip
        assert page.complaints == []


GREEN, RED = "rgb(27, 127, 75)", "rgb(176, 0, 32)"


def colour(selector: str) -> str:
    return f"getComputedStyle(document.querySelector({selector!r})).color"


def test_the_report_of_a_good_run_opens_at_its_beginning_and_has_nothing_red(tmp_path: Path) -> None:
    held = Verdict(10.0, "invariant", "Apart", "a.koord:4", "held", observations=241)
    marks: list[Mark] = [Cause(3.0, "wind", ("bert",), ""), held, End(10.0, "completed")]
    moves = moving(STARTS, ENDS)
    report.write(tmp_path / "report.html", write(tmp_path / "trace.jsonl", HEAD, moves, marks))
    with Browser(tmp_path / "profile") as page:
        page.open(f"file://{tmp_path}/report.html")
        assert page.text("time") == "0.00 s"
        assert "HELD: invariant Apart (a.koord:4), observations: 241" in page.value(
            "document.querySelector('.verdict').innerText"
        )
        assert page.value(colour(".verdict li")) == page.value(colour("#marks tr.good td")) == GREEN
        for at, told in ((3.5, "cause: wind bert"), (10.0, "")):  # the verdict is at the top, not below the map
            page.value(f"seek({at}); draw()")
            assert page.text("alarm") == told and page.value(colour("#alarm")) != RED
        assert page.value("document.querySelectorAll('.bad').length") == 0
        canvases = "[...document.querySelectorAll('canvas')].map((c) => c.id)"
        for canvas in page.value(canvases):
            assert page.value(reddish(canvas)) == 0, canvas
        assert page.complaints == []


def reddish(canvas: str) -> str:
    """How many pixels of a canvas have the red of violations."""
    return (
        f"(() => {{ const c = document.getElementById('{canvas}'), d = c.getContext('2d').getImageData(0, 0, c.width, "
        "c.height).data; let n = 0; for (let k = 0; k < d.length; k += 4) n += d[k] === 176 && d[k + 1] === 0 && "
        "d[k + 2] === 32 && d[k + 3] === 255; return n; })()"
    )


def test_the_report_opens_at_the_first_violation_and_shows_it_red(tmp_path: Path) -> None:
    marks: list[Mark] = [
        Violation(6.0, "collision", ("bert",), "late"),
        Violation(2.0, "fault", ("bert",), "first"),
        End(10.0, ""),
    ]
    moves = moving(STARTS, ENDS)
    report.write(tmp_path / "report.html", write(tmp_path / "trace.jsonl", HEAD, moves, marks))
    with Browser(tmp_path / "profile") as page:
        page.open(f"file://{tmp_path}/report.html")
        assert (page.text("time"), page.text("alarm")) == ("2.00 s", "violation: fault bert")
        assert page.value(colour("#alarm")) == RED and page.value(reddish("top")) > 20
        assert page.complaints == []


def test_the_report_shows_what_each_robot_knew(tmp_path: Path) -> None:
    moves = moving([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)], [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)], 1)
    trace = write(tmp_path / "trace.jsonl", KNOWING, [*moves, *knowing()])
    report.write(tmp_path / "report.html", trace)
    with Browser(tmp_path / "profile") as page:
        page.open(f"file://{tmp_path}/report.html#t=0.5")
        assert page.text("shared").splitlines()[0] == "x[0]\tann\t30\t0.20 s, round 3, ann"
        assert "bob (of 0.10 s)" in page.text("copies")
        page.value("document.getElementById('who').value = '1'; document.getElementById('who').onchange()")
        page.wait("document.getElementById('shared').innerText", lambda said: said.startswith("n\tlocal\t8\t"))
        assert "x[0]\tann\t10\t0.00 s, round 1, ann" in page.text("shared")
        for at in (-0.5, 0.0, 0.05, 0.15, 0.25, 0.5, 0.85):  # as `koordgen show` says, which has it from the copies
            _, beliefs = show.at(*read(trace), at)
            for pid, belief in beliefs.robots.items():
                known = {f"{name} {pid}": each for name, value in belief.shared.items() for pid, each in
                         (value if isinstance(value, dict) else {-1: value}).items()}  # fmt: skip
                assert page.value(believed(pid, at + 1e-6)) == [known, belief.locals], (pid, at)
        assert page.complaints == []


def believed(pid: int, at: float) -> str:
    """The robot's copy and its locals, as the page shows them."""
    return (
        f"(() => {{ const robot = model.robots[{pid}], at = {at}, copy = {{}}, own = {{}}; "
        "for (const v of model.shared) for (const [k, s] of v.series) { "
        "const w = model.believed(robot, s, at); if (w) copy[`${v.name} ${k}`] = w.value; } "
        "for (const [name, s] of robot.locals) { const w = model.value(s, at); if (w) own[name] = w.value; } "
        "return [copy, own]; })()"
    )


SOLIDS = (
    Block(Point(-2.0, -2.0, 0.0), Point(-1.0, -1.0, 1.0)),
    Sphere(Point(2.0, 2.0, 1.0), 0.5),
    Cylinder(Point(3.0, -2.0, 0.0), 0.4, 2.0),
    Mesh((Point(0, 3, 0), Point(1, 3, 0), Point(0, 4, 0), Point(0, 3, 1)), ((0, 1, 2), (0, 1, 3), (0, 2, 3))),
)


def in_space(code: str) -> str:
    """What `code` says after a picture; `count(kind)`: how many objects of it there are; `seen(test)`: how many pixels
    of it pass the test of red, green and blue."""
    return (
        "(() => { draw(); const count = (kind) => { let n = 0; "
        "state.space.world.traverse((o) => { n += o.type === kind; }); return n; }; "
        "const seen = (test) => { const c = document.createElement('canvas'), w = $('space-view'); "
        "[c.width, c.height] = [w.width, w.height]; const ctx = c.getContext('2d'); ctx.drawImage(w, 0, 0); "
        "const d = ctx.getImageData(0, 0, c.width, c.height).data; let n = 0; "
        f"for (let k = 0; k < d.length; k += 4) n += test(d[k], d[k + 1], d[k + 2]); return n; }}; return {code}; }})()"
    )


ORANGE = "seen((r, g, b) => r > 120 && b < 60 && g < 0.7 * r)"  # bert's


@pytest.mark.slow
def test_the_map_has_a_third_dimension(tmp_path: Path) -> None:
    head = msgspec.structs.replace(HEAD, obstacles=SOLIDS)
    scan = [[[1.0, 0.0, 0.0], [[0.0, 1.0, 2.0], [1.0, 6.0, 2.0], 6.0]]]
    looked = {"kind": "round", "t": 0.0, "pid": 0, "round": 1, "sensors": {"MotionWithScan.pscan": scan}}
    marks: list[Mark] = [Violation(2.0, "fault", ("bert",), "x"), End(10.0, "")]
    trace = write(tmp_path / "trace.jsonl", head, [*moving(STARTS, ENDS), looked, *rounds()], marks)
    report.write(tmp_path / "report.html", trace)
    with Browser(tmp_path / "profile", graphics=WEBGL) as page:
        page.open(f"file://{tmp_path}/report.html#t=0.5")
        assert page.value("typeof THREE") == "undefined"  # nobody has looked yet
        page.value("$('deep').click()")
        page.wait("Boolean(state.space && state.space.standing) && $('top').hidden", bool)
        assert page.value(in_space("seen((r, g, b) => r + g + b < 740)")) > 5000
        assert page.value(in_space(ORANGE)) > 50
        assert page.value(in_space("count('Points')")) == 1
        assert page.value("state.space.standing.children.length") > len(SOLIDS) + 2
        first = page.value(in_space("state.space.placed.map((each) => [each.px, each.py])"))
        said = page.value(f"state.space.hovered({first[1][0]} + 3, {first[1][1]})")
        assert said == "bert: (-0.95, 1.90, 0.00) m, heading 0° from east"
        assert page.value("state.space.hovered(2, 2)") == ""
        page.value("$('scrub').value = 9; $('scrub').oninput()")
        later = page.value(in_space("state.space.placed.map((each) => [each.px, each.py])"))
        assert all(abs(a[0] - b[0]) + abs(a[1] - b[1]) > 5 for a, b in zip(first, later, strict=True))
        page.value("$('chase').value = '1'; $('chase').onchange()")
        where = "(() => { const each = state.space.placed[1], c = state.space.flat; return [each.px / c.clientWidth, "
        middle = page.value(in_space(f"{where}each.py / c.clientHeight]; }})()"))
        assert middle == pytest.approx([0.5, 0.5], abs=0.01)
        page.value("seek(2.5); model.robots[1].shown = false")
        assert page.value(in_space("isMap(state.space.map)")) and page.value(in_space(ORANGE)) == 0
        page.value("model.robots[1].shown = true; draw()")
        assert page.value(reddish("space-names")) > 20  # who takes part in a violation has a ring
        page.value("$('above').click()")
        page.wait("!$('top').hidden && $('space').hidden", bool)
        assert page.complaints == []
        page.value("$('deep').click()")
        page.wait("$('top').hidden", bool)
        box = {"shape": "box", "lo": [4.0, 4.0, 0.0], "hi": [5.0, 5.0, 1.0]}
        page.value(f"model.extend({{obstacles: [[3.0, 0, {json.dumps(box)}]]}})")
        middle = "state.space.standing.children.find((o) => o.geometry && o.geometry.type === 'BoxGeometry').position.x"
        for at, x in ((2.9, -1.5), (3.1, 4.5), (2.9, -1.5)):
            assert page.value(in_space(f"(seek({at}), draw(), {middle})")) == x
        page.value("state.space.renderer.forceContextLoss()")
        page.wait("$('space').hidden && $('deep').disabled", bool)
        assert page.text("space-why") == "the browser has taken WebGL away" and page.value(inked("top")) > 1000


def test_without_webgl_the_map_stays_flat_and_says_why(tmp_path: Path) -> None:
    report.write(tmp_path / "report.html", write(tmp_path / "trace.jsonl", HEAD, moving(STARTS, ENDS)))
    with Browser(tmp_path / "profile") as page:
        page.open(f"file://{tmp_path}/report.html")
        assert page.value("$('deep').disabled") and page.text("space-why") == "this browser has no WebGL 2"
        page.value("$('deep').click()")
        assert page.value("$('space').hidden") and page.value(inked("top")) > 1000
        assert page.complaints == []


@pytest.mark.slow
def test_a_page_of_sixteen_robots_and_three_minutes_is_drawn_quickly_enough(tmp_path: Path) -> None:
    report.write(tmp_path / "report.html", big(tmp_path / "trace.jsonl", 16, 180))
    with Browser(tmp_path / "profile") as page:
        page.open(f"file://{tmp_path}/report.html#t=170")
        took = page.value("(() => { const t = performance.now(); for (let k = 0; k < 5; k++) draw(); "
                          "return (performance.now() - t) / 5; })()")  # fmt: skip
        print(f"{took:.0f} ms a picture")
        assert took < 500
        assert page.complaints == []


def test_a_run_is_seen_while_it_goes_on_and_its_end_is_told(tmp_path: Path) -> None:
    with watched(tmp_path) as (_, port), Browser(tmp_path / "profile") as page:
        page.open(f"http://127.0.0.1:{port}/")
        first = page.wait("model.last", lambda last: last > 0.5)
        page.wait("model.last", lambda last: last > first + 0.5)
        assert page.text("status") == ""
        assert "Move" in page.text("events")
        assert page.text("closest") == "closest: r0 and r1, 2.00 m"
        said = page.wait("document.getElementById('status').textContent", lambda said: "held" in said)
        assert str(tmp_path / "out" / "report.html") in said
        assert page.complaints == []


def test_a_run_of_one_robot_that_never_began_has_a_page(tmp_path: Path) -> None:
    report.write(
        tmp_path / "report.html", write(tmp_path / "trace.jsonl", header(["alice"]), [], [End(0.0, "timeout")])
    )
    with Browser(tmp_path / "profile") as page:
        page.open(f"file://{tmp_path}/report.html")
        assert "timeout" in page.text("marks") and page.complaints == []
