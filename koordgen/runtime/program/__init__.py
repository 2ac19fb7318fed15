"""Foundation of generated programs, and the execution of one event.

Owns: program descriptions, event transactions, calls of extern functions, three-valued properties, guard skipping.
Offers: `Program`, `Property`, `Runner`.
Must not import: any package but `values` and `config`.
"""
