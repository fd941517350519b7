"""`mirrormount camera show --page`: in a process of its own, as a person starts it."""

import json
import signal
import subprocess
import sys

import httpx
import pytest
from served import PATIENCE_S

from mirrormount.cli.main import main

SHOW = (sys.executable, "-m", "mirrormount", "camera", "show", "--page", "--no-browser", "--http", "0")


def test_the_page_shows_a_camera_without_a_mount_until_ctrl_c(tmp_path):
    process = subprocess.Popen(
        [*SHOW, "--camera", "virtual-table://#2"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        name, ready = process.stdout.readline().strip(), process.stdout.readline().strip()
        with httpx.Client(base_url=ready.removeprefix("ready "), timeout=PATIENCE_S) as http:
            assert name in http.get("/").text
            answer = http.get("camera/1?profile")
            seen = json.loads(answer.headers["x-seen"])
            assert answer.content[:2] == b"\xff\xd8"
            assert seen["unit"] == [0.05, "mm"] and not seen["note"]  # with two mounts no one distance is the mirror's
            assert seen["says"].startswith("x ") and seen["blobs"] and seen["profile"]["threshold"]
            assert seen["exposure"].startswith("exposure: right") and len(seen["cuts"]) == 2
            assert http.get("drive").status_code == 404
    finally:
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130 and "Traceback" not in errors


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--camera", "virtual-table://#9"], "it has 2 cameras"),
        (["--frames", "3"], "--frames: of the lines, and --page shows no lines"),
        (["--http", "70000"], "--http is a port number"),
    ],
)
def test_what_cannot_be_served_is_refused_in_one_line(capsys, arguments, why):
    assert main([*SHOW[3:], *arguments]) == 1
    told = capsys.readouterr().err
    assert why in told and len(told.splitlines()) == 1
