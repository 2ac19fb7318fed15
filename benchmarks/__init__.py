"""Benchmarks, run as scripts: `python benchmarks/NAME.py`.

`fixtures` is what they share with the tests. A benchmark imports neither a test nor a test's packages.
"""
