"""The nodes that the grammar's rules make: each function gets a rule's children, tokens included.

The names are those of koord.lark; parse.py looks them up here. A function refuses only what the grammar cannot see:
a number or an escape that does not exist, a tuple of one, a chain too long, an expression in a type's place.
"""

from koordgen.syntax.build_base import Refused as Refused
from koordgen.syntax.build_base import refused as refused
from koordgen.syntax.build_base import token_span as token_span
from koordgen.syntax.build_broken import *  # noqa: F403
from koordgen.syntax.build_decl import *  # noqa: F403
from koordgen.syntax.build_expr import *  # noqa: F403
from koordgen.syntax.build_stmt import *  # noqa: F403
from koordgen.syntax.build_type import *  # noqa: F403
