"""Port assumptions against simulated platforms: sampled runs, verdicts with their bounds, what could be assumed."""
