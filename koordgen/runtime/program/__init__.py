"""Classes that generated programs use, and the execution of one event.

Owns: descriptions of programs, transactions of events, calls of extern functions, three-valued properties.
Offers: `Program`, `Property`, `Runner`.
Must not import: any package but `values` and `config`.
"""
