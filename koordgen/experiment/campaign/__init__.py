"""Campaign: many runs of one bundle.

Owns: variation of runs, their executors (a pool, a Dask cluster), the store of results, the table, plots.
Offers: `drive`, `table`.
Must not import: `validate`, the compiler.
"""
