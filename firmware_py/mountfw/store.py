"""What outlives a power cut: settings, when told to, and positions, by themselves. Imports codes, settings, ticks.

Both are small text files with a checksum in their last line. A file is replaced in two steps, each of
which the file system does whole or not at all: a new one is written beside it, and renamed.

A recorded position is true only until something drives. So the record goes before the first drive after it,
and comes back when all has rested for a while: after a power cut in a motion there is none, and
the position is unknown. That bounds the flash's wear, too: not more than one record in ten seconds.
"""

from mountfw import codes, const
from mountfw.settings import FILE, MAX_STEPS, allowed, entries_of, named, saved_line, seal, unseal
from mountfw.wire.ticks import diff

_RENAMED = {"move_limit_ms": "search_limit_ms"}  # what an older firmware has saved

_STEPS = " units 0"  # a setting of an older firmware: moves are told in steps. They always are now

_POSITION = "mountfw.position"
_NEW = ".new"
_REST_US = const(10_000_000)  # how long all must have rested before the position is recorded

# what record() has to do next
_NOTHING = const(0)
_WAIT = const(1)
_WRITE = const(2)
_RENAME = const(3)


def position_line(axis):
    """The line of an axis in the record of the positions."""
    p = axis.position
    certainty = codes.COUNTED if p.certainty == codes.MEASURED else p.certainty  # while it is off, nobody measures
    line = "%d %d %d %d %d %d %d %d %d %d %d %d" % (
        (axis.number, axis.inverted, p.step, p.gap, p.gap_known, p.inside)
        + (p.millisteps, certainty, p.target, p.defined, p.home_known, p.home)
    )
    return line + (" %d %d %d\n" % p.recorded() if hasattr(axis, "restored") else "\n")


def restore_position(axis, numbers):
    """Set an axis's position to the numbers of such a line, unless a step is another now. Raises ValueError."""
    _, inverted, step, gap, gap_known, inside, millisteps, certainty, target, defined, home_known, home = numbers[:12]
    if not (codes.UNKNOWN <= certainty <= codes.ESTIMATED and 0 <= inside <= gap):
        raise ValueError
    for n in numbers:
        if not -(1 << 30) <= n < 1 << 30:
            raise ValueError
    if not (-MAX_STEPS <= target <= MAX_STEPS and -MAX_STEPS <= defined <= MAX_STEPS):
        raise ValueError
    p = axis.position
    if step != p.step or inverted != axis.inverted:
        return
    p.millisteps = millisteps
    p.certainty = certainty
    p.target = target
    p.defined = defined
    p.home_known = home_known != 0
    p.home = home
    if gap == p.gap:
        p.gap_known = gap_known != 0
        p.inside = inside
    if hasattr(axis, "restored"):  # it has an encoder
        axis.restored(numbers[12:])


