"""Attack on PROVED: concrete states are run through the executable semantics, in exact arithmetic.

One contradiction shows that the prover is wrong; none shows nothing.

Owns: where states come from, what is run on them, what contradicts a verdict, the file of a contradiction.
Offers: `attack.attack`, `judge.Judge.follow` and `file`.
Must not import: the prover's obligations (`verify.prove.obligations`), because it would repeat their mistakes.
"""
