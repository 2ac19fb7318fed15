"""Page that shows a run.

The report, which is self-contained, and the live view, which receives events.

Both run the same scripts, `page/*.js`. Contents of a trace enter them as JSON and are only ever shown as text."""

from __future__ import annotations

import gzip
import hashlib
from base64 import b64encode
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

import msgspec

from koordgen.runtime.trace.schema import Header
from targets.sim.view.data.rows import Chunk

FOLDER = Path(__file__).parent / "page"
CONTROLS_SCRIPT = "controls.js"
SCRIPTS = ("model.js", "draw.js", "views.js", "space.js", "timeline.js", "main.js")
VENDOR = FOLDER / "vendor"

# Controls of a live run; controls.js fills in and connects them.
CONTROLS = """
<section id="controls" aria-label="controls of the run">
<div><b>Run</b> <button id="run-pause">pause</button> <button id="run-step">step one round</button>
<select id="run-speed" aria-label="speed of the run"><option value="">as fast as it goes</option>
<option value="0.25">¼ × real time</option><option value="0.5">½ × real time</option>
<option value="1">1 × real time</option><option value="2">2 × real time</option>
<option value="5">5 × real time</option><option value="10">10 × real time</option>
</select> <output id="run-said" aria-live="polite"></output></div>
<div class="faults">
<span><b>Robot</b> <select id="fault-robot" aria-label="robot"></select> <button id="fault-crash">crash</button>
<button id="fault-restart">restart</button> <button id="fault-freeze">freeze</button>
<button id="fault-continue">continue</button></span>
<span><b>Link</b> <select id="fault-one" aria-label="one robot"></select> –
<select id="fault-other" aria-label="other robot"></select> <button id="fault-cut">cut</button>
<button id="fault-restore">restore</button></span>
<span><b>All links</b> loss <input id="fault-loss" value="20" inputmode="decimal"> %, delay
<input id="fault-delay" value="0.001" inputmode="decimal"> s <button id="fault-network">set</button></span>
<span><b>Wind</b> <input id="fault-wind-x" value="3" aria-label="east, m/s" inputmode="decimal">
<input id="fault-wind-y" value="0" aria-label="north, m/s" inputmode="decimal">
<input id="fault-wind-z" value="0" aria-label="up, m/s" inputmode="decimal"> m/s, gusts
<input id="fault-gust" value="1" inputmode="decimal"> m/s <button id="fault-wind">blow</button></span>
<span><b>Obstacle</b> <select id="fault-number" aria-label="number of the obstacle"></select> by
<input id="fault-by-x" value="1" aria-label="east, m" inputmode="decimal">
<input id="fault-by-y" value="0" aria-label="north, m" inputmode="decimal">
<input id="fault-by-z" value="0" aria-label="up, m" inputmode="decimal"> m
<button id="fault-obstacle">move</button></span>
<span><b>Position</b> <select id="fault-lost" aria-label="robot without good positions"></select> off by
<input id="fault-bias-x" value="1" aria-label="east, m" inputmode="decimal">
<input id="fault-bias-y" value="0" aria-label="north, m" inputmode="decimal">
<input id="fault-bias-z" value="0" aria-label="up, m" inputmode="decimal"> m, missing
<input id="fault-dropout" value="0" inputmode="decimal"> % <button id="fault-positioning">set</button></span>
<span><b>Motors</b> <select id="fault-slow" aria-label="robot with slow motors"></select> late by
<input id="fault-seconds" value="0.2" inputmode="decimal"> s <button id="fault-lag">set</button></span>
<span><b>Battery</b> <select id="fault-empty" aria-label="robot with a low battery"></select> at most
<input id="fault-level" value="10" inputmode="decimal"> % <button id="fault-battery">set</button></span>
<span>Faults last
<input id="fault-for" value="" placeholder="until ended" aria-label="seconds" inputmode="decimal"> s</span>
</div></section>
"""
PLAYER = """
<div class="player">
<button id="play" aria-label="play" title="play or pause (space)">▶</button>
<select id="speed" title="speed"><option value="0.25">¼ ×</option><option value="0.5">½ ×</option>
<option value="1" selected>1 ×</option><option value="2">2 ×</option><option value="5">5 ×</option>
<option value="10">10 ×</option><option value="30">30 ×</option></select>
<input id="scrub" type="range" step="0.02" aria-label="time">
<output id="time"></output>
<button id="follow" title="follow the run">live</button> <span id="status" class="dim"></span>
<span><button id="out" title="show more time in the charts">−</button>
<button id="in" title="show less time in the charts">+</button></span>
<select id="tail" title="trails"><option value="0">no trails</option><option value="10">trails of 10 s</option>
<option value="1000000" selected>whole trails</option></select>
<select id="map" title="map"></select>
</div>
<div class="views">
<figure><div class="tabs"><button id="above" aria-pressed="true">from above</button>
<button id="deep" aria-pressed="false" title="the map in three dimensions">3D</button>
<button id="unfold" aria-pressed="false" title="show the robots of each squad" hidden>unfold squads</button>
<span id="space-bar" hidden><select id="chase" title="the camera goes along with a robot"></select>
<button id="whole" title="show the whole room again">whole room</button></span>
<span id="space-why" class="dim"></span></div>
<canvas id="top" aria-label="the fleet from above"></canvas>
<div id="space" hidden><canvas id="space-view" aria-label="the fleet in three dimensions"></canvas>
<canvas id="space-names"></canvas></div>
<figcaption><span id="space-help" hidden>Drag to turn; drag with the right button or two fingers to move; use the wheel
or two fingers to zoom. Dots: each robot's last lidar scan.</span>
Dotted: the commanded path or target. Dashed frame: geofence. In a map, light is free and dark is occupied.
<span id="closest"></span> <span id="alarm"></span></figcaption>
<div class="chips robots"></div></figure>
<div>
<figure><canvas id="side" aria-label="the fleet from the side"></canvas>
<figcaption>From the side: <select id="side-axis"><option value="0">along x</option><option value="1">along y</option>
</select></figcaption></figure>
<h2>Variables at this time</h2>
<p><select id="who" aria-label="whose knowledge"></select> <span id="copies" class="warn"></span></p>
<div class="wide scroll"><table><thead><tr><th>variable</th><th>of</th><th>value</th><th>written</th></tr></thead>
<tbody id="shared"></tbody></table></div>
</div></div>
<h2>Violations, verdicts, causes</h2>
<div class="wide scroll"><table class="events"><thead><tr>
<th class="n">time (s)</th><th>kind</th><th>what</th><th>robots</th><th></th>
</tr></thead><tbody id="marks"></tbody></table></div>
<h2>Rounds</h2>
<div class="chips" id="events"></div>
<figure><canvas id="timeline" aria-label="rounds over time"></canvas>
<figcaption>Thin band: phases. Triangles: what a robot said. Point at anything for more; click to go
there.</figcaption></figure>
<h2>Coordinates</h2>
<div class="chips robots"></div>
<figure><canvas id="x-t" aria-label="x over time"></canvas></figure>
<figure><canvas id="y-t" aria-label="y over time"></canvas></figure>
<figure><canvas id="z-t" aria-label="z over time"></canvas></figure>
<h2>Smallest separation</h2>
<figure><canvas id="near" aria-label="smallest separation over time"></canvas>
<figcaption>In space, between the robots' reference points, at the poses of the trace.</figcaption></figure>
<h2>Network</h2>
<figure><canvas id="late" aria-label="lateness of rounds over time"></canvas>
<figcaption>How long after its tick the latest round of each second was decided. Red dots: some were late, and
not only because they waited for others.</figcaption></figure>
<figure><canvas id="loss" aria-label="loss of datagrams over time"></canvas>
<figcaption>Datagrams lost, of those sent lately, on each robot's worst link.</figcaption></figure>
<div class="wide scroll"><table><thead><tr><th>robot</th><th>hears</th><th class="n">lost</th>
<th class="n">delay p50 (ms)</th><th class="n">p99 (ms)</th><th class="n">silent (ms)</th><th class="n">asked again</th>
<th class="n">told at (s)</th></tr></thead><tbody id="links"></tbody></table></div>
<details id="history"><summary>What was written into shared variables</summary><div class="wide scroll"><table>
<thead><tr><th class="n">time (s)</th><th class="n">round</th><th>by</th><th>variable</th><th>value</th></tr></thead>
<tbody id="writes"></tbody></table></div></details>
<div id="tip" hidden></div>
<noscript><p class="bad">The pictures are drawn by this page's own scripts, which are switched off.</p></noscript>
"""


