"""Failure of a command on a run that is over."""

from __future__ import annotations


class CannotMake(Exception):
    """Something that is needed is not there; the message says what, `hint` the way out."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.hint = hint
