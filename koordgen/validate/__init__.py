"""Port assumptions held against simulated platforms: sampled runs, verdicts with their bounds, what could be assumed
instead; and where platforms can get to (docs/validate.md)."""
