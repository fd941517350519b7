"""What the ports share: which files are the firmware. Pure; imports nothing of ours."""

# every folder that an import of ours can find; a test holds them to the tree
FOLDERS = ("mountfw", "mountfw/boards", "mountfw/dialect", "mountfw/motion", "mountfw/ports", "mountfw/wire")


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
