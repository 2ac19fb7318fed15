"""Verification of the verifier: independent checks of what the prover says.

Owns the attacks on verdicts. Offers `koordgen.verify.attack`. Judges by the executable semantics alone, so that an
error of the prover's encoding cannot hide itself. Must never import the command line, the emitter, the explorer or a
target.
"""
