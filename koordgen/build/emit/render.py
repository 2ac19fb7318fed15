"""Renders the few templates from their compiled form.

They are compiled ahead (`make generated`), because parsing them at each start would cost more than rendering them.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from jinja2 import BaseLoader, Environment, StrictUndefined, Template

COMPILED = "koordgen.build.emit._generated.templates"


def render(template: str, **values: Any) -> str:
    """The text of templates/<template>.j2 for these values; a value that a template names and nobody gives raises."""
    compiled = import_module(f"{COMPILED}.{module_name(template)}")
    env = _environment()
    return Template.from_module_dict(env, vars(compiled), env.make_globals(None)).render(values)


def module_name(template: str) -> str:
    """The compiled module of a template: `program.py` -> `program_py`."""
    return template.replace(".", "_")


def environment(loader: BaseLoader | None = None) -> Environment:
    """The one set of rules that templates are written for."""
    return Environment(
        loader=loader, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )


_environment = cache(environment)
