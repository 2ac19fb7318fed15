"""Campaign: many runs of one bundle.

Owns: what varies, who executes runs (a pool, a Dask cluster), the store, the table, plots.
Offers: `drive`, `table`.
Must not import: `validate`, the compiler.
"""
