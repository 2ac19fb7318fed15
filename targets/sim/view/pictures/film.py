"""Animated top view of a run: a GIF by Pillow, or MP4 by ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray
from PIL import Image

from targets.sim.view.data.colours import COLOURS, STATES, of_robot
from targets.sim.view.data.failures import CannotMake
from targets.sim.view.data.tracks import Tracks
from targets.sim.view.pictures import ground

Frame = NDArray[np.uint8]
TAIL = 8.0  # seconds of each robot's track that are highlighted
# Frames per second, longest film in seconds, dots per inch.
GIF, MP4 = (10, 20.0, 80), (20, 45.0, 110)
SPEEDS = (1, 2, 3, 4, 5, 8, 10, 15, 20, 30, 60, 120, 300, 600)
ARROW = np.array([[1.0, 0.0], [-0.8, 0.65], [-0.45, 0.0], [-0.8, -0.65]])


def write(path: Path, found: Tracks, moving: bool) -> None:
    """Write a film: MP4 if `moving`, otherwise a GIF.

    Long runs are sped up, as the title shows. Raises CannotMake, OSError."""
    if moving and shutil.which("ffmpeg") is None:
        hint = "install it (Debian: apt install ffmpeg), or use --to gif"
        raise CannotMake("MP4 needs ffmpeg, which is not installed", hint)
    rate, longest, dots = MP4 if moving else GIF
    first, last = _span(found)
    speed = next((s for s in SPEEDS if (last - first) / s <= longest), SPEEDS[-1])
    with plt.rc_context(ground.STYLE):
        figure, axes = plt.subplots(figsize=(8, 7), dpi=dots, layout="constrained")
        try:
            scene = _Scene(axes, found, speed)
            frames = (scene.frame(float(t)) for t in np.arange(first, last, speed / rate))
            (_as_mp4 if moving else _as_gif)(path, frames, rate)
        finally:
            plt.close(figure)


def _as_gif(path: Path, frames: Iterator[Frame], rate: int) -> None:
    palette = _palette()
    pictures = (Image.fromarray(f).convert("RGB").quantize(palette=palette, dither=Image.Dither.NONE) for f in frames)
    begin = next(pictures)
    with path.open("wb") as file:  # a file object, so that an error such as a full disk names the file
        begin.save(file, "GIF", save_all=True, append_images=pictures, duration=1000 // rate, loop=0)


def _palette() -> Image.Image:
    """Return a palette of all colours of the scene and their blends with white, which edges of lines have.

    Its colours are exact, unlike those of a palette computed from a frame."""
    bases = ("#000000", ground.UNKNOWN, ground.OCCUPIED, *dict.fromkeys((*STATES, *COLOURS)))
    parts = [[int(base[k : k + 2], 16) for k in (1, 3, 5)] for base in bases]
    blends = {tuple(round(255 + (p - 255) * k / 8) for p in part) for part in parts for k in range(9)}
    palette = Image.new("P", (1, 1))
    palette.putpalette([part for blend in sorted(blends) for part in blend][: 3 * 256])
    return palette


def _as_mp4(path: Path, frames: Iterator[Frame], rate: int) -> None:
    height, width, _ = (begin := next(frames)).shape
    raw = ["-f", "rawvideo", "-pix_fmt", "rgba", "-s", f"{width}x{height}", "-r", str(rate), "-i", "-"]
    command = ["ffmpeg", "-y", "-loglevel", "error", *raw, "-pix_fmt", "yuv420p", "-f", "mp4", str(path.resolve())]
    with tempfile.TemporaryFile() as said:
        encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said)
        assert encoder.stdin is not None
        try:
            with encoder.stdin as pipe:
                for frame in chain([begin], frames):
                    pipe.write(frame.tobytes())
        except BrokenPipeError:  # ffmpeg's own output has the reason
            pass
        if encoder.wait() != 0:
            said.seek(0)
            words = said.read().decode("utf-8", "replace").strip().splitlines()
            raise CannotMake(f"ffmpeg could not write the film: {words[-1] if words else 'no error message'}", "")


def _span(found: Tracks) -> tuple[float, float]:
    """Return the times shown: from a second before round 1 to shortly after the mission's end."""
    first, last = found.span()
    end = last if found.end is None else min(last, found.end + 1.0)
    return max(first, min(-1.0, end - 1.0)), max(end, first + 0.5)


