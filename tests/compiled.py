"""Plugin of pytest (`-p tests.compiled`): tests run against the compiled modules of the shared memory.

Processes that tests start run them, too. The library is kept apart from the user's, so that other tests do not find it.
Tests that replace parts of the runtime are left out: compiled modules cannot be changed.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from koordgen.runtime.native import protocol

os.environ["XDG_CACHE_HOME"] = str(Path(__file__).parents[1] / "build/compiled")
protocol.compile_modules()
assert protocol.use(), "the modules are compiled, and not found"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    replacing = [item for item in items if "monkeypatch" in getattr(item, "fixturenames", ())]
    config.hook.pytest_deselected(items=replacing)
    items[:] = [item for item in items if item not in replacing]
