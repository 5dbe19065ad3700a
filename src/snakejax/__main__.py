"""`python -m snakejax` is `snakejax`."""

from snakejax.commands.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
