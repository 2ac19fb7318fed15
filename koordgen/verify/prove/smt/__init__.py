"""SMT: terms, their text, and solvers.

Owns: exact many-sorted terms, obligations as data, SMT-LIB 2.6, solver processes and their answers.
Offers: `term`, `smtlib`, `solve.solver_of`.
Must not import: any other package of the prover.
"""
