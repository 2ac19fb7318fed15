"""Benchmarks, run as scripts: `python benchmarks/NAME.py`.

`fixtures` has the code that benchmarks share with tests. A benchmark imports neither a test nor a test's packages.
"""
