"""Diagnostics as SARIF 2.1.0, a format that code hosts and editors show at the lines of a change."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from urllib.parse import quote

from koordgen import __version__
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.explain import explanation, show
from koordgen.lang.source import Source, Span

_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"


def to_sarif(found: Iterable[tuple[Source, Diagnostic]], folder: Path) -> str:
    """Return a SARIF log of one run; its rules are the codes found. Paths in `folder` (absolute) are relative to it."""
    pairs = list(found)
    codes = sorted({d.code for _, d in pairs})
    results = [_result(source, d, codes.index(d.code), folder) for source, d in pairs]
    driver = {"name": "koordgen", "version": __version__, "rules": [_rule(code) for code in codes]}
    run = {"tool": {"driver": driver}, "columnKind": "unicodeCodePoints", "results": results}
    return json.dumps({"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]}, indent=2)


def _rule(code: str) -> dict[str, Any]:
    found = explanation(code)
    return {
        "id": code,
        "shortDescription": {"text": _literal(found.title)},
        "help": {"text": _literal(show(found)), "markdown": _literal(found.markdown)},
    }


def _result(source: Source, d: Diagnostic, rule: int, folder: Path) -> dict[str, Any]:
    text = f"{d.message}\nhelp: {d.help}" if d.help else d.message
    result: dict[str, Any] = {
        "ruleId": d.code,
        "ruleIndex": rule,
        "level": d.severity,
        "message": {"text": _literal(text)},
        "locations": [_location(source, d.span, folder)],
    }
    if d.labels:
        result["relatedLocations"] = [
            {**_location(source, label.span, folder), "message": {"text": _literal(label.text)}} for label in d.labels
        ]
    if d.edits:
        replacements = [
            {"deletedRegion": _region(edit.span), "insertedContent": {"text": edit.text}} for edit in d.edits
        ]
        change = {"artifactLocation": {"uri": _uri(source.path, folder)}, "replacements": replacements}
        result["fixes"] = [{"description": {"text": _literal(d.help or d.message)}, "artifactChanges": [change]}]
    return result


def _location(source: Source, span: Span, folder: Path) -> dict[str, Any]:
    artifact = {"uri": _uri(source.path, folder)}
    return {"physicalLocation": {"artifactLocation": artifact, "region": _region(span)}}


def _region(span: Span) -> dict[str, int]:
    return {
        "startLine": span.line,
        "startColumn": span.column,
        "endLine": span.end_line,
        "endColumn": span.end_column,
    }


def _uri(path: str, folder: Path) -> str:
    whole = Path(os.path.normpath(folder / path))
    # Bytes, because a name may not be UTF-8. A colon is quoted: the text before it would be read as a URI scheme.
    return quote(os.fsencode(whole.relative_to(folder))) if whole.is_relative_to(folder) else whole.as_uri()


def _literal(text: str) -> str:
    """Escape braces: in SARIF, single braces are placeholders (section 3.11.5)."""
    return text.replace("{", "{{").replace("}", "}}")
