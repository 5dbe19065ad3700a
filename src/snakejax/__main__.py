"""`python -m snakejax` is `snakejax`."""

from ._cli import main

if __name__ == "__main__":
    raise SystemExit(main())
