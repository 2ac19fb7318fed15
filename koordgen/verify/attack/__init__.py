"""Attack on PROVED invariants: runs the executable semantics on concrete states, with exact numbers.

One contradiction shows that the prover is wrong. If no contradiction is found, nothing is proved.

Owns: sources of states, the steps that are run on them, contradictions of verdicts, the file of a contradiction.
Offers: `attack.attack`, `judge.TrialJudge.replay` and `file`.
Must not import: the prover's obligations (`verify.prove.obligations`), because it would repeat their mistakes.
"""
