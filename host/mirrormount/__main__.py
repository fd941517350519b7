"""`python -m mirrormount` is `mirrormount`."""

import sys

from mirrormount.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
