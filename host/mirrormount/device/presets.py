"""Named positions of a mount (`mount.presets`), and what was before a change: of its settings, of where 0 is.

    mount.presets.keep("good")   # where all axes are, and how certain that is
    mount.presets.back("good")   # go there; refused where the kept numbers may not mean the same place any more

They are kept on this computer, under the board's unique id: another board at the same port has none of them.
"""

import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from mirrormount.device import records
from mirrormount.device.motion_log import JITTER
from mirrormount.device.status import AxisStatus, Status
from mirrormount.errors import BadFile, BadValue, MountError, NotKept, PositionDoubtful
from mirrormount.terminal import printable
from mirrormount.values import NAME_RULE, did_you_mean, is_name

if TYPE_CHECKING:
    from mirrormount.device.axis import Axis
    from mirrormount.device.mount import Mount

FILE = "kept.sqlite"
_SCHEMA = """create table if not exists positions
    (board text, name text, at real, entry text, primary key (board, name));
create table if not exists former (id integer primary key autoincrement, board text, what text, at real, entry text)"""
_MOST_FORMER = 50  # of one kind, of a board
_MOST_POSITIONS = 1000  # of a board

_log = logging.getLogger("mirrormount")


# ---- what was before a change


def remember(board: str, what: str, entry: object) -> bool:
    """Keep what is to be changed, for undo. Where it cannot be kept, that is told, and the change is made all the same.

    what: "settings", or "zero" and the number of an axis. Returns whether it is kept.
    """
    try:
        with records.opened(FILE, _SCHEMA, write=True) as file:
            row = (board, what, time.time(), json.dumps(entry))
            file.execute("insert into former (board, what, at, entry) values (?, ?, ?, ?)", row)
            file.execute(
                "delete from former where board = ? and what = ? and id not in"
                " (select id from former where board = ? and what = ? order by id desc limit ?)",
                (board, what, board, what, _MOST_FORMER),
            )
    except MountError as e:
        _log.warning("what this changes is not kept for an undo, nor known to `mirrormount back`: %s", e)
        return False
    return True


def former(board: str, what: str) -> list[tuple[int, float, Any]]:
    """The number, the time and the content of what was kept of that kind (of all kinds that begin so), newest first."""
    with records.opened(FILE, _SCHEMA) as file:
        rows = file.execute(
            "select id, at, entry from former where board = ? and substr(what, 1, ?) = ? order by id desc",
            (board, len(what), what),
        ).fetchall()
    return [(number, at, _parsed(entry)) for number, at, entry in rows]


def _parsed(entry: str) -> Any:
    try:
        return json.loads(entry)
    except (TypeError, ValueError, RecursionError) as e:
        raise BadFile(f"{records.path(FILE)}: an entry in it is damaged: move the file away") from e


# ---- named positions


@dataclass(frozen=True)
class Place:
    """Where an axis was, in steps, and how certain that was.

    step: length, duty and direction of its steps (XP, XD, XI); zero, homed: the last Zero and the last homing that this
    computer knows of.
    """

    position: float
    certainty: str
    step: list[int]
    zero: int
    homed: int = 0


@dataclass(frozen=True)
class SeenSpot:
    """Where a camera saw the spot: its centroid with standard errors, and the size of the picture, px."""

    camera: str
    x: float
    y: float
    error_x: float
    error_y: float
    width: int
    height: int

    def __str__(self) -> str:
        return (
            f"the spot at ({self.x:.2f} ± {self.error_x:.2f}, {self.y:.2f} ± {self.error_y:.2f}) px"
            f" of {self.width}x{self.height} in {printable(self.camera, 60)}"
        )


@dataclass(frozen=True)
class Preset:
    """A named position. at: when it was kept, seconds since 1970; places: by the number of the axis.

    spot: where a camera saw the spot then, if one was asked.
    """

    name: str
    at: float
    boot_id: int
    places: Mapping[int, Place]
    spot: SeenSpot | None = None

    def __str__(self) -> str:
        return f"{self.name}, kept {_clock(self.at)}"


