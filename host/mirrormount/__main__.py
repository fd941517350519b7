"""`python -m mirrormount` is `mirrormount`, whose entry point is here: Ctrl-C while it is imported is no traceback."""

import sys


def run() -> int:
    """Run the command line as a process of its own. Returns the exit status."""
    try:
        import signal

        from mirrormount.common.signals import INTERRUPTS

        INTERRUPTS.note()
        from mirrormount.cli.main import main
    except KeyboardInterrupt:
        print("mirrormount: stopped", file=sys.stderr)
        return 130
    try:
        status = main()
        INTERRUPTS.over = True  # all is in order
    except KeyboardInterrupt:  # one more, before main() could tell of the first
        INTERRUPTS.over = True
        status = 130
    if status != 130 and signal.getsignal(signal.SIGINT) == INTERRUPTS.handle:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # what still keeps Python from its end can be ended
    return status


if __name__ == "__main__":
    sys.exit(run())
