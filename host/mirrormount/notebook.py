"""`show(mount)`: a mount in a notebook. Positions, steps, the camera's picture, and a STOP that no cell delays.

    from mirrormount.notebook import show
    show(mount, camera)  # the last line of a cell; camera: a SpotCamera, or none

It is a page that threads of this process serve on 127.0.0.1, in a frame of the cell's output: what Jupyter's own
widgets send waits for the end of the running cell. So it needs a browser on the kernel's computer; elsewhere the
frame stays empty, and the line below it says how to stop. The page's address holds a secret.

- STOP switches the motors of all shown mounts off and interrupts the running cell, so that no next line moves any.
- What is shown is the last known status: the page asks no board, so it keeps no motion alive. It does not keep the
  mount open either: a mount that is closed, or that nobody refers to any more, ends it.
- A step and a look at the camera are of the page only while no cell runs; a cell that begins meanwhile waits for them.
  One that comes late, from a browser that hung, is not made.
"""

import _thread
import contextlib
import hmac
import json
import secrets
import signal
import socketserver
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any, Protocol

from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, ConnectionLost, MountError, NotInControl
from mirrormount.markup import html_text

_LATE_MS = 1500  # a press is not carried out if the page that it came from had heard of nothing newer
_OTHERS_S = 10.0  # a cell that begins waits no longer for a step of the page
_MOST_BYTES = 1000  # of a request
_HEIGHT_PX, _HEIGHT_WITH_PICTURE_PX = 210, 560
_CLOSED = "this mount was closed: open it again, and show it in another cell"
_CELL = "nothing was done: a cell is running, and steps are its own; or another step is under way"
_REFUSED = "this cell was not run: STOP came before its first line; run it again"
_LATE = "nothing was done: that came late, this browser was stuck; ask again"
_LOCKSTEP = "nothing was done: the time of this virtual board passes only in cells; open it without speed=max"


class PictureSource(Protocol):
    """What show() needs of a SpotCamera. last: the image that was looked at, and what was in it."""

    @property
    def last(self) -> tuple[Any, object] | None: ...

    def spot(self) -> object: ...

    def png(self) -> bytes | None: ...


def show(mount: Mount, camera: PictureSource | None = None) -> "MountView":
    """Show a mount in the output of a cell. Outside of a notebook, open the view's `url` in a browser: it can stop."""
    return MountView(mount, camera)


class Cells:
    """Whose turn it is: the running cell's, or the page's. Where no IPython runs, it is always the program's."""

    def __init__(self) -> None:
        self._turn = threading.Lock()  # held while the page moves something
        self._depth = 1  # of cells, with the one that runs now: %%capture runs one in another one
        self._stopped = False  # a STOP came in this cell
        shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
        self._is_notebook = shell is not None
        if shell:
            shell.events.register("pre_run_cell", self._begin)
            shell.events.register("post_run_cell", self._end)
            shell.ast_transformers.append(self)

    def _begin(self, *_: object) -> None:
        self._depth += 1

    def visit(self, node: Any) -> Any:
        """IPython calls this after _begin, with the code that it is about to run: wait for the page's step or look.

        _begin must not wait: IPython prints a KeyboardInterrupt that comes there, and runs the cell all the same. Here
        one ends the cell. A STOP whose interrupt got lost on the way, or is only for the cell's next `await`, is known
        from _stopped. The lock is not taken, for an interrupt that came with it would leave it locked.
        """
        end = time.monotonic() + _OTHERS_S
        while self._turn.locked() and time.monotonic() < end:
            time.sleep(0.01)
        if self._stopped:
            raise sys.modules["IPython.core.error"].InputRejected(_REFUSED)
        return node

    def _end(self, *_: object) -> None:
        self._depth = max(0, self._depth - 1)
        if not self._depth:
            self._stopped = False

    @property
    def free(self) -> bool:
        """True while neither a cell runs nor the page moves anything."""
        return not self._depth and not self._turn.locked()

    @contextlib.contextmanager
    def turn_of_page(self) -> Iterator[None]:
        """Inside, a cell that begins waits. Raises NotInControl at once if one runs, or the page moves something."""
        if not self._turn.acquire(blocking=False):
            raise NotInControl(_CELL)
        try:
            if self._depth:  # asked with the lock: a cell that begins now sees the lock, or is seen here
                raise NotInControl(_CELL)
            yield
        finally:
            self._turn.release()

    def interrupt(self) -> bool:
        """As the notebook's ■: KeyboardInterrupt in the running cell. False: none runs."""
        runs = self._is_notebook and self._depth > 0
        self._stopped = self._stopped or runs
        if runs and hasattr(signal, "pthread_kill") and callable(signal.getsignal(signal.SIGINT)):
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)  # out of any wait, such as a sleep
        elif runs:
            _thread.interrupt_main()
        return runs


_cells: list[Cells] = []  # one, made by the first show()
_views: "weakref.WeakSet[MountView]" = weakref.WeakSet()  # whose mounts a STOP stops