class Presets:
    """The named positions of an open mount. Methods raise BadFile, CannotWrite, and what Mount.status() raises.

    ask: runs what asks the board, work(mount), and returns its result: for a program in which one thread has the board,
    and must not wait for a disk. Only back() moves, and does not use it.
    """

    def __init__(self, mount: "Mount", ask: "Callable[[Callable[[Mount], Any]], Any] | None" = None) -> None:
        self._mount = mount
        self._ask = ask or (lambda work: work(mount))

    def keep(self, name: str, *, spot: SeenSpot | None = None, seen_at: Mapping[int, float] | None = None) -> Preset:
        """Keep the present position of all axes under a name, new or used. Raises BadValue, also while it moves.

        spot: where a camera sees the spot now (mirrormount_beam.kept.seen()). seen_at: the positions of the axes, by
        number, when it was looked for: a spot that was seen elsewhere is not kept.
        """
        if not isinstance(name, str) or not is_name(name):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise BadValue(f"a position's name is {NAME_RULE}, not {printable(repr(name), 60)}")
        mount = self._mount
        status, steps = self._now()
        if status.moving:
            raise BadValue("the mount moves: a position is kept when it is at rest")
        places = {
            axis.number: self._place(axis, status.by_name[axis.name], steps[axis.number])
            for axis in mount.by_name.values()
        }
        if seen_at is not None and any(_apart(seen_at.get(n), place) for n, place in places.items()):
            spot = None
        preset = Preset(name, time.time(), status.boot_id, places, spot)
        entry = json.dumps(
            {
                "boot_id": status.boot_id,
                "places": {n: asdict(place) for n, place in places.items()},
                "spot": spot and asdict(spot),
            }
        )
        with records.opened(FILE, _SCHEMA, write=True) as file:
            (others,) = file.execute(
                "select count(*) from positions where board = ? and name != ?", (mount.board_id, name)
            ).fetchone()
            if others >= _MOST_POSITIONS:
                raise BadValue(f"{others} positions are kept of this board: remove one first (keep NAME --remove)")
            file.execute("replace into positions values (?, ?, ?, ?)", (mount.board_id, name, preset.at, entry))
        return preset

    def all(self) -> list[Preset]:
        """All of this board, the last one that was kept at the end."""
        with records.opened(FILE, _SCHEMA) as file:
            question = "select name, at, entry from positions where board = ? order by at"
            rows = file.execute(question, (self._mount.board_id,)).fetchall()
        try:
            return [
                Preset(
                    name,
                    at,
                    entry["boot_id"],
                    {int(n): Place(**place) for n, place in entry["places"].items()},
                    SeenSpot(**entry["spot"]) if entry.get("spot") else None,
                )
                for name, at, entry in ((name, at, _parsed(entry)) for name, at, entry in rows)
            ]
        except (KeyError, TypeError, ValueError, AttributeError) as e:
            raise BadFile(f"{records.path(FILE)}: a position in it is damaged: move the file away") from e

    def get(self, name: str | None = None) -> Preset:
        """The position of that name; None: the last one that was kept. Raises NotKept."""
        kept = self.all()
        for preset in reversed(kept):
            if name in (None, preset.name):
                return preset
        with records.opened(FILE, _SCHEMA) as file:
            others = file.execute("select distinct board from positions where name = ?", (name,)).fetchall()
        there = ", ".join(preset.name for preset in kept) or "none"
        raise NotKept(
            f"no position {'' if name is None else printable(name, 40) + ' '}is kept of this board"
            f" ({self._mount.board_id}; kept: {there})"
            + "".join(f"; the board {printable(board)} has one of that name" for (board,) in others[:1])
            + did_you_mean(name or "", (preset.name for preset in kept))
        )

    def remove(self, name: str) -> None:
        """Forget a position. Raises NotKept."""
        self.get(name)
        with records.opened(FILE, _SCHEMA, write=True) as file:
            file.execute("delete from positions where board = ? and name = ?", (self._mount.board_id, name))

    def doubts(self, preset: Preset) -> list[str]:
        """Why its numbers may not mean the same place any more; [] if nothing is known that speaks against them.

        What another computer has set on the board meanwhile is not known.
        """
        status, steps = self._now()
        board, found = self._mount.board_id, list[str]()
        for axis, then in self.axes(preset):
            now = self._place(axis, status.by_name[axis.name], steps[axis.number])
            undone = any(
                at > preset.at and boot_id == status.boot_id
                for _, at, boot_id in former(board, f"undone {axis.number}")
            )
            if why := _doubt(then, now, status.boot_id != preset.boot_id, undone):
                found.append(f"{axis.name}: {why}")
        return found

    def back(
        self,
        name: str | None = None,
        *,
        sure: bool = False,
        progress: Callable[[AxisStatus], None] | None = None,
    ) -> Preset:
        """Go back to a position, one axis after the other; None: to the last one that was kept.

        sure: also where there are doubts. Raises NotKept, PositionDoubtful, and what Axis.move_to() raises.
        """
        with self._mount.unless_stopped():
            preset = self.get(name)
            if not sure and (doubts := self.doubts(preset)):
                raise PositionDoubtful(f"nothing was moved to {preset.name}: {'; '.join(doubts)}")
            for axis, place in self.axes(preset):
                if axis.position != place.position:
                    axis.move_to(place.position, progress=progress)
        return preset

    def undo_zero(self, axis: str | None = None, *, sure: bool = False) -> str:
        """Give the last axis that was zeroed, or this one, its coordinates from before. Nothing moves.

        The board takes whole steps. sure: also where the Zero may not be in force any more. Returns what was done, in
        words. Raises NotKept, PositionDoubtful, BoardError (n14: it moves).
        """
        mount = self._mount
        kind = f"zero {mount.axis(axis).number}" if axis else "zero "
        axes = {each.number: each for each in mount.axes}
        zeros = [(number, at, entry) for number, at, entry in former(mount.board_id, kind) if entry["axis"] in axes]
        if not zeros:
            raise NotKept(f"no Zero {f'of {axis} ' if axis else ''}is known on this computer that could be undone")
        number, at, entry = zeros[0]
        zeroed = axes[entry["axis"]]
        status, _ = self._now()
        now, name = status.by_name[zeroed.name], zeroed.name
        homed = now.certainty == "homed" or _latest(mount.board_id, f"homed {zeroed.number}") > number
        if not sure and (homed or now.certainty == "unknown" or status.boot_id != entry["boot_id"]):
            why = "it was homed since" if homed else "the board has restarted since"
            raise PositionDoubtful(f"{name}: {why}, so its 0 may not be that Zero's any more")

        def put_back(mount: "Mount") -> float:
            wanted = mount.status().by_name[name].position + entry["from"] - entry["to"]
            mount.axis(name).define(round(wanted))
            return wanted

        with records.opened(FILE, _SCHEMA, write=True) as file:  # both are done, or none
            file.execute("delete from former where id = ?", (number,))
            row = (mount.board_id, f"undone {zeroed.number}", time.time(), json.dumps(status.boot_id))
            undone = file.execute("insert into former (board, what, at, entry) values (?, ?, ?, ?)", row).lastrowid
            wanted = float(self._ask(put_back))
            if wanted != round(wanted):  # what was kept is not exactly that place any more
                file.execute("delete from former where id = ?", (undone,))
        rounded = "" if wanted == round(wanted) else f", the whole step next to {wanted:+.3f}"
        return (
            f"{name}: the position here is {round(wanted):+d} steps as before Zero of {_clock(at)}{rounded}; nothing"
            " has moved"
            f" (certainty before: {entry['certainty']}; the board calls it counted)"
        )

    def zeroed(self) -> list[str]:
        """The axes that have a Zero which undo_zero() would take back."""
        return [axis.name for axis in self._mount.axes if _latest(self._mount.board_id, f"zero {axis.number}")]

    def axes(self, preset: Preset) -> "Sequence[tuple[Axis, Place]]":
        """The axes of a position, in the order in which back() moves them, and where each was. Raises NotKept."""
        axes = {axis.number: axis for axis in self._mount.axes}
        if missing := preset.places.keys() - axes.keys():
            raise NotKept(f"{preset.name} has an axis {min(missing)}, which this board has not")
        return [(axes[number], place) for number, place in preset.places.items()]

    def _now(self) -> tuple[Status, dict[int, list[int]]]:
        """The status, and length, duty and direction of a step of each axis (by its number)."""

        def read(mount: "Mount") -> tuple[Status, dict[int, list[int]]]:
            return mount.status(), {axis.number: axis.ask_whole("XP?", "XD?", "XI?") for axis in mount.axes}

        return self._ask(read)

    def _place(self, axis: "Axis", status: AxisStatus, step: list[int]) -> Place:
        zero, homed = (_latest(self._mount.board_id, f"{what} {axis.number}") for what in ("zero", "homed"))
        return Place(status.position, status.certainty, step, zero, homed)


