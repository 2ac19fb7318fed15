"""Data of all views.

Owns: rows, markers, tracks and colours made of a trace; CSV tables; what each robot knew at a time.
Offers: `rows`, `tracks`, `tables`, `show`.
Must not import: any other package of `view`.
"""
