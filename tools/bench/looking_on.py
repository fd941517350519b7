"""Pages without a browser, for hold_hour.py: processes that ask a hold's page for state and pictures, as a page does.

    .venv/bin/python -P tools/bench/looking_on.py PORT NAME

is one of them.
"""

import contextlib
import http.client
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

EVERY_S = {"/hold/state": 0.25, "/camera/1": 0.08, "/camera/2": 0.08}  # between two questions of a page


def look_on(port: int, name: str) -> None:
    """One page, without a browser, until its standard input ends.

    Prints a line once each of its questions was answered, and at its end what it got.
    """
    got = {"states": 0, "pictures": 0, "bytes": 0, "failures": 0, "slowest_s": 0.0}
    ended = threading.Event()
    answered = {path: threading.Event() for path in EVERY_S}

    def ask(path: str, every_s: float) -> None:
        after = "0"
        server = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        while not ended.is_set():
            begin_s = time.monotonic()
            try:
                server.request("GET", f"{path}?after={after}", headers={"X-Page": name})
                answer = server.getresponse()
                body = answer.read()
            except OSError:
                got["failures"] += not ended.is_set()
                server.close()
                ended.wait(1)
                continue
            answered[path].set()
            got["slowest_s"] = max(got["slowest_s"], time.monotonic() - begin_s)
            got["bytes"] += len(body)
            if answer.status == 200 and path == "/hold/state":
                got["states"] += 1
                history = json.loads(body)["history"]
                after = f"{history[-1]['t']:.2f}" if history else after
            elif answer.status == 200:
                got["pictures"] += 1
                after = str(json.loads(answer.headers["X-Seen"])["n"])
            ended.wait(max(0.0, every_s - (time.monotonic() - begin_s)))

    threads = [threading.Thread(target=ask, args=arguments, daemon=True) for arguments in EVERY_S.items()]
    for thread in threads:
        thread.start()
    for answer in answered.values():
        answer.wait()
    print("begun", flush=True)
    sys.stdin.read()
    ended.set()
    print(json.dumps(got))


@contextlib.contextmanager
def lookers(port: int, found: list[dict[str, float]]) -> Iterator[None]:
    """Two processes that look on, from when both have had answers; what they got is put into found."""
    command = [sys.executable, "-P", __file__, str(port)]
    running = [
        subprocess.Popen([*command, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for name in ("first", "second")
    ]
    try:
        for process in running:
            assert process.stdout
            process.stdout.readline()
        yield
    finally:
        for process in running:
            out, _ = process.communicate("")
            found.append(json.loads(out))


if __name__ == "__main__":
    look_on(int(sys.argv[1]), sys.argv[2])