class _Scene:
    """Moving parts of the picture: robots with their tracks, planned paths, markers, maps."""

    def __init__(self, axes: Any, found: Tracks, speed: int) -> None:
        self._axes, self._found, self._speed = axes, found, speed
        self._still: Any = None
        ground.lay(axes, found.header)
        if found.header.geofence is None:
            self._fit()
        axes.set(xlim=axes.get_xlim(), ylim=axes.get_ylim())  # fix the limits, or a map would change them
        self._title = axes.set_title("0", loc="left", animated=True)
        self._trails = [axes.plot([], [], linewidth=1.2, alpha=0.45, **ground.style(p))[0] for p in self._pids()]
        self._tails = [axes.plot([], [], linewidth=2.6, color=of_robot(p))[0] for p in self._pids()]
        self._ahead = [axes.plot([], [], linewidth=1.2, linestyle=":", color=of_robot(p))[0] for p in self._pids()]
        self._bodies = [axes.fill([0], [0], color=of_robot(p), edgecolor="white", zorder=4)[0] for p in self._pids()]
        self._names = [
            axes.annotate(found.header.robots[p].name, (0, 0), (9, 7), textcoords="offset points", color=of_robot(p),
                          fontweight="bold", fontsize=9, annotation_clip=True, path_effects=ground.HALO)
            for p in self._pids()
        ]  # fmt: skip
        self._moving = [*self._trails, *self._ahead, *self._tails, *self._bodies, *self._names, self._title]
        for artist in self._moving:
            artist.set_animated(True)
        self._size = 0.022 * max(axes.get_xlim()[1] - axes.get_xlim()[0], axes.get_ylim()[1] - axes.get_ylim()[0])

    def _pids(self) -> range:
        return range(len(self._found.header.robots))

    def _fit(self) -> None:
        whole = [p[:, :2] for p in self._found.places if len(p)]
        if whole:
            low, high = np.min(np.vstack(whole), axis=0) - 0.7, np.max(np.vstack(whole), axis=0) + 0.7
            self._axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))

    def frame(self, t: float) -> Frame:
        """Return the picture at a time, rows from above, RGBA. The static background is drawn once."""
        canvas = self._axes.figure.canvas
        if self._still is None:
            canvas.draw()
            self._axes.figure.set_layout_engine("none")
            self._still = canvas.copy_from_bbox(self._axes.figure.bbox)
        canvas.restore_region(self._still)
        fast = f", {self._speed} × real time" if self._speed > 1 else ""
        self._title.set_text(f"{self._found.header.app}: {t:.1f} s{fast}")
        passing = self._map(t) + ground.mark(self._axes, self._found, t)
        for pid in self._pids():
            self._robot(pid, t)
        for artist in (*passing, *self._moving):
            self._axes.draw_artist(artist)
        for artist in passing:
            artist.remove()
        return np.array(canvas.buffer_rgba())

    def _map(self, t: float) -> list[Any]:
        """Draw the first map of the shared store."""
        series = next(iter(self._found.maps.values()), [])
        value = next((v for at, v in reversed(series) if at <= t), None)
        image = ground.draw_map(self._axes, value)
        return [] if image is None else [image]

    def _robot(self, pid: int, t: float) -> None:
        found = self._found
        upto = found.upto(pid, t)
        if not upto:
            return
        places, since = found.places[pid], found.upto(pid, t - TAIL)
        self._trails[pid].set_data(places[:upto, 0], places[:upto, 1])
        self._tails[pid].set_data(places[since:upto, 0], places[since:upto, 1])
        x, y, _, yaw = places[upto - 1]
        self._bodies[pid].set_xy(Affine2D().scale(self._size).rotate(yaw).translate(x, y).transform(ARROW))
        self._names[pid].xy = (x, y)
        path = next((points for at, points in reversed(found.paths[pid]) if at <= t), np.empty((0, 3)))
        if len(path) == 1:
            path = np.vstack([places[upto - 1, :3], path])
        self._ahead[pid].set_data(path[:, 0], path[:, 1])
