"""The part of a deploy that runs on the board: deploy.py sends this text through mpremote.

Plain MicroPython that CPython runs, too (the tests do). Paths are relative to the board's root. A
power cut may come after any single operation on a file, so nothing that a boot looks at changes
but by a rename: first the files arrive as NAME.new, then one rename puts the journal in place, and
from there on replay() of entry/main.py (sent along with this text) can finish what the journal says.
"""

import binascii
import hashlib
import json
import os

MARK = "@mirrormount "  # begins the one line that the host reads
JOURNAL = "mountfw.journal"
MANIFEST = "mountfw/manifest.json"
_IS_FOLDER = 0x4000
_ENOENT = 2


def say(what):
    """Tell the host."""
    print(MARK + json.dumps(what))


def hash_of(path):
    """SHA-256 of a file, as hex."""
    digest = hashlib.sha256()
    if os.stat(path)[6]:
        buffer = bytearray(512)
        view = memoryview(buffer)
        with open(path, "rb") as f:
            while True:
                n = f.readinto(buffer)
                if not n:
                    break
                digest.update(view[:n])
    return binascii.hexlify(digest.digest()).decode()


def exists(path):
    """True if there is a file or folder of this name."""
    try:
        os.stat(path)
        return True
    except OSError:
        return False


def files_in(folder):
    """Paths of the files in a folder and below it."""
    found = []
    for name in os.listdir(folder):
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


def read_manifest():
    """{path: SHA-256} of what a deploy has put here."""
    try:
        with open(MANIFEST) as f:
            return json.load(f)["files"]
    except (OSError, ValueError, KeyError):
        return {}


def survey(replay):
    """Finish a deploy that was cut, then tell what is here."""
    replay()
    paths = [name for name in os.listdir() if name.startswith("main.py")]
    if exists("mountfw"):
        paths += files_in("mountfw")
    return {"files": {path: hash_of(path) for path in paths}, "manifest": read_manifest(), "room": room()}


def room():
    """Bytes that are free for files, and the size of a block."""
    v = os.statvfs("/")
    return [v[1] * v[4], v[0]]


def make_folders(folders):
    """Make those that are not there."""
    for folder in folders:
        if not exists(folder):
            os.mkdir(folder)


def commit(new, backup, journal, replay):
    """Verify what was uploaded ({path: SHA-256}; the file is path.new), then let the journal put it in place.

    backup: the name for a copy of main.py, or "". Raises ValueError for a file that did not arrive well.
    """
    for path in new:
        if hash_of(path + ".new") != new[path]:
            raise ValueError("damaged on the way: " + path)
    if backup:
        with open("main.py", "rb") as f:
            program = f.read()
        with open(backup + ".new", "wb") as f:
            f.write(program)
        os.rename(backup + ".new", backup)
    with open(JOURNAL + ".new", "w") as f:
        f.write("\n".join(journal))
    os.rename(JOURNAL + ".new", JOURNAL)
    replay()


def clean(paths):
    """Remove what an upload that failed has left. True if nothing had been committed."""
    for path in paths:
        remove(path + ".new")
    remove(JOURNAL + ".new")
    return not exists(JOURNAL)


def remove(path):
    """Remove a file, if it is there."""
    try:
        os.remove(path)
    except OSError as e:
        if e.errno != _ENOENT:
            raise


def undeploy(replay):
    """Remove what the manifest says, unless somebody has changed it since: main.py first, the manifest last."""
    replay()
    removed = []
    kept = []
    manifest = read_manifest()
    for path in sorted(manifest):  # "main.py" is before "mountfw/": from its removal on, nothing of ours boots
        remove(path + ".new")
        if exists(path):
            if hash_of(path) == manifest[path]:
                os.remove(path)
                removed.append(path)
            else:
                kept.append(path)
    if manifest:
        remove(MANIFEST)
    for folder in ("mountfw/boards", "mountfw"):
        if exists(folder) and not os.listdir(folder):
            os.rmdir(folder)
    return {"removed": removed, "kept": kept, "found": bool(manifest)}
