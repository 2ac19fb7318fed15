"""Rendering of templates from their compiled form.

`make generated` compiles them: parsing them in each build would take longer than rendering them.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from jinja2 import BaseLoader, Environment, StrictUndefined, Template

COMPILED = "koordgen.build.emit._generated.templates"


def render(template: str, **values: Any) -> str:
    """Return the text of templates/<template>.j2 with these values. Raises UndefinedError if one is missing."""
    compiled = import_module(f"{COMPILED}.{module_name(template)}")
    env = _environment()
    return Template.from_module_dict(env, vars(compiled), env.make_globals(None)).render(values)


def module_name(template: str) -> str:
    """Return the name of a template's compiled module: `program.py` -> `program_py`."""
    return template.replace(".", "_")


def environment(loader: BaseLoader | None = None) -> Environment:
    """Return the Jinja environment with the options that all templates need."""
    return Environment(
        loader=loader, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )


_environment = cache(environment)
