"""`python -m mirrormount` is `mirrormount`, whose entry point is here: Ctrl-C while it is imported is no traceback."""

import sys


def run() -> int:
    """Run the command line as a process of its own. Returns the exit status."""
    try:
        from mirrormount.cli.main import main

        return main()
    except KeyboardInterrupt:
        print("mirrormount: stopped", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(run())
