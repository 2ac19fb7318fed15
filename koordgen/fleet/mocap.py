"""How a motion capture system's frame lies in the fleet's: `mocap` in the fleet file, and what it does to a pose.

Both frames are right-handed and in metres; the fleet's is local ENU. No package is needed, and nothing of robots.
"""

from __future__ import annotations

import math

from koordgen.fleet.located import Reader, YamlNode
from koordgen.lang.node import Node

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # x, y, z, w

UPRIGHT = 0.1  # the horizontal part of the forward axis below which a body has no heading
AXES = ("z", "y")


class Mocap(Node):
    """The system's own frame: `up` is its axis that points up; its horizontal axes are turned by `yaw` (radians,
    counter-clockwise seen from above, from the fleet's); `offset` is where its origin lies in the fleet's frame."""

    up: str = "z"
    yaw: float = 0.0
    offset: Vector = (0.0, 0.0, 0.0)

    def pose(self, position: Vector, rotation: Quaternion) -> tuple[Vector, float] | None:
        """Position (m) and yaw (radians) in local ENU of a body whose own x axis points forward; None where that is no
        pose: not finite, no rotation, or so steep that it has no heading."""
        if not all(map(math.isfinite, (*position, *rotation))):
            return None
        length = math.hypot(*rotation)
        if not 0.5 < length < 2.0:
            return None
        x, y, z, w = (part / length for part in rotation)
        # The body's x axis, turned by the rotation.
        ahead = self._enu((1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)))
        if math.hypot(ahead[0], ahead[1]) < UPRIGHT:
            return None
        p, o = self._enu(position), self.offset
        return (p[0] + o[0], p[1] + o[1], p[2] + o[2]), math.atan2(ahead[1], ahead[0])

    def _enu(self, v: Vector) -> Vector:
        x, y, z = v if self.up == "z" else (v[0], -v[2], v[1])
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return x * cos - y * sin, x * sin + y * cos, z


def read_mocap(reader: Reader, node: YamlNode | None) -> Mocap:
    """The fleet file's `mocap`."""
    given = reader.table(node, "mocap", [], ["up", "yaw", "offset"])
    up = reader.scalar(given.get("up"), "mocap.up", str)
    if up is not None and up not in AXES:
        reader.report(
            "F005", f"mocap.up is {up!r}", given["up"], "the axis that points up: z, or y (OptiTrack's default)"
        )
    yaw = reader.number(given.get("yaw"), "mocap.yaw (radians)", -6.3, 6.3)
    x, y, z = reader.vector(given.get("offset"), "mocap.offset") or (0.0, 0.0, 0.0)
    return Mocap(up or "z", yaw or 0.0, (x, y, z))
