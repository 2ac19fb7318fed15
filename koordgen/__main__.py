"""`python -m koordgen` is the `koordgen` command."""

from koordgen.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
