"""Plugin of pytest (`-p tests.compiled`): tests run against the compiled modules of the shared memory.

Tests that replace parts of the runtime are left out: compiled modules cannot be changed.
"""

from __future__ import annotations

import pytest

from koordgen.runtime.native import protocol

protocol.compile_modules()
assert protocol.use(), "the modules are compiled, and not found"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    replacing = [item for item in items if "monkeypatch" in getattr(item, "fixturenames", ())]
    config.hook.pytest_deselected(items=replacing)
    items[:] = [item for item in items if item not in replacing]
