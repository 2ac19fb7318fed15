"""YAML syntax errors: equal messages for both parsers of PyYAML, with a place and a help text."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from koordgen.fleet.yaml_errors import mistake

TEXTS = [
    ("robots:\n  - name: a\n    x: 1\n - name: b\n", 4, 2, "column 2, but the one above it, in line 2, at 3", "by 2"),
    ("robots:\n  - name: a\n    x: 1\n    - name: b\n", 4, 5, "list entry is at column 5", "by 2 spaces"),
    ("robots:\n  - name: a\n   x: 1\n", 3, 4, "this key is at column 4, but the one above", "by 4 spaces"),
    ("robots:\n  - name: a\n  name: b\n", 3, 3, "this key is at column 3", "by 4 spaces"),
    ("robots:\n- name: a\nb: 3\n- name: c\n", 4, 1, "a '-' begins a list entry", "'key: value'"),
    ("delta: 0.1\n  origin: 1\n", 2, 9, "indented below line 1, which already has a value", "alike"),
    ("a: b: c\n", 1, 5, "a second ': '", "in quotes"),
    ("a:\n\tb: 1\n", 2, 1, "a tab", "indent with spaces"),
    ("a:\n  b: 1\n\tc: 1\n", 3, 1, "a tab", "indent with spaces"),
    ("a: [1, 2\nb: 3\n", 1, 4, "this '[' is not closed", "']'"),
    ("a: {b: 1\nc: 3\n", 1, 4, "this '{' is not closed", "'}'"),
    ("a: {b: 1 c: 2}\n", 1, 11, "a ',' or '}' is missing", ""),
    ("robots:\n  - name: a\n    target quad\n    x: 1\n", 3, 5, "no ': '", "'key: value'"),
    ("robots:\n  name:a\n  x: 1\n", 3, 4, "line 2 has no space after its ':'", "'name: a'"),
    ("a: 'it\nb: 2\n", 1, 4, "this quote is not closed", "same quote"),
    ("a: 'it's'\nb: 2\n", 1, 8, "the value ends before this: s'", "quotes of the other kind"),
    ("a: @b\n", 1, 4, "a value cannot begin with '@'", "in quotes"),
    ("a: *b\n", 1, 4, "undefined alias", "in quotes"),
    ("a: \x01\n", 1, 4, "the character with the code 1", "delete it"),
    ("a: 1\n---\nb: 2\n", 2, 1, "a second document", "'---'"),
    ("a: ]\n", 1, 4, "a value is expected here", ""),
]  # fmt: skip


@pytest.mark.parametrize("loader", [yaml.CSafeLoader, yaml.SafeLoader])
@pytest.mark.parametrize(("text", "line", "column", "message", "help"), TEXTS)
def test_a_mistake_has_a_place_and_a_way_out(
    loader: Any, text: str, line: int, column: int, message: str, help: str
) -> None:
    with pytest.raises(yaml.YAMLError) as raised:
        yaml.compose(text, Loader=loader)
    found = mistake(raised.value, text)
    assert (found.line, found.column) == (line, column)
    assert message in found.message and help in found.help
