"""The log of a web server: tracebacks go to a file, one line an error to stderr."""

import logging
import logging.handlers

from platformdirs import user_log_path

from mirrormount.common.printable import printable

_LOG_MOST = 1 << 20  # bytes of the log; one older file of this size is kept


def log_to_file() -> None:
    """Log to a file, with tracebacks; an error is also one line on stderr."""
    path = user_log_path("mirrormount") / "panel.log"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        to_file = logging.handlers.RotatingFileHandler(path, maxBytes=_LOG_MOST, backupCount=1, encoding="utf-8")
        more = f"more in {path}"
    except OSError:  # no reason not to drive
        to_file = logging.NullHandler()
        more = f"more could not be written to {path}"
    to_file.setFormatter(_Printable("%(asctime)s %(name)s %(levelname)s: %(message)s"))
    to_screen = logging.StreamHandler()
    to_screen.setLevel(logging.ERROR)
    to_screen.setFormatter(_OneLine(more))
    root = logging.getLogger()
    root.handlers[:] = [to_file, to_screen]
    root.setLevel(logging.WARNING)
    for name in ("nicegui", "uvicorn", "uvicorn.error", "uvicorn.access", "asyncio"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
        logger.setLevel(logging.WARNING)


class _Printable(logging.Formatter):
    """Log lines without control characters."""

    def format(self, record: logging.LogRecord) -> str:
        return "\n".join(printable(line, 500) for line in super().format(record).splitlines())


class _OneLine(logging.Formatter):
    """One line for an error; the file has the traceback."""

    def __init__(self, more: str) -> None:
        super().__init__()
        self._more = more

    def format(self, record: logging.LogRecord) -> str:
        return f"mirrormount: {printable(str(record.getMessage()).partition(chr(10))[0])} ({self._more})"
