"""Random programs with the constructs that people write, and judges of the prover on them.

`program` writes a text of which the checker takes everything, from a seed alone; `judges` compares what is PROVED of it
with an exploration and with random runs; `shrink` makes what contradicts small; `tests.verify.prove.campaign` runs
many. It imports koordgen and nothing of the other tests.
"""
