"""SMT: terms, their text, and solvers.

Owns: many-sorted terms with rational numbers, obligations as data, SMT-LIB 2.6 text, solver processes and their
answers.
Offers: `term`, `smtlib`, `solve.solver_of`.
Must not import: any other room of the prover.
"""
