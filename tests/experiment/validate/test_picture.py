"""Picture: a row for each platform, with every window outside of the box; none if nothing moved."""

from __future__ import annotations

from pathlib import Path

from koordgen.experiment.validate.picture import draw
from tests.experiment.validate.windows import sample, window


def test_a_row_for_each_platform(tmp_path: Path) -> None:
    rows = [window(r, pid, "v", (0.0, 0.01 * r, 0.0)) for r in (1, 2, 3) for pid in (0, 1)]
    picture = tmp_path / "windows.png"
    assert draw([sample(tmp_path, rows)], "title", picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    width, height = (int.from_bytes(picture.read_bytes()[k : k + 4], "big") for k in (16, 20))
    one = tmp_path / "one.png"
    only = [window(1, pid, "h") for pid in (0, 1)]
    assert draw([sample(tmp_path, only)], "nobody was outside", one)
    assert width > 1000 and height > 600


def test_without_ways_there_is_none(tmp_path: Path) -> None:
    still = [{"round": 1, "pid": pid, "came": "h"} for pid in (0, 1)]
    assert not draw([sample(tmp_path, still)], "title", tmp_path / "windows.png")
    assert not draw([], "title", tmp_path / "windows.png") and not (tmp_path / "windows.png").exists()
