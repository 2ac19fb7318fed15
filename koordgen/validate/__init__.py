"""Port assumptions held against simulated platforms, and where these can get to (docs/validate.md)."""
