"""Random programs that have what people write, and what judges the prover by them.

`program` writes a text of which the checker takes everything, from a seed alone; `judges` compares what is PROVED of it
with an exploration and with random runs; `shrink` makes what contradicts small; `tests.verify.prove.campaign` runs
many. It imports koordgen and nothing of the other tests.
"""
