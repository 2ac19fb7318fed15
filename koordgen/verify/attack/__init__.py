"""Attack on PROVED: runs concrete states through the executable semantics, in exact arithmetic.

One contradiction shows that the prover is wrong. Finding none proves nothing.

Owns: sources of states, the steps that are run on them, contradictions of verdicts, the file of a contradiction.
Offers: `attack.attack`, `judge.TrialJudge.replay` and `file`.
Must not import: the prover's obligations (`verify.prove.obligations`), because it would repeat their mistakes.
"""
