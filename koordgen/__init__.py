"""koordgen: an ahead-of-time compiler for Koord, a language for fleets of robots."""

__version__ = "0.1.0"
