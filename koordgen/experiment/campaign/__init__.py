"""Campaign: many runs of one program's simulation bundle.

Owns: variation of runs, executors (a local pool, a Dask cluster), the store of results, the table, plots.
Offers: `drive`, `table`.
Must not import: `validate`, the compiler.
"""