class Records:
    """Both files of a mount. port has load(name), store(name, data), rename(old, new), remove(name) and collect().

    load gives bytes, none if the file cannot be read, or None if there is no such file; the others raise OSError
    if they cannot.
    check_stop is called after what takes long: a stop must not wait for it. The loop sets it.
    """

    def __init__(self, port, axes, error_queue):
        self._port = port
        self._axes = axes
        self._errors = error_queue
        self.check_stop = bool  # nothing
        self.waiting = False  # may a record be due?
        self._tidy = False
        self._next = _NOTHING
        self._rested_at = 0  # since when nothing moves
        self._on_flash = False  # may there be a record of the positions?
        for axis in axes:
            axis.drive.drop_record = self.drop_record

    # ---- settings

    def save(self, stage):
        """Save the settings: what is done in one pass, one file operation, so that the watchdog is fed between two.

        Stage 0 is the first. Returns the next stage; 0 when it is over (an error says if it could not be done).
        """
        if stage == 0:
            return 1 if self.drop_record() else 0
        if stage == 1:
            lines = [
                saved_line(a.number, entry[1], getattr(a, entry[1])) for a in self._axes for entry in entries_of(a)
            ]
            return 2 if self._try(self._port.store, FILE + _NEW, seal("".join(lines))) else 0
        self._try(self._port.rename, FILE + _NEW, FILE)
        self._port.collect()
        return 0

    def recall(self):
        """Take the saved settings into use; those as made if none were saved, or (error 63) if they are damaged.

        Those that no axis has are left out (error 69).
        """
        data = self._port.load(FILE)
        values = [] if data is None else self._parsed(data)
        if values is None:
            self._errors.push(codes.SETTINGS_DAMAGED)
            values = []
        for axis in self._axes:
            axis.load([(name, value) for number, name, value in values if number == axis.number])
        if data is not None:
            self._port.collect()

    def factory(self):
        """Take the settings into use as they were made."""
        for axis in self._axes:
            axis.load(())

    def _parsed(self, data):
        lines = unseal(data)
        if lines is None:
            return None
        lines = [line for line in lines if not line.endswith(_STEPS)]
        values = []
        for line in lines:
            try:
                number, name, value = line.split(" ")
                number, name, value = int(number), _RENAMED.get(name, name), int(value)
            except ValueError:
                return None
            if number < 1:
                return None
            axis = self._axes[number - 1] if number <= len(self._axes) else None
            entry = axis and named(name, entries_of(axis))
            if axis is None or entry is None:
                continue
            # an older firmware allowed a step more
            if name and name.startswith("soft_") and abs(value) == MAX_STEPS + 1:
                value = MAX_STEPS if value > 0 else -MAX_STEPS
            if not allowed(entry, value) or not axis.has_parts_for(name, value):
                return None
            values.append((number, name, value))
        if len(values) < len(lines):
            self._errors.push(codes.SETTINGS_LEFT_OUT)
        return values

    # ---- positions

    def restore(self):
        """Know the positions again, if they were recorded and nothing has driven since."""
        for axis in self._axes:
            axis.drive.on_flash = True
        self.waiting = False
        data = self._port.load(_POSITION)
        self._on_flash = data is not None
        if data is None:  # so nothing is to come off the flash before the first drive
            for axis in self._axes:
                axis.drive.on_flash = False
                if hasattr(axis, "restored"):
                    axis.restored(None)
            self.waiting = True
            self._next = _NOTHING
            self._rested_at = 0
            return
        try:
            lines = unseal(data)
            if lines is None or not 2 <= len(lines) <= len(self._axes):
                raise ValueError
            for axis, line in zip(self._axes, lines):  # an axis that is new in the board file stays unknown
                restore_position(axis, [int(word) for word in line.split(" ")])
        except ValueError:
            for axis in self._axes:
                axis.position.reset()
            self._errors.push(codes.SETTINGS_DAMAGED)

    def drop_record(self):
        """The positions are to change: take them off the flash. False if that could not be done."""
        if self._on_flash and not self._remove():
            return False
        for axis in self._axes:
            axis.drive.on_flash = False
        self.waiting = True
        self._next = _WAIT
        self._rested_at = None
        self.check_stop()
        return True

    def rest(self, now_us):
        """Nothing moves, nothing waits to be said, no message is half received: what takes long. True: it did."""
        if not self._tidy:  # what the start has left: 20 ms, so after the first answer
            self._tidy = True
            self._port.collect()
        if not self.waiting:
            return False
        rests = self._rested_at is not None
        for axis in self._axes:
            if axis.has_moved:
                axis.has_moved = rests = False
        if not rests:
            self._rested_at = now_us
            self._next = _WAIT
        elif self._next == _WAIT and diff(now_us, self._rested_at) >= _REST_US:
            self._next = _WRITE
        if self._next > _WAIT:  # at _NOTHING no record was there at the start, and nothing has moved since
            self._record()
            return True  # the watchdog is fed before the loop sleeps
        return False

    def _record(self):
        """One file operation."""
        if self._next == _WRITE:
            self.waiting = False  # if this fails it is not tried again before something has moved
            for axis in self._axes:
                axis.drive.on_flash = True  # from here on all that moves or counts anew comes to drop_record() first
            lines = [position_line(a) for a in self._axes]
            if self._try(self._port.store, _POSITION + _NEW, seal("".join(lines))):
                self._next = _RENAME
                self.waiting = True
        else:
            self.waiting = False
            self._on_flash = True  # before it is: a Ctrl-C may come right after the renaming
            self._try(self._port.rename, _POSITION + _NEW, _POSITION)
            self._port.collect()  # file work leaves something behind; now nothing waits

    def _remove(self):
        """Take the record off the flash. False if it is still there."""
        try:
            self._port.remove(_POSITION)
        except OSError:
            if self._port.load(_POSITION) is not None:
                self._errors.push(codes.NOT_SAVED)
                return False
        self._on_flash = False
        return True

    def _try(self, action, *arguments):
        try:
            action(*arguments)
        except OSError:
            self._errors.push(codes.NOT_SAVED)
            return False
        return True
