"""JSON schemas of the messages for Foxglove.

Schemas foxglove.* have the fields that Foxglove publishes for its well-known schemas, so its panels understand them;
koord.* are defined here. Each message has every declared field."""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]

TEXT: Schema = {"type": "string"}
NUMBER: Schema = {"type": "number"}
COUNT: Schema = {"type": "integer", "minimum": 0}
FLAG: Schema = {"type": "boolean"}
ANYTHING: Schema = {}


def table(**properties: Schema) -> Schema:
    """Return the schema of an object with exactly these fields."""
    return {"type": "object", "properties": properties, "required": list(properties)}


def rows(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def maybe(schema: Schema) -> Schema:
    return {**schema, "type": [schema["type"], "null"]}


TIME = table(sec=COUNT, nsec={"type": "integer", "minimum": 0, "maximum": 999_999_999})
VECTOR = table(x=NUMBER, y=NUMBER, z=NUMBER)
TURN = table(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
POSE = table(position=VECTOR, orientation=TURN)
COLOUR = table(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
SOLID = table(pose=POSE, size=VECTOR, color=COLOUR)
ENTITY = table(
    timestamp=TIME,
    frame_id=TEXT,
    id=TEXT,
    lifetime=TIME,
    frame_locked=FLAG,
    metadata=rows(table(key=TEXT, value=TEXT)),
    arrows=rows(ANYTHING),
    cubes=rows(SOLID),
    spheres=rows(SOLID),
    cylinders=rows(table(pose=POSE, size=VECTOR, bottom_scale=NUMBER, top_scale=NUMBER, color=COLOUR)),
    lines=rows(
        table(
            type=COUNT, pose=POSE, thickness=NUMBER, scale_invariant=FLAG, points=rows(VECTOR), color=COLOUR,
            colors=rows(COLOUR), indices=rows(COUNT),
        )
    ),
    triangles=rows(table(pose=POSE, points=rows(VECTOR), color=COLOUR, colors=rows(COLOUR), indices=rows(COUNT))),
    texts=rows(
        table(pose=POSE, billboard=FLAG, font_size=NUMBER, scale_invariant=FLAG, color=COLOUR, text=TEXT)
    ),
    models=rows(ANYTHING),
)  # fmt: skip

SCHEMAS: dict[str, Schema] = {
    "foxglove.PoseInFrame": table(timestamp=TIME, frame_id=TEXT, pose=POSE),
    "foxglove.FrameTransform": table(
        timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=VECTOR, rotation=TURN
    ),
    "foxglove.SceneUpdate": table(
        deletions=rows(table(timestamp=TIME, type=COUNT, id=TEXT)), entities=rows(ENTITY)
    ),
    "foxglove.Log": table(
        timestamp=TIME, level={"type": "integer", "minimum": 0, "maximum": 5}, message=TEXT, name=TEXT, file=TEXT,
        line=COUNT,
    ),
    "foxglove.Grid": table(
        timestamp=TIME, frame_id=TEXT, pose=POSE, column_count=COUNT, cell_size=table(x=NUMBER, y=NUMBER),
        row_stride=COUNT, cell_stride=COUNT, fields=rows(table(name=TEXT, offset=COUNT, type=COUNT)),
        data={"type": "string", "contentEncoding": "base64"},
    ),
    "koord.Round": table(
        t=NUMBER, robot=TEXT, round=COUNT, event=maybe(TEXT), skipped=maybe(TEXT), fault=maybe(TEXT), late=NUMBER
    ),
    "koord.Shared": table(t=NUMBER, robot=TEXT, round=COUNT, name=TEXT, value=ANYTHING),
    "koord.Verdict": table(
        t=NUMBER, kind=TEXT, what=TEXT, robots=rows(TEXT), name=TEXT, line=TEXT, detail=TEXT
    ),
    "koord.Phase": table(t=NUMBER, robot=TEXT, phase=TEXT, detail=TEXT),
    "koord.Metrics": table(
        t=NUMBER, robot=TEXT, late_ms={"type": "object"}, rejected={"type": "object"}, peers={"type": "object"}
    ),
    "koord.Separation": table(t=NUMBER, distance=NUMBER, robots=rows(TEXT)),
}  # fmt: skip


def schema(name: str) -> Schema:
    """Return the full schema of a name."""
    return {"title": name, "$schema": "https://json-schema.org/draft/2020-12/schema", **SCHEMAS[name]}
