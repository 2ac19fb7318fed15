"""Commands that simulate fleets (`sim`, `campaign`, `validate`) or show finished runs (`report`, `export`, `show`).

Owns: the execution of these commands, their output and their exit statuses.
Offers: one module for each group of commands.
Must not import: `cli.operate`.
"""
