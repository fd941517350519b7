"""The ports' common part: the board file, its drive pins, reading a file, the list of the firmware's files.

Names no platform. Imports boards, and board_file at the start only.
"""

import sys

from mountfw import const
from mountfw.boards import DRIVES, axes

_ONLY_AT_START = {"mountfw": ("build", "presize", "board_file"), "mountfw.ports": ("rp2_listed",)}

_MOST_BYTES = const(4096)  # more than any file of ours: another one of that name must not fill the memory
_NO_SUCH_FILE = const(2)  # ENOENT

# every folder that an import of ours can find; a test holds them to the tree
FOLDERS = ("mountfw",) + tuple(["mountfw/" + f for f in ("boards", "dialect", "encoder", "motion", "ports", "wire")])


def find_board(title, name, listdir, rp2):
    """The board file: boards/this.py if there is one, else that of the board `name`, shown to users as title.

    None, after a printed line, if there is none or it cannot be used. listdir is os.listdir; rp2 as in
    board_file.find().
    """
    from mountfw import board_file

    name = board_file.FILE_OF.get(name, name)
    board = board_file.find(("this", name), listdir, rp2)
    if board is False:
        print("mountfw: no board file for '%s': write mountfw/boards/%s.py (copy pico.py)" % (title, name))
    return board or None


def forget_start():
    """Give the memory back of modules that only a start needs: 12 KB. Who imports one again has a new one."""
    for package, names in _ONLY_AT_START.items():
        for name in names:
            for module in (package + "." + name, name):  # main.py finds one without its package
                if module in sys.modules:
                    _drop(sys.modules, module)
            if hasattr(sys.modules[package], name):
                _drop(sys.modules[package].__dict__, name)


def _drop(table, key):
    table[key] = None  # MicroPython keeps the value of a key that is only deleted
    del table[key]


def led_of(board, radio):
    """The LED of a board file, or None. With a radio chip "LED" is the chip's, too slow to switch in the loop."""
    return None if radio and board.LED == "LED" else board.LED


def drive_pins(board):
    """The pins that drive, of every axis of a board file: the enables first, then the legs."""
    found = axes(board)
    return [pins[name] for name in DRIVES for pins in found if pins[name] is not None]


def gate_pins(board):
    """The pins of each axis of a board file that are low while it has no drive: those that carry its duty."""
    from mountfw.board_file import BRIDGES

    return [tuple([pins[name] for name in BRIDGES[board.BRIDGE][1]]) for pins in axes(board)]


def read_file(path):
    """The first 4096 bytes of a file, b"" if it cannot be read, None if it is absent."""
    try:
        with open(path, "rb") as f:
            return f.read(_MOST_BYTES)
    except OSError as e:
        return None if e.errno == _NO_SUCH_FILE else b""


def firmware_files(listdir, here, programs):
    """Yield (name from the root on, path) of each file that XF? counts, folder by folder, sorted by name.

    here is the __file__ of a file in mountfw/ports; programs: the files of the root that count. In our folders every
    .py and .mpy counts, so that a stray one shows.
    """
    root = here
    for _ in range(3):
        root = root.rpartition("/")[0]
    for folder in ("",) + FOLDERS:
        place = root + "/" + folder if root and folder else root or folder
        try:
            names = sorted(listdir(place))
        except OSError:  # a folder that this platform needs no file of
            continue
        for name in names:
            source = name.endswith(".py") or name.endswith(".mpy")  # noqa: PIE810 (MicroPython before 1.25 takes no tuple)
            if source if folder else name in programs:
                yield (folder + "/" + name if folder else name), (place + "/" + name if place else name)
