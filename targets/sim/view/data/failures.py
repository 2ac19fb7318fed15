"""Failure of a command on a finished run."""

from __future__ import annotations


class CannotMake(Exception):
    """A required program or package is missing; the message names it, `hint` the way out."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.hint = hint