class MountView:
    """What show() returns. url: of the page; close(): it is served no more."""

    def __init__(self, mount: Mount, camera: PictureSource | None) -> None:
        if not isinstance(mount, Mount):
            raise BadValue(f"show() takes an open Mount, not {type(mount).__name__}")
        if not _cells:
            _cells.append(Cells())
        self._mount = weakref.ref(mount)  # strong, it would keep a motion alive that its owner has left
        self._camera = camera
        self._closed = False
        self.secret = secrets.token_urlsafe(24)
        self._server = _Server(("127.0.0.1", 0), type("Handler", (_Handler,), {"view": self}))
        self.host = f"127.0.0.1:{self._server.server_address[1]}"
        self.url = f"http://{self.host}/{self.secret}/"
        _views.add(self)
        threading.Thread(target=self._serve, name="notebook page", daemon=True).start()

    def _serve(self) -> None:
        with self._server:
            while not self._closed and self._mount() is not None:
                self._server.handle_request()

    def close(self) -> None:
        """Serve the page no more. The mount stays as it is."""
        self._closed = True

    def __repr__(self) -> str:
        return f"<the page of a mount: {self.url}>"

    def _repr_html_(self) -> str:
        height = _HEIGHT_WITH_PICTURE_PX if self._camera else _HEIGHT_PX
        return (
            f'<iframe src="{html_text(self.url)}" style="width:100%;height:{height}px;border:0" title="mount"></iframe>'
            "<p><small>An empty frame: the kernel has ended, or this browser is not on its computer and has no STOP."
            " Then interrupt the cell (■) to stop.</small></p>"
        )

    # ---- for the page: threads of the server

    def _open_mount(self) -> Mount:
        mount = self._mount()
        if mount is None or mount.session.age() == "closed":
            raise ConnectionLost(_CLOSED)
        return mount

    def state(self) -> dict[str, Any]:
        """All that the page shows. The board is not asked."""
        mount = self._mount()
        last = mount.session.board.last if mount else None
        axes = last[1].by_name if last else {}
        seen = self._camera.last if self._camera else None
        return {
            "tick": _tick(),
            "name": mount.identity if mount else _CLOSED,
            "age": mount.session.age() if mount else "closed",
            "axes": [[name, f"{a.position:+.3f}", a.certainty, a.moving] for name, a in axes.items()],
            "free": _cells[0].free,
            "camera": self._camera is not None,
            "picture": seen and str(seen[0].number),
            "found": "" if seen is None or seen[1] else str(seen[1]),
        }

    def picture(self) -> bytes:
        """The camera's last picture, as PNG; b"" if there is none."""
        return (self._camera.png() if self._camera else None) or b""

    def stop(self) -> str:
        """Motors of every mount that is shown off, and the running cell is interrupted. Raises ConnectionLost.

        None of these waits for another one: the port of a board that hangs takes seconds to say so.
        """
        try:
            for mount in {view._mount() for view in list(_views)} - {self._mount(), None}:
                threading.Thread(target=_halt, args=(mount,), name="notebook stop", daemon=True).start()
            interrupted = _cells[0].interrupt()
        finally:
            self._open_mount().halt()
        return "STOP was sent" + "; the running cell is interrupted" * interrupted

    def order(self, order: dict[str, Any]) -> str:
        """Carry out what a button asks for: a step, or a look at the camera. Returns what it did. Raises MountError."""
        mount, tick = self._open_mount(), order.get("tick")
        if isinstance(tick, bool) or not isinstance(tick, int) or not 0 <= _tick() - tick <= _LATE_MS:
            raise NotInControl(_LATE)
        if mount.link.lockstep:
            raise NotInControl(_LOCKSTEP)
        with mount.unless_stopped(), _cells[0].turn_of_page():
            if "axis" in order:
                if order.get("n") not in (1, -1):
                    raise BadValue("a button asks for one step")
                mount.axis(str(order["axis"])).step(order["n"])
            if self._camera:
                self._camera.spot()
        return ""


def _halt(mount: Mount) -> None:
    """Another mount's motors off. Its own page tells if it is not there any more."""
    with contextlib.suppress(MountError):
        mount.halt()


def _tick() -> int:
    return time.monotonic_ns() // 1_000_000


class _Server(socketserver.ThreadingTCPServer):
    """A thread for each request: a stop waits for none."""

    daemon_threads = True
    timeout = 0.5  # seconds between two looks whether the mount is still there

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that has gone is no error; anything else is told."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """One request. Whoever does not know the secret, or came by another name of this computer, gets nothing."""

    view: MountView
    timeout = 5.0  # seconds for a half-sent request

    def do_GET(self) -> None:
        if not (path := self._asked()):
            return
        if path == "state":
            self._answer(200, "application/json", json.dumps(self.view.state()).encode())
        elif path == "picture":
            picture = self.view.picture()
            self._answer(200 if picture else 404, "image/png", picture)
        elif path == "page":
            self._answer(200, "text/html; charset=utf-8", Path(__file__).with_suffix(".html").read_bytes())
        else:
            self.send_error(404)

    def do_POST(self) -> None:
        if not (path := self._asked()):
            return
        try:
            if path == "stop":
                said = self.view.stop()
            elif path == "order":
                said = self.view.order(self._body())
            else:
                self.send_error(404)
                return
        except MountError as e:
            self._answer(409, "text/plain; charset=utf-8", str(e).encode())
        else:
            self._answer(200, "text/plain; charset=utf-8", said.encode())

    def _asked(self) -> str:
        """What is asked for, below the secret; "" if that is wrong: then it is answered already."""
        secret, _, path = self.path.lstrip("/").partition("/")
        origin = self.headers["Origin"]
        if (
            hmac.compare_digest(secret.encode(), self.view.secret.encode())
            and self.headers["Host"] == self.view.host
            and origin in (None, f"http://{self.view.host}")
        ):
            return path.partition("?")[0] or "page"
        self.send_error(403)
        return ""

    def _body(self) -> dict[str, Any]:
        """The order. Raises BadValue."""
        length = self.headers["Content-Length"] or "0"
        try:
            order = json.loads(self.rfile.read(min(int(length), _MOST_BYTES)))
        except ValueError as e:
            raise BadValue("that is no order of the page") from e
        if not isinstance(order, dict):
            raise BadValue("that is no order of the page")
        return order

    def _answer(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *_: object) -> None:
        """Nothing is printed into the notebook."""
