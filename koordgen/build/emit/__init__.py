"""Emit: IR to the text of `program.py` and `properties.py`.

Owns: the Python text of expressions and statements, its layout, compiled templates.
Offers: `program`, `property`, `render`.
Must not import: `bundle`, or the fleet.
"""
