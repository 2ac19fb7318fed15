"""Base of all commands.

Owns: exit statuses, error messages, terminal output, options, planning of bundles for commands.
Offers: `console`, `building`, `parser`, `options`.
Must not import: any other package of `cli`.
"""
