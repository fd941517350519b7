"""Panels that are forked from a process which has made their imports: those are most of what a start takes.

A request on the socket is the words after `mirrormount` and the environment, with the panel's stdin, stdout and stderr;
the answer is its process number.
"""

import json
import os
import signal
import socket
import sys

import mirrormount_panel.cli
import mirrormount_panel.server  # noqa: F401, with NiceGUI
from mirrormount.cli.main import main


def run() -> int:
    """Fork a panel for each request until the tests close the socket. In a panel: its exit status."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody asks how they ended
    asked = socket.socket(fileno=int(sys.argv[1]))
    while True:
        request, files, _, _ = socket.recv_fds(asked, 1 << 16, 3)
        if not request:
            return 0
        pid = os.fork()
        if pid == 0:
            asked.close()
            break
        for file in files:
            os.close(file)
        asked.sendall(b"%d\n" % pid)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    sys.stdin, sys.stdout, sys.stderr = os.fdopen(0), os.fdopen(1, "w"), os.fdopen(2, "w", 1)
    words, environment = json.loads(request)
    os.environ.clear()
    os.environ.update(environment)
    return main(words)


if __name__ == "__main__":
    sys.exit(run())
