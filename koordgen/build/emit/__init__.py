"""Emit: IR to the text of `program.py` and `properties.py`.

Owns: spelling of expressions and statements in Python, their layout, compiled templates.
Offers: `program`, `property`, `render`.
Must not import: `bundle`, or the fleet.
"""
