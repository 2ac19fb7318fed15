"""The report and the live view in a real browser, Debian's Chromium. Skipped, and said to be, where there is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from targets.sim.trace import End, Violation
from targets.sim.view import report
from tests.sim.browser import CHROMIUM, Browser
from tests.sim.canned import header, moving, write
from tests.sim.test_export import ENDS, HEAD, STARTS, rounds
from tests.sim.test_live import watched
from tests.sim.test_rows import big

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
