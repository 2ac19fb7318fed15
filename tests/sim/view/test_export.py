"""What a trace is exported to: tables, a recording that Foxglove opens, pictures, films."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from base64 import b64decode
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from PIL import Image

from koordgen.cli import main
from koordgen.runtime.trace.schema import BoxRecord, End, Marker, MarkerList, SharedVariable, Violation, WorldRecord
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.base.folder import MARKER, ForeignFolder, RunFolder
from targets.sim.trace import files as trace
from targets.sim.view.data import tables
from targets.sim.view.data.colours import STATES
from targets.sim.view.data.history import gathered
from targets.sim.view.data.tracks import cells, tracks
from targets.sim.view.foxglove.schemas import SCHEMAS
from targets.sim.view.pictures import film
from tests.disk import small_disk
from tests.sim.view.canned import header, moving, write

STARTS = [(-4.0, -1.0, 0.0), (-1.0, 2.0, 0.0)]
ENDS = [(-4.0, -1.0, 1.0), (0.0, 0.0, 0.0)]
MAP = [0.5, -2, -1, 3, 2, "kwQA"]  # of 3 x 2 cells: occupied, unknown, free; then as b64 says
HEAD = msgspec.structs.replace(
    header(["alice $x_{", "bert"]),
    obstacles=(
        Block(Point(-5.0, 2.0, 0.0), Point(-3.0, 4.0, 1.0)),
        Sphere(Point(2.0, 3.0, 1.0), 0.5),
        Cylinder(Point(2.0, -3.0, 0.0), 0.5, 2.0),
        Mesh((Point(-5, 2, 0), Point(-3, 2, 0), Point(-3, 4, 2)), ((0, 1, 2),)),
    ),
    shared=(SharedVariable("tasks", "allwrite", "List<Point>"), SharedVariable("map", "allwrite", "GridMap")),
    world=WorldRecord(BoxRecord((-5.5, -4.5, 0.0), (5.5, 4.5, 3.0)), markers=(Marker("gate", (0.0, 0.0, 0.0)),),
                marker_list=MarkerList("tasks")),
)  # fmt: skip


def rounds() -> list[dict[str, Any]]:
    def one(number: int, pid: int, **what: Any) -> dict[str, Any]:
        return {"kind": "round", "t": number / 2, "pid": pid, "round": number, "late": 0.001, **what}

    path = [[-4.0, -1.0, 0.0], [-4.0, -1.0, 1.0]]
    return [
        {"kind": "init", "t": -0.1, "pid": 0, "sensors": {"Motion.position": [-4.0, -1.0, 0.0]}},
        one(1, 0, event="Go", copy={"tasks": [path[1]]}, shared={"tasks": []}, actuators={"Motion.path": path}),
        one(2, 1, skipped="no event enabled"),
        one(3, 1, event="See", shared={"map": MAP}, sensors={"Motion.reached": True}, locals={"n": 3}),
        one(4, 1, event="Go", skipped="fault", fault={"file": "a.koord", "line": 9, "reason": "1 / 0, \"twice\"\n"}),
        {"kind": "metrics", "t": 5.0, "pid": 0, "late_ms": {"p50": 1.5}, "rejected": {"mac": 2},
         "peers": {"1": {"loss": 0.25, "delay_ms": {"p50": 1.5, "p99": 4.0}, "silent_ms": 3.0, "repeats": 2}}},
        {"kind": "log", "t": 6.0, "pid": 1, "level": "warning", "message": "=HYPERLINK(1)"},
        {"kind": "stream", "t": 6.5, "pid": 1, "round": 9, "port": "Log.out", "text": "hello"},
        {"kind": "phase", "t": 0.0, "pid": 1, "phase": "running", "detail": ""},
        {"kind": "cause", "t": 7.0, "what": "crash", "robots": ["bert"], "detail": "", "lasts": 2.0},
        {"kind": "verdict", "t": 10.0, "of": "invariant", "name": "Safe", "line": "a.koord:4", "outcome": "violated"},
    ]  # fmt: skip


@pytest.fixture
def run(tmp_path: Path) -> Path:
    marks: list[Violation | End] = [Violation(2.0, "fault", ("bert",), "a.koord:9: 1 / 0"), End(10.0, "completed")]
    write(tmp_path / "trace.jsonl", HEAD, [*moving(STARTS, ENDS), *rounds()], marks)
    return tmp_path


def test_tables_hold_all_of_the_trace(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(run), "--to", "csv"]) == 0
    assert capsys.readouterr().out == f"{run / 'csv'}\n"
    found = {}
    for table, columns in tables.COLUMNS.items():
        with (run / "csv" / f"{table}.csv").open(newline="") as file:
            found[table] = list(csv.DictReader(file))
            assert all(list(row) == list(columns) for row in found[table])
    assert len(found["poses"]) == len(moving(STARTS, ENDS))
    assert found["poses"][1] == {"t": "-1.0", "robot": "bert", "x": "-1.0", "y": "2.0", "z": "0.0", "yaw": "0.0"}
    assert found["rounds"][3]["fault"] == 'a.koord:9: 1 / 0, "twice"\n'
    values = {(row["of"], row["name"]): json.loads(row["value"]) for row in found["values"]}
    assert values == {
        ("sensor", "Motion.position"): [-4.0, -1.0, 0.0], ("sensor", "Motion.reached"): True, ("local", "n"): 3,
        ("shared", "tasks"): [], ("shared", "map"): MAP,
        ("actuator", "Motion.path"): [[-4.0, -1.0, 0.0], [-4.0, -1.0, 1.0]],
    }  # fmt: skip
    assert found["links"][0]["loss"] == "0.25" and found["links"][0]["delay_p99_ms"] == "4.0"
    assert [row["text"] for row in found["logs"]] == ["=HYPERLINK(1)", "hello"]
    assert [row["what"] for row in found["marks"]] == ["fault", "crash", "violated", "completed"]
    assert found["marks"][1]["detail"] == "for 2 s"


def fits(value: Any, schema: dict[str, Any], where: str = "$") -> None:
    """What JSON Schema says of the words that are used here, and that no field is there that is not declared."""
    of = schema.get("type")
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}
    if isinstance(of, list):
        of = "null" if value is None else next(each for each in of if each != "null")
    if of in ("number", "integer"):
        assert type(value) in ((int,) if of == "integer" else (int, float)), (where, value)
        assert value >= schema.get("minimum", value) and value <= schema.get("maximum", value), (where, value)
    elif of is not None:
        assert isinstance(value, kinds[of]), (where, value)
    if "properties" in schema:
        assert set(value) == set(schema["required"]) == set(schema["properties"]), where
        for key, each in schema["properties"].items():
            fits(value[key], each, f"{where}.{key}")
    for k, each in enumerate(value if "items" in schema else ()):
        fits(each, schema["items"], f"{where}[{k}]")


def messages(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    found: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None and (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            told = json.loads(schema.data)
            assert told["title"] == schema.name and schema.name in SCHEMAS
            what = json.loads(message.data)
            fits(what, told)
            found.setdefault(channel.topic, []).append((message.log_time, what))
    return found


def test_a_recording_holds_what_its_schemas_say(run: Path) -> None:
    assert main(["export", str(run / "trace.jsonl"), "--to", "mcap"]) == 0
    found = messages(run / "trace.mcap")
    assert set(found) == {
        "/poses/alice $x_{", "/poses/bert", "/tf", "/scene", "/separation", "/rounds/alice $x_{", "/rounds/bert",
        "/shared/tasks", "/shared/map", "/maps/map", "/metrics/alice $x_{", "/log", "/phases", "/verdicts", "/causes",
    }  # fmt: skip
    at, pose = found["/poses/bert"][2]
    assert at == 1_000_000_000 and pose["timestamp"] == {"sec": 1, "nsec": 0}  # round 1 begins 1 s after the file
    assert pose["pose"]["position"] == {"x": -1.0, "y": 2.0, "z": 0.0}
    assert [what["child_frame_id"] for _, what in found["/tf"][:2]] == ["alice $x_{", "bert"]
    grid = found["/maps/map"][0][1]
    assert grid["pose"]["position"] == {"x": -1.0, "y": -0.5, "z": 0.0}
    assert (grid["column_count"], b64decode(grid["data"])) == (3, bytes([3, 0, 1, 2, 0, 1]))
    assert [what["what"] for _, what in found["/verdicts"]] == ["fault", "violated"]
    with (run / "trace.mcap").open("rb") as file:
        (metadata,) = make_reader(file).iter_metadata()
    assert metadata.metadata["round_1_at"] == "1" and metadata.metadata["seed"] == "3"


def test_the_scene_has_the_world_and_markers_that_turn(run: Path) -> None:
    assert main(["export", str(run), "--to", "mcap", "-o", str(run / "x.mcap")]) == 0
    updates = [what["entities"] for _, what in messages(run / "x.mcap")["/scene"]]
    first = {entity["id"]: entity for entity in updates[0]}
    assert set(first) >= {"obstacle 0", "obstacle 3", "geofence", "arena", "robot bert", "marker 0"}
    assert first["obstacle 0"]["cubes"][0]["size"] == {"x": 2.0, "y": 2.0, "z": 1.0}
    assert first["obstacle 3"]["triangles"][0]["indices"] == [0, 1, 2]
    assert len(first["geofence"]["lines"][0]["points"]) == 24
    assert first["robot bert"]["frame_id"] == "bert" and first["robot bert"]["frame_locked"]
    listed = [e["spheres"][0]["color"]["r"] for update in updates for e in update if e["id"] == "marker 1"]
    assert listed == [round(int(colour[1:3], 16) / 255, 4) for colour in STATES]
    assert any(e["id"] == "path alice $x_{" for update in updates for e in update)


def test_the_same_trace_gives_the_same_recording(run: Path) -> None:
    for name in ("a", "b"):
        assert main(["export", str(run), "--to", "mcap", "-o", str(run / name)]) == 0
    assert (run / "a").read_bytes() == (run / "b").read_bytes()


def test_pictures_and_a_map_at_three_times(run: Path) -> None:
    assert main(["export", str(run), "--to", "png", "-o", str(run / "p")]) == 0
    assert {p.name for p in (run / "p").iterdir()} == {
        "top.png", "x-t.png", "y-t.png", "z-t.png", "separation.png", "map-map.png",
    }  # fmt: skip


def test_a_maps_cells_lie_where_the_robots_say() -> None:
    found = cells(MAP)
    assert found is not None
    assert found[0].tolist() == [[3, 0, 1], [2, 0, 1]] and found[1] == (-1.0, 0.5, -0.5, 0.5)
    for wrong in (None, [], [0.5, 0, 0, 9, 9, "AA=="], [0.5, 0, 0, 1, 1, 7], [0.0, 0, 0, 0, 0, ""]):
        assert cells(wrong) is None


def test_a_gif_shows_the_run_as_it_went(run: Path) -> None:
    assert main(["export", str(run), "--to", "gif"]) == 0
    with Image.open(run / "trace.gif") as opened:
        picture: Any = opened
        assert picture.format == "GIF" and picture.is_animated and 100 < picture.n_frames <= 201
        first = np.asarray(picture.convert("RGB")).astype(int)
        picture.seek(picture.n_frames - 1)
        last = np.asarray(picture.convert("RGB")).astype(int)

    def many(picture: Any, colour: str) -> int:
        wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
        return int((np.abs(picture - wanted).max(axis=2) < 12).sum())

    assert many(first, STATES[0]) > 20 and many(last, STATES[0]) == 0  # both markers were to do, and are done
    assert many(last, STATES[2]) > many(first, STATES[2]) + 20  # robots stand on them


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_a_film_is_one(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "MP4", (4, *film.MP4[1:]))  # fewer pictures a second: the test is quicker
    assert main(["export", str(run), "--to", "mp4", "-o", str(run / "talk.film")]) == 0
    asked = ["-show_entries", "stream=width,duration", "-of", "json", str(run / "talk.film")]
    probe = ["ffprobe", "-loglevel", "error", *asked]
    stream = json.loads(subprocess.run(probe, capture_output=True, check=True).stdout)["streams"][0]
    assert stream["width"] == 880 and float(stream["duration"]) == pytest.approx(12.0, abs=0.5)


def test_without_ffmpeg_there_is_a_way_out(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("targets.sim.view.pictures.film.shutil.which", lambda name: None)
    assert main(["export", str(run), "--to", "mp4"]) == 5
    said = capsys.readouterr().err
    assert "ffmpeg" in said and "--to gif" in said


@pytest.mark.parametrize("to", ["mcap", "csv", "gif"])
def test_what_is_no_trace_or_half_a_one_is_told_with_its_place(
    run: Path, to: str, capsys: pytest.CaptureFixture[str]
) -> None:
    own = run / "own.jsonl"
    own.write_text('{"kind":"header","format":"koord-trace/1","app":"a","robot":"bert"}\n')
    assert main(["export", str(own), "--to", to]) == 1
    assert "own.jsonl" in capsys.readouterr().err
    whole = (run / "trace.jsonl").read_bytes()
    (run / "trace.jsonl").write_bytes(whole[:-9])
    assert main(["export", str(run), "--to", to]) == 1
    assert f"trace.jsonl:{whole.count(10)}: " in capsys.readouterr().err
    assert main(["export", str(run / "nowhere"), "--to", to]) == 1


def test_a_place_that_cannot_be_written_is_told(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for to in ("mcap", "gif"):
        assert main(["export", str(run), "--to", to, "-o", str(run / "no" / "where")]) == 5
        assert str(run / "no" / "where") in capsys.readouterr().err
    assert main(["report", str(run), "-o", str(run / "no" / "where")]) == 5


def test_what_stood_there_survives_a_disk_that_gets_full(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with small_disk(tmp_path / "small", "200k") as small:
        for name in ("own.html", "own.mcap"):
            (small / name).write_text("of an earlier run")
        (small / "filler").write_bytes(b"x" * 180_000)
        for words in (["report"], ["export", "--to", "mcap"], ["export", "--to", "csv"]):
            path = small / f"own.{'html' if words == ['report'] else words[-1]}"
            assert main([words[0], str(run), *words[1:], "-o", str(path)]) == 5
            assert f"error: {path}: No space left on device" in capsys.readouterr().err
        assert sorted(p.name for p in small.iterdir()) == ["filler", "own.html", "own.mcap"]
        assert (small / "own.html").read_text() == (small / "own.mcap").read_text() == "of an earlier run"


def test_the_report_of_a_folder_and_of_a_trace(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(run)]) == 0
    assert capsys.readouterr().out == f"{run / 'report.html'}\n"
    assert main(["report", str(run / "trace.jsonl"), "-o", str(run / "own.html")]) == 0
    assert (run / "own.html").read_bytes() == (run / "report.html").read_bytes()


def test_what_is_exported_into_a_runs_folder_does_not_refuse_the_next_run(tmp_path: Path) -> None:
    with RunFolder(tmp_path) as run:
        write(run / "trace.jsonl", HEAD, [*moving(STARTS, ENDS), *rounds()])
        (run / "plots").mkdir()
        (run / "plots" / "of-the-run.png").touch()
    for to in ("mcap", "csv", "png"):
        assert main(["export", str(run), "--to", to]) == 0
    assert main(["export", str(run), "--to", "mcap", "-o", str(run / "own.mcap")]) == 0
    assert main(["report", str(run), "-o", str(run / "page.html")]) == 0
    with RunFolder(run):
        assert [each.name for each in run.iterdir()] == [MARKER]


def test_a_note_beside_exported_tables_saves_the_folder(tmp_path: Path) -> None:
    with RunFolder(tmp_path) as run:
        write(run / "trace.jsonl", HEAD, [*moving(STARTS, ENDS), *rounds()])
    assert main(["export", str(run), "--to", "csv"]) == 0
    (run / "csv" / "notes.txt").write_text("mine")
    with pytest.raises(ForeignFolder, match=r"csv/notes\.txt"), RunFolder(run):
        pass
    assert (run / "csv" / "poses.csv").exists()


def test_tracks_of_a_run_have_markers_maps_and_paths(run: Path) -> None:
    found = tracks(HEAD, gathered(*trace.read(run / "trace.jsonl")))
    assert [[state for _, state in marker.states] for marker in found.markers] == [[2], [0, 1, 2]]
    assert [t for t, _ in found.maps["map", -1]] == [1.5]
    assert found.paths[0][0][1].shape == (2, 3) and found.end == 10.0
    assert found.violations == [(2.0, "fault", ["bert"])]


def test_a_users_own_targets_are_not_taken_for_ours(run: Path) -> None:
    (run / "targets").mkdir()
    (run / "targets" / "__init__.py").write_text("raise SystemExit('another one')\n")
    command = [sys.executable, "-m", "koordgen", "report", "."]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    done = subprocess.run(command, cwd=run, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "report.html\n"), done.stderr
