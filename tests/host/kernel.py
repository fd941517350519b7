"""A real kernel of IPython, as JupyterLab and Notebook start it, and what its cells print."""

import json
import queue
import urllib.error
import urllib.request
from typing import Any

import pytest
from served import HANG_S

manager = pytest.importorskip("jupyter_client.manager")


class Kernel:
    """Use `with`. run() a cell, or begin() it and see() the end."""

    def __init__(self) -> None:
        self._manager, self._client = manager.start_new_kernel(kernel_name="python3", startup_timeout=HANG_S)

    def __enter__(self) -> "Kernel":
        return self

    def __exit__(self, *_: object) -> None:
        self._client.stop_channels()
        self._manager.shutdown_kernel(now=True)

    def begin(self, cell: str, until: str = "") -> str:
        """Begin a cell; returns when it has printed `until`."""
        number = self._client.execute(cell)
        if until:
            assert until in "".join(str(each) for each in self._outputs(number, until))
        return number

    def see(self, number: str) -> list[Any]:
        """Wait for the end of a cell: the text that it printed, its results by their types, "Error: words"."""
        return [*self._outputs(number)]

    def run(self, cell: str) -> list[Any]:
        """Run a cell to its end."""
        return self.see(self.begin(cell))

    def interrupt(self) -> None:
        """As the notebook's ■."""
        self._manager.interrupt_kernel()

    def _outputs(self, number: str, until: str = ""):
        text = ""  # the kernel sends what is printed in pieces, as its clock has it
        while not (until and until in text):
            try:
                message = self._client.get_iopub_msg(timeout=HANG_S)
            except queue.Empty:
                pytest.fail("the kernel says nothing")
            if message["parent_header"].get("msg_id") != number:
                continue
            kind, content = message["msg_type"], message["content"]
            if kind == "stream":
                text += content["text"]
                continue
            if text:
                yield text
                text = ""
            if kind in ("execute_result", "display_data"):
                yield content["data"]
            elif kind == "error":
                yield f"{content['ename']}: {content['evalue']}"
            elif kind == "status" and content["execution_state"] == "idle":
                return
        yield text


def get(url: str) -> bytes:
    with urllib.request.urlopen(url, timeout=HANG_S) as answer:
        return answer.read()


def post(url: str, body: object = None, **headers: str) -> tuple[int, str]:
    """The status and what was said."""
    request = urllib.request.Request(url, json.dumps(body).encode(), headers, method="POST")
    try:
        with urllib.request.urlopen(request, timeout=HANG_S) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as e:
        return e.code, e.read().decode()
