"""Attack on PROVED: concrete states are run through the executable semantics, in exact arithmetic.

Owns where states come from, what is run on them, what contradicts a verdict, and the file of a contradiction. Offers
`attack.attack`, `judge.Judge.follow` and `file`. One contradiction shows that the prover is wrong; none shows nothing.
Must never import the prover's obligations (`koordgen.prove.generate` and `begin`): it would repeat their mistakes.
"""