def page(
    title: str, header: Header, rows: Chunk, before: str, after: str, live: bool = False,
    control: dict[str, Any] | None = None, more: tuple[str, ...] = (), facts: dict[str, Any] | None = None,
) -> str:  # fmt: skip
    """Return the whole page; `before` and `after` are HTML around the pictures.

    The page requests nothing from anywhere; a live one only the events of its own server. `control`: what the controls
    of a live run offer (`lockstep`, `faults`) and the `token` of their commands; None for no controls. `more`: further
    scripts of the page's folder; `facts`: data for them."""
    files = (*SCRIPTS, *((CONTROLS_SCRIPT,) if control is not None else ()), *more)
    script = "\n".join((FOLDER / name).read_text(encoding="utf-8") for name in files)
    digest, (packed, three) = _digest(script.encode()), _three()
    connect = "connect-src 'self'; " if live else ""
    scripts = f"script-src {digest} {three}"
    policy = f"default-src 'none'; {connect}img-src data:; style-src 'unsafe-inline'; {scripts}"
    given = {"header": msgspec.to_builtins(header), "rows": rows, "live": live, "control": control, **(facts or {})}
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{(FOLDER / 'page.css').read_text(encoding='utf-8')}</style>\n"
        f"</head>\n<body>\n{before}\n{CONTROLS if control is not None else ''}{PLAYER}\n{after}\n"
        f'<script type="application/json" id="data">{_json(given)}</script>\n'
        f"<!-- three.js, packed by gzip:\n{(VENDOR / 'LICENSE').read_text(encoding='utf-8')}-->\n"
        f'<script type="application/gzip" id="three">{packed}</script>\n<script>{script}</script>\n'
        "</body>\n</html>\n"
    )


@cache
def _three() -> tuple[str, str]:
    """Return Three.js as base64 of gzip (a third of its size), and its hash for the page's policy.

    The page unpacks it only for the three-dimensional view."""
    code = (VENDOR / "three.min.js").read_bytes()
    return b64encode(gzip.compress(code, mtime=0)).decode(), _digest(code)


def _digest(script: bytes) -> str:
    return f"'sha256-{b64encode(hashlib.sha256(script).digest()).decode()}'"


def _json(value: Any) -> str:
    """Return JSON that cannot end its HTML element, whatever its strings are."""
    return msgspec.json.encode(value).decode().replace("<", "\\u003c")
