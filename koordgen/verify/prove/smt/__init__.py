"""SMT: terms, SMT-LIB text of terms, and solvers.

Owns: many-sorted terms with rational numbers, obligations as data, SMT-LIB 2.6 text, solver processes and their
answers.
Offers: `term`, `smtlib`, `solve.solver_of`.
Must not import: any other package of the prover.
"""
