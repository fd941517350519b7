"""The part of a deploy that runs on a MicroPython board: micropython.py sends this source through mpremote.

Plain MicroPython, which CPython runs, too (in the tests). Paths are relative to the board's root.

The new firmware is written into a folder of its own and verified there; then the folders are exchanged by renames.
littlefs, the board's file system, does a rename whole or not at all. So the power may go at any moment:

    what is there                 what the board starts
    mountfw, a part of NEW        the old firmware
    OLD, NEW                      the new one: main.py does the second rename
    mountfw, OLD                  the new one; OLD waits, should the new one not answer

main.py is no part of the exchange. It starts mountfw/start.py and knows no more of a firmware, so it starts the old
one and the new one alike, and is replaced by a rename of its own.
"""

import binascii
import hashlib
import json
import os

MARK = "@mirrormount "  # begins a line that the host reads
FOLDER = "mountfw"
NEW = "mountfw.new"
OLD = "mountfw.old"
MANIFEST = "mountfw/manifest.json"
START = "mountfw/start"
NEW_MAIN = "main.py.new"
_IS_FOLDER = 0x4000
_ENOENT = 2


def say(kind, *values):
    """Print one fact for the host."""
    print(MARK + json.dumps((kind,) + values))  # noqa: RUF005 (MicroPython takes no star in a tuple)


def survey():
    """Finish what an earlier deploy has left, then print what is on the board."""
    tidy()
    tell_files([name for name in os.listdir() if name.startswith("main.py")] + files_in(FOLDER))
    files, aside = read_manifest()
    for path in files:
        say("listed", path, files[path])
    for path in aside:
        say("aside", path, aside[path])
    say("room", *room())


def room():
    """Free bytes, and the size of a block."""
    v = os.statvfs("/")
    return v[1] * v[4], v[0]


def tidy():
    """Finish an exchange that was cut, and remove the folders beside the firmware's."""
    if not exists(FOLDER) and exists(OLD) and exists(NEW):
        os.rename(NEW, FOLDER)
    remove_folder(NEW)
    remove_folder(OLD)
    for name in os.listdir():
        if name.startswith("main.py") and name.endswith(".new"):
            os.remove(name)


def prepare(folders, unchanged):
    """Make the folder of the new firmware, with the files of the present one that stay as they are."""
    for folder in folders:
        os.mkdir(NEW + folder[len(FOLDER) :])
    for path in unchanged:
        copy(path, NEW + path[len(FOLDER) :])


def tell_new():
    """Print the hash of each file that exchange() will put in place."""
    tell_files(files_in(NEW) + ([NEW_MAIN] if exists(NEW_MAIN) else []))


def exchange(backup):
    """Put the new firmware in the place of the present one, which is kept as OLD: see above.

    backup: the name for a copy of a main.py of somebody else, or "".
    """
    if backup:
        copy("main.py", backup + ".new")
        os.rename(backup + ".new", backup)
    if exists(NEW_MAIN) and exists("main.py") and exists(FOLDER):
        if not exists(START + ".mpy") and not exists(START + ".py"):
            # 0.2.0 and other programs: main.py itself is the start, so the new main.py shall find it in the folder
            copy("main.py", START + ".py.new")
            os.rename(START + ".py.new", START + ".py")
        os.rename(NEW_MAIN, "main.py")
    if exists(FOLDER):
        os.rename(FOLDER, OLD)
    os.rename(NEW, FOLDER)
    if exists(NEW_MAIN):  # nothing of ours has started so far
        os.rename(NEW_MAIN, "main.py")


def put_back(backup, had_main):
    """Undo exchange(): the new firmware did not answer. had_main: whether there was a main.py before."""
    if not had_main:
        remove("main.py")
    if exists(OLD):
        os.rename(FOLDER, NEW)
        os.rename(OLD, FOLDER)
    if backup:
        os.rename(backup, "main.py")
        if exists(START + ".py") and hash_of(START + ".py") == hash_of("main.py"):
            os.remove(START + ".py")  # of exchange()
    if not exists(NEW):  # it was the first firmware on this board
        os.rename(FOLDER, NEW)
    remove_folder(NEW)


def undeploy():
    """Remove the files of the manifest, but those that were changed since: main.py first, the manifest last.

    A program that a deploy has put aside gets its name back.
    """
    tidy()
    manifest, aside = read_manifest()
    for path in sorted(manifest):  # "main.py" is before "mountfw/": from its removal on, nothing of ours boots
        if exists(path):
            if hash_of(path) == manifest[path]:
                os.remove(path)
                say("removed", path)
            elif path not in aside or hash_of(path) != aside[path][1]:  # else it was restored before a cut
                say("kept", path)
    for path in aside:
        copied, sha = aside[path]
        if exists(copied) and not exists(path) and hash_of(copied) == sha:
            os.rename(copied, path)
            say("restored", path)
    if manifest:
        for name in os.listdir():
            if name.startswith("mountfw.") and name.endswith(".new"):  # what the firmware saved, cut by a full flash
                remove(name)
        remove(MANIFEST)
    remove_empty_folders(FOLDER)
    say("found", bool(manifest))


def read_manifest():
    """The manifest of the last deploy: files, {path: SHA-256}; aside, {path: [name of its copy, SHA-256]}."""
    try:
        with open(MANIFEST) as f:
            told = json.load(f)
        return told["files"], told.get("aside", {})
    except (OSError, ValueError, KeyError):
        return {}, {}


def tell_files(paths):
    """Print the hash and the size of each file."""
    for path in paths:
        say("file", path, hash_of(path), os.stat(path)[6])


def hash_of(path):
    """SHA-256 of a file, as hex."""
    digest = hashlib.sha256()
    if os.stat(path)[6]:
        for piece in pieces_of(path):
            digest.update(piece)
    return binascii.hexlify(digest.digest()).decode()


def copy(path, to):
    """Copy a file."""
    with open(to, "wb") as out:
        for piece in pieces_of(path):
            out.write(piece)


def pieces_of(path):
    """Yield a file's content in the same small buffer: a board's memory has no room for a whole file."""
    buffer = bytearray(512)
    view = memoryview(buffer)
    with open(path, "rb") as f:
        while True:
            n = f.readinto(buffer)
            if not n:
                break
            yield view[:n]


def exists(path):
    """True if there is a file or folder of this name."""
    try:
        os.stat(path)
        return True
    except OSError:
        return False


def files_in(folder):
    """Paths of the files in a folder and below it; empty without such a folder."""
    found = []
    for name in os.listdir(folder) if exists(folder) else ():
        path = folder + "/" + name
        try:
            is_folder = os.stat(path)[0] & _IS_FOLDER
        except OSError:  # a broken entry of the file system
            continue
        if is_folder:
            found += files_in(path)
        else:
            found.append(path)
    return found


def remove(path):
    """Remove a file if it exists."""
    try:
        os.remove(path)
    except OSError as e:
        if e.errno != _ENOENT:
            raise


def remove_folder(folder):
    """Remove a folder with all that is in it, if it exists."""
    for path in files_in(folder):
        os.remove(path)
    remove_empty_folders(folder)


def remove_empty_folders(folder):
    """Remove a folder and those below it, if they are empty."""
    if not exists(folder):
        return
    for name in os.listdir(folder):
        path = folder + "/" + name
        if os.stat(path)[0] & _IS_FOLDER:
            remove_empty_folders(path)
    if not os.listdir(folder):
        os.rmdir(folder)
