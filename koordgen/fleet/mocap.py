"""Motion capture frame: `mocap` in the fleet file, and the transformation of poses into the fleet's frame.

Both frames are right-handed and in metres; the fleet's frame is local ENU.
"""

from __future__ import annotations

import math

from koordgen.fleet.yaml_reader import YamlNode, YamlReader
from koordgen.lang.node import Node

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # x, y, z, w

UPRIGHT = 0.1  # a body has no heading if the horizontal part of its unit forward axis is shorter
AXES = ("z", "y")


class Mocap(Node):
    """Frame of the motion capture system, relative to the fleet's frame.

    up: its axis that points up. yaw: angle (rad, counter-clockwise from above) from the fleet's horizontal axes to its
    own. offset: position (m) of its origin in the fleet's frame.
    """

    up: str = "z"
    yaw: float = 0.0
    offset: Vector = (0.0, 0.0, 0.0)

    def pose(self, position: Vector, rotation: Quaternion) -> tuple[Vector, float] | None:
        """Return position (m) and yaw (rad) of a body in local ENU; its x axis points forward.

        None if a number is not finite, the quaternion is not a rotation, or the body is too steep to have a heading.
        """
        if not all(map(math.isfinite, (*position, *rotation))):
            return None
        length = math.hypot(*rotation)
        if not 0.5 < length < 2.0:
            return None
        x, y, z, w = (part / length for part in rotation)
        # x axis of the body in the fleet's frame
        ahead = self._enu((1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)))
        if math.hypot(ahead[0], ahead[1]) < UPRIGHT:
            return None
        p, o = self._enu(position), self.offset
        return (p[0] + o[0], p[1] + o[1], p[2] + o[2]), math.atan2(ahead[1], ahead[0])

    def _enu(self, v: Vector) -> Vector:
        x, y, z = v if self.up == "z" else (v[0], -v[2], v[1])
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return x * cos - y * sin, x * sin + y * cos, z


def read_mocap(reader: YamlReader, node: YamlNode | None) -> Mocap:
    """Read the fleet file's `mocap`."""
    given = reader.table(node, "mocap", [], ["up", "yaw", "offset"])
    up = reader.scalar(given.get("up"), "mocap.up", str)
    if up is not None and up not in AXES:
        reader.report(
            "F005",
            f"mocap.up cannot be {up!r}",
            given["up"],
            "write the axis that points up: z, or y (the default of OptiTrack)",
        )
    yaw = reader.number(given.get("yaw"), "mocap.yaw (radians)", -6.3, 6.3)
    x, y, z = reader.vector(given.get("offset"), "mocap.offset") or (0.0, 0.0, 0.0)
    return Mocap(up or "z", yaw or 0.0, (x, y, z))
