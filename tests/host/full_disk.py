"""A disk without room, for one command: the system refuses every byte of a file beyond the first so many."""

import subprocess
import sys

from served import HANG_S

_RUN = (
    "import resource, sys; most = int(sys.argv.pop(1)); resource.setrlimit(resource.RLIMIT_FSIZE, (most, most));"
    " from mirrormount.cli.main import main; sys.exit(main())"
)


def run_with_room(most_bytes: int, *words: str) -> subprocess.CompletedProcess:
    """`mirrormount …`, in whose files there is room for so many bytes. Not on Windows."""
    command = [sys.executable, "-c", _RUN, str(most_bytes), *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=HANG_S, stdin=subprocess.DEVNULL)
