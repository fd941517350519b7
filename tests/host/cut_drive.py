"""A folder as a CircuitPython board's drive, whose power goes at a chosen operation on a file."""

from pathlib import Path

from cut_board import PowerCut

from mirrormount.deploy.circuitpython import Files, drive_plan, install, survey
from mirrormount.terminal import Progress


class CutFiles(Files):
    """The power goes at operation number `last`; a write is two of them, its half and its whole."""

    def __init__(self, root: Path, last: int | None = None) -> None:
        super().__init__(root)
        self.count, self.last = 0, last

    def operation(self) -> None:
        self.count += 1
        if self.count == self.last:
            raise PowerCut

    def write(self, path: str, content: bytes) -> None:
        self.operation()
        (self.root / path).write_bytes(content[: len(content) // 2])
        self.operation()
        (self.root / path).write_bytes(content)

    def rename(self, path: str, to: str) -> None:
        self.operation()
        (self.root / path).replace(self.root / to)

    def remove(self, path: str) -> None:
        self.operation()
        super().remove(path)

    def make_folder(self, path: str) -> None:
        self.operation()
        super().make_folder(path)

    def sync(self) -> None:
        pass


def put(files: Files, wanted: dict[str, bytes]) -> None:
    """A deploy that may replace what it likes."""
    there, _, old = survey(files)
    todo = drive_plan(wanted, there, old, lambda _aside: True)
    if not todo.nothing:
        install(files, todo, Progress())
