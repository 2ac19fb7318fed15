"""Pictures: by matplotlib.

Owns: plots, the view from above, films.
Offers: `plots`, `film`.
Must not import: `foxglove`, `web`.
"""
