"""The log of a run that holds a beam: a folder that a week cannot fill, and a power cut shortens by a second.

about.json             what the run is of: written once
minutes.jsonl          one line a minute (run_minutes.py): kept for ever, some 4 MB a week
events-000001.jsonl …  every event of the loop (events.py), one line each; the newest 64 MB

    with RunLog(Path("run"), {"began": …}) as log:
        hold(table, listen=log)

A thread of its own writes. A disk that hangs or is full delays no correction: events that find no room in the queue
are counted, and `trouble` says why nothing is written.
"""

import contextlib
import json
import os
import queue
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from mirrormount.beam.control.events import Event, to_json
from mirrormount.beam.run_minutes import MINUTE_S, Minute, minute_to_json
from mirrormount.common.errors import CannotWrite

SEGMENT_BYTES = 4_000_000
SEGMENTS = 16  # kept; with the one that is written
SYNC_S = 1.0  # what a power cut may cost
_WAITING_MOST = 20_000  # events in the queue: some minutes of a fast loop
MINUTES, ABOUT, EVENTS = "minutes.jsonl", "about.json", "events-*.jsonl"


class RunLog:
    """Writes events into a new folder. Call it with each; close() writes what is left. Use `with`.

    patient: wait for the disk, for a simulation that is faster than it; otherwise an event waits for nothing.
    lost: events that were not written. Raises CannotWrite if the folder exists or cannot be made.
    """

    def __init__(self, folder: Path, about: Mapping[str, Any], *, patient: bool = False) -> None:
        self.folder = folder
        self.trouble = ""
        self.lost = 0
        self._patient = patient
        self._waiting: queue.Queue[Event | None] = queue.Queue(_WAITING_MOST)
        self._minute: Minute | None = None
        self._segment: IO[bytes] | None = None
        self._number = 0
        self._size = 0
        try:
            folder.mkdir(parents=True)
            (folder / ABOUT).write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
            self._minutes = (folder / MINUTES).open("ab")
        except FileExistsError:
            raise CannotWrite(f"cannot write {folder}: it exists; each run has a folder of its own") from None
        except OSError as e:
            raise CannotWrite(f"cannot write {folder}: {e.strerror}") from e
        self._thread = threading.Thread(target=self._write_all, name="run log", daemon=True)
        self._thread.start()

    def __call__(self, event: Event) -> None:
        """Take an event; returns at once unless patient."""
        try:
            self._waiting.put(event, block=self._patient and not self.trouble)
        except queue.Full:
            self.lost += 1

    def close(self) -> None:
        """Write what waits. Raises CannotWrite if the log is not whole."""
        self._waiting.put(None)
        self._thread.join()
        if self.trouble or self.lost:
            why = self.trouble or "the disk was too slow"
            raise CannotWrite(f"the log {self.folder} is not whole, {self.lost} events are missing: {why}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, _error: object, _trace: TracebackType | None) -> None:
        try:
            self.close()
        except CannotWrite:
            if kind is None:  # a log must not hide the exception that is on its way
                raise

    def _write_all(self) -> None:
        synced_s = time.monotonic()
        try:
            while True:
                left_s = synced_s + SYNC_S - time.monotonic()
                try:
                    event = self._waiting.get(timeout=max(0.0, left_s))
                except queue.Empty:
                    event = None
                else:
                    if event is None:
                        break
                    self._attempt(lambda event=event: self._write(event), counts=True)
                if time.monotonic() - synced_s >= SYNC_S:
                    self._attempt(self._sync)
                    synced_s = time.monotonic()
        finally:
            self._attempt(self._end)
            for file in (self._segment, self._minutes):
                if file:
                    with contextlib.suppress(OSError):  # told before
                        file.close()

    def _attempt(self, work: Callable[[], object], *, counts: bool = False) -> None:
        """Do it unless the disk has failed before; note why it fails."""
        if not self.trouble:
            try:
                work()
                return
            except OSError as e:
                self.trouble = e.strerror or str(e)
        self.lost += counts

    def _write(self, event: Event) -> None:
        if self._minute is None or event.time_s >= self._minute.begin_s + MINUTE_S:
            if self._minute is not None:
                self._minute.end()
            self._end_minute()
            self._minute = Minute.after(self._minute, event.time_s)
        self._minute.add(event)
        line = json.dumps(to_json(event), separators=(",", ":")).encode() + b"\n"
        if self._segment is None or self._size + len(line) > SEGMENT_BYTES:
            self._next_segment()
        assert self._segment
        self._segment.write(line)
        self._size += len(line)

    def _end_minute(self) -> None:
        if self._minute is not None:
            self._minutes.write(json.dumps(minute_to_json(self._minute), separators=(",", ":")).encode() + b"\n")

    def _next_segment(self) -> None:
        if self._segment:
            self._sync()
            self._segment.close()
        self._number += 1
        self._size = 0
        self._segment = (self.folder / f"events-{self._number:06d}.jsonl").open("xb")
        (self.folder / f"events-{self._number - SEGMENTS:06d}.jsonl").unlink(missing_ok=True)

    def _sync(self) -> None:
        for file in (self._segment, self._minutes):
            if file:
                file.flush()
                os.fsync(file.fileno())

    def _end(self) -> None:
        self._end_minute()
        self._sync()
