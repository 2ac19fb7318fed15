"""Web: the report, the live view, the dashboard. Their scripts stand in `page/`.

Owns: one page for all three, its server, its controls and their guard.
Offers: `report`, `live`, `dashboard`.
Must not import: `pictures`.
"""
