from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.runs import Say


@pytest.fixture
def say(capsys: pytest.CaptureFixture[str]) -> Say:
    """A line for whoever watches: these tests take minutes."""

    def told(line: str) -> None:
        with capsys.disabled():
            print(f"\n    {line}", end="", flush=True)

    return told


@pytest.fixture(scope="session")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where compiled programs are kept for the session."""
    return tmp_path_factory.mktemp("bundles")
