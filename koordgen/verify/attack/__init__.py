"""Attack on the prover: searches for a concrete state that contradicts the verdict PROVED of an invariant.

The executable semantics runs steps of the program from many states, with exact numbers. One contradiction shows that
the prover is wrong. An attack that finds no contradiction proves nothing.

Owns: sources of states, runs of steps, contradictions of verdicts, the file of a contradiction.
Offers: `attack.attack`, `judge.TrialJudge.replay` and `file`.
Must not import: the prover's obligations (`verify.prove.obligations`), because it would repeat their mistakes.
"""
