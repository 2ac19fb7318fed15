"""Campaigns: many simulation runs of one program with varied settings, and the statistics of their results.

Owns: variation of settings, executors of runs (a local pool, a Dask cluster), the stored results, tables, plots.
Offers: `drive`, `table`.
Must not import: `validate`, the compiler.
"""
