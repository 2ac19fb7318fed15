"""Many runs of one fleet: what varies between them, who runs them, what came of it. Host only."""
