"""Limits a board on a MicroPython VM to the files under its root.

install() is called once, by boot/micropython.py, before anything of the board runs. The VM's own modules live on in the
closures below only: MicroPython gives no way into those, and functions' globals, `__main__` or a deleted entry
of sys.modules lead to the stand-ins again. No jail: machine code (viper, a native .mpy) can do
what the process can, so whoever has this prompt must be the user who runs it.
"""

# no such modules on a board, or other ones; and __main__ would be the boot script
_DENIED = ("ffi", "jni", "socket", "ssl", "tls", "termios", "uctypes", "websocket", "btree", "bluetooth", "_thread")
_DENIED += ("__main__", "mip", "requests", "cppexample", "cexample", "_fence")
_HIDDEN = {
    "os": ("system", "getenv", "putenv", "unsetenv", "VfsPosix", "errno"),
    "vfs": ("VfsPosix",),
    "sys": ("executable", "argv", "atexit", "settrace"),
    "io": ("FileIO", "TextIOWrapper"),
    "builtins": ("execfile",),
}


class Delegate:
    """A stand-in for a module: its attributes but for those that are hidden, and some of our own."""

    def __init__(self, module, hidden, changes):
        for name in dir(module):
            if not name.startswith("__") and name not in hidden:
                setattr(self, name, getattr(module, name))
        for name, value in changes.items():
            setattr(self, name, value)


def normal(path, folder):
    """An absolute path under the root, for any path: `..` does not leave it."""
    parts = []
    for part in (path if path.startswith("/") else folder + "/" + path).split("/"):
        if part == "..":
            parts = parts[:-1]
        elif part not in ("", "."):
            parts.append(part)
    return "/" + "/".join(parts)


def file_system(inner, root):
    """A file system that shows the folder root of inner (a VfsPosix) and keeps inner to itself."""
    folder = "/"

    def real(path):
        return root + normal(path, folder)

    class Files:
        def mount(self, _readonly, _mkfs):
            pass

        def umount(self):
            pass

        def open(self, path, mode):
            return inner.open(real(path), mode)

        def chdir(self, path):
            nonlocal folder
            path = normal(path, folder)
            if path != "/" and not inner.stat(root + path)[0] & 0x4000:
                raise OSError(20)
            folder = path

        def getcwd(self):
            return folder

        def ilistdir(self, path):
            return inner.ilistdir(real(path))

        def stat(self, path):
            return inner.stat(real(path))

        def statvfs(self, path):
            return inner.statvfs(real(path))

        def mkdir(self, path):
            return inner.mkdir(real(path))

        def remove(self, path):
            return inner.remove(real(path))

        def rmdir(self, path):
            return inner.rmdir(real(path))

        def rename(self, old, new):
            return inner.rename(real(old), real(new))

    return Files()


def install(root, changes):
    """Mount root (an absolute path) as the file system, and put stand-ins before the VM's modules.

    changes: {module: {name: value}} on top of what the VM has. Fakes that were imported before stay as they are.
    """
    import builtins
    import io
    import os
    import sys

    import vfs

    loaded = sys.modules
    fakes = {name: loaded[name] for name in ("machine", "rp2", "select", "time", "micropython")}
    native_import, native_open = builtins.__import__, builtins.open

    vfs.umount("/")
    inner = vfs.VfsPosix()  # without a root of its own: with one, its rename() mistakes the new path for the old one
    inner.mount(False, False)
    vfs.mount(file_system(inner, root), "/")
    os.chdir("/")

    def guarded_open(file, *args, **kwargs):
        if not isinstance(file, str):  # a number would be a descriptor of the host
            raise TypeError("a file is opened by its name")
        return native_open(file, *args, **kwargs)

    stand_ins = {}

    def guarded_import(name, *args):
        level = args[3] if len(args) > 3 else 0
        if not level:
            top = name.split(".")[0]
            if top[:1] == "u" and (top[1:] in stand_ins or top[1:] in _DENIED):
                top = top[1:]  # an old name of the same module
            if top in _DENIED or (top in stand_ins and "." in name):
                raise ImportError("no module named '%s'" % name)
            if top in stand_ins:
                loaded[name] = stand_ins[top]
                return stand_ins[top]
        return native_import(name, *args)

    for name, module in (("os", os), ("vfs", vfs), ("sys", sys), ("io", io), ("builtins", builtins)):
        stand_ins[name] = Delegate(module, _HIDDEN[name], changes.get(name, {}))
    stand_ins.update(fakes)
    stand_ins["io"].open = stand_ins["builtins"].open = guarded_open
    stand_ins["builtins"].__import__ = guarded_import
    stand_ins["sys"].argv = []
    builtins.print = changes["builtins"]["print"]
    builtins.open = guarded_open
    builtins.__import__ = guarded_import
    for name in list(loaded):
        if name in _DENIED:
            del loaded[name]
    loaded.update(stand_ins)
