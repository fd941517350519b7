"""The part of a deploy that runs on the board: deploy/mpremote.py sends this source through mpremote.

Plain MicroPython, which CPython runs, too (in the tests). Paths are relative to the board's root. A power cut may
come after any operation on a file, so files that a boot reads change by renames only: the files are uploaded as
NAME.new, one rename puts the journal in place, and from then on replay() of entry/main.py (sent with this source)
can complete the journal.

Replaced files are copied to a folder first, with a journal that restores them: revert() puts that journal in place
when the new firmware does not answer, forget() removes it when it does.
"""

import binascii
import hashlib
import json
import os

MARK = "@mirrormount "  # begins a line that the host reads
JOURNAL = "mountfw.journal"
MANIFEST = "mountfw/manifest.json"
KEPT = "mountfw.kept"  # the folder of replaced files, until the new firmware has answered
UNDO = KEPT + "/undo"  # the journal that restores them
_IS_FOLDER = 0x4000
_ENOENT = 2


def say(what):
    """Print it for the host; a dict in parts, since a board's memory may have no room for the whole text."""
    for part in parts_of(what) if isinstance(what, dict) else [what]:
        print(MARK + json.dumps(part))


def parts_of(told):
    """The entries of a dict, each as a dict, and of the dicts in it: after a cut upload a board has twice the files."""
    for key in told:
        if told[key] and isinstance(told[key], dict):
            for inner in told[key]:
                yield {key: {inner: told[key][inner]}}
        else:
            yield {key: told[key]}


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
    """The manifest of the last deploy: files, {path: SHA-256}; aside, {path: [name of its copy, SHA-256]}."""
    try:
        with open(MANIFEST) as f:
            told = json.load(f)
        return told["files"], told.get("aside", {})
    except (OSError, ValueError, KeyError):
        return {}, {}


def survey(replay):
    """Complete a deploy that was cut, then return the state of the board: files, sizes, manifest, free space."""
    replay()
    paths = [name for name in os.listdir() if name.startswith("main.py")]
    if exists("mountfw"):
        paths += files_in("mountfw")
    files, aside = read_manifest()
    return {
        "files": {path: hash_of(path) for path in paths},
        "sizes": {path: os.stat(path)[6] for path in paths},
        "manifest": files,
        "aside": aside,
        "kept": exists(KEPT),
        "undo": exists(UNDO),
        "room": room(),
    }


def room():
    """Free bytes, and the size of a block."""
    v = os.statvfs("/")
    return [v[1] * v[4], v[0]]


def make_folders(folders):
    """Make the folders that are absent."""
    for folder in folders:
        if not exists(folder):
            os.mkdir(folder)


def commit(new, backup, journal, replay, keep):
    """Verify uploaded files ({path: SHA-256}; the file is path.new), then put them in place by the journal.

    backup: the name for a copy of main.py, or "". keep: files that the journal replaces or removes; they are copied to
    KEPT/0, KEPT/1 ... Raises ValueError for a damaged file.
    """
    for path in new:
        if hash_of(path + ".new") != new[path]:
            raise ValueError("damaged on the way: " + path)
    forget()
    if backup:
        copy("main.py", backup + ".new")
        os.rename(backup + ".new", backup)
    make_folders((KEPT,))
    for number, path in enumerate(keep):
        copy(path, KEPT + "/" + str(number))
    write_lines(UNDO, undo_lines(new, backup, keep))
    write_lines(JOURNAL, journal)
    replay()


def undo_lines(new, backup, keep):
    """The journal that restores the kept files. main.py last: the old one may not be able to complete a journal.

    Arguments as of commit().
    """
    lines = [path for path in new if path not in keep and path != "main.py"]
    if backup:
        lines.append(backup)
    lines += [KEPT + "/" + str(number) + ">" + path for number, path in enumerate(keep) if path != "main.py"]
    if "main.py" in keep:
        lines.append(KEPT + "/" + str(keep.index("main.py")) + ">main.py")
    elif "main.py" in new:
        lines.append("main.py")
    return lines


def copy(path, to):
    """Copy a file, piece by piece."""
    buffer = bytearray(512)
    view = memoryview(buffer)
    with open(path, "rb") as f, open(to, "wb") as out:
        while True:
            n = f.readinto(buffer)
            if not n:
                break
            out.write(view[:n])


def write_lines(path, lines):
    """Make a file of these lines, completely or not at all."""
    with open(path + ".new", "w") as f:
        f.write("\n".join(lines))
    os.rename(path + ".new", path)


def forget():
    """Remove the kept files of the earlier firmware: their journal first, so that no part of them is ever restored."""
    if exists(KEPT):
        remove(UNDO)
        for path in files_in(KEPT):
            os.remove(path)
        os.rmdir(KEPT)


def revert(replay):
    """Restore the files from before the last deploy. False if none is kept."""
    replay()
    if not exists(UNDO):
        return False
    os.rename(UNDO, JOURNAL)  # from here on a boot completes it, too
    replay()
    forget()
    remove_empty_folders()
    return True


def remove_empty_folders(folder="mountfw"):
    """Remove a folder and those below it, if they are empty."""
    if not exists(folder):
        return
    for name in os.listdir(folder):
        path = folder + "/" + name
        if os.stat(path)[0] & _IS_FOLDER:
            remove_empty_folders(path)
    if not os.listdir(folder):
        os.rmdir(folder)


def clean(paths, replay):
    """Remove the files of a failed upload, and revert it if it was committed."""
    revert(replay)
    for path in paths:
        remove(path + ".new")
    remove(JOURNAL + ".new")
    forget()


def remove(path):
    """Remove a file if it exists."""
    try:
        os.remove(path)
    except OSError as e:
        if e.errno != _ENOENT:
            raise


def undeploy(replay):
    """Remove the files of the manifest, but those that were changed since: main.py first, the manifest last.

    A program that a deploy has put aside gets its name back.
    """
    replay()
    forget()
    removed = []
    kept = []
    restored = []
    manifest, aside = read_manifest()
    for path in sorted(manifest):  # "main.py" is before "mountfw/": from its removal on, nothing of ours boots
        remove(path + ".new")
        if exists(path):
            if hash_of(path) == manifest[path]:
                os.remove(path)
                removed.append(path)
            elif path not in aside or hash_of(path) != aside[path][1]:  # else it was restored before a cut
                kept.append(path)
    for path in aside:
        if exists(aside[path][0]) and not exists(path) and hash_of(aside[path][0]) == aside[path][1]:
            os.rename(aside[path][0], path)
            restored.append(path)
    if manifest:
        for name in os.listdir():
            if name.startswith("mountfw.") and name.endswith(".new"):  # what the firmware saved, cut by a full flash
                remove(name)
        remove(MANIFEST)
    remove_empty_folders()
    return {"removed": removed, "kept": kept, "restored": restored, "found": bool(manifest)}
