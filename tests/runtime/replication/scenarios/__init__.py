"""Scenarios of the protocol as text scripts, and their runner. See README.md for the commands."""
