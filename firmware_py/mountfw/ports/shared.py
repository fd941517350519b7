"""The ports' common part: the drive pins of a board file, reading a file, the list of the firmware's files.

Names no platform. Imports boards.
"""

from mountfw import const
from mountfw.boards import DRIVES, axes

_MOST_BYTES = const(4096)  # more than any file of ours: another one of that name must not fill the memory
_NO_SUCH_FILE = const(2)  # ENOENT

# the folders in mountfw that an import of ours can find; a test holds them to the tree
FOLDERS = ("boards", "dialect", "encoder", "motion", "ports", "wire")


def drive_pins(board):
    """The pins that drive, of every axis of a board file: the enables first, then the legs."""
    found = axes(board)
    return [pins[name] for name in DRIVES for pins in found if pins[name] is not None]


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
    for folder in ("", "mountfw") + FOLDERS:
        if folder in FOLDERS:
            folder = "mountfw/" + folder
        place = root + "/" + folder if root and folder else root or folder
        try:
            names = sorted(listdir(place))
        except OSError:  # a folder that this platform needs no file of
            continue
        for name in names:
            source = name.endswith(".py") or name.endswith(".mpy")  # noqa: PIE810 (MicroPython before 1.25 takes no tuple)
            if source if folder else name in programs:
                yield (folder + "/" + name if folder else name), (place + "/" + name if place else name)