def _clock(at: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(at))


def _apart(before: float | None, now: Place) -> bool:
    """Is a position another one than before? An encoder's changes a little at rest, too."""
    return before is None or abs(now.position - before) >= (JITTER if now.certainty == "measured" else 0.001)


def _latest(board: str, what: str) -> int:
    """The number of the last entry of that kind; 0: there is none."""
    return next((number for number, _, _ in former(board, what)), 0)


def _doubt(then: Place, now: Place, restarted: bool, undone: bool) -> str:
    """Why a position may not be the same place any more; "" for no reason that is known.

    undone: a Zero was undone since, and the board calls the position counted from then on, whatever it was before.
    """
    if then.zero < now.zero:
        return "its 0 was set since (Zero), which `mirrormount undo` takes back"
    if then.zero > now.zero:
        return "the Zero from which it was counted was undone since"
    if restarted and now.certainty == "unknown":
        return "the board has restarted since, and does not know where it is"
    if then.certainty != "homed" and (then.homed != now.homed or now.certainty == "homed"):
        return "it was homed since, and was not when the position was kept: its 0 is another one"
    if now.certainty == "counted" and then.certainty in ("homed", "unknown") and not undone:
        return f"its 0 was {then.certainty} when the position was kept, and was set since"
    if then.step != now.step:
        return f"its steps were others (pulse, duty, direction {then.step}, now {now.step})"
    if restarted and not then.certainty == now.certainty == "homed":
        return "the board has restarted since; it has kept its position, but not whether its 0 was set meanwhile"
    return ""
