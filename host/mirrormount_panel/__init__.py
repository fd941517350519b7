"""The web panel: drive the mount from any browser. Needs the extra [gui]; only mirrormount_panel/cli.py imports this.

pages.py             the pages as clients of the mount: secrets, bounds     pure
mounts.py            the mounts of a panel                                  pure
rates.py             how often something may happen                         pure
sign_in.py           sign-in of a browser where a token is needed           no web
auth.py              which requests are let in; headers of every reply      ASGI
socket.py            the socket for requests, heartbeats and stops          ASGI
run_on_mount.py      a page's question to the mount; messages to its user   NiceGUI
page.py              the page, made of its cards                            NiceGUI
cards_of_motion.py   press and hold, steps, speeds                          NiceGUI
cards_of_state.py    positions, lamps, plot, events, virtual screen         NiceGUI
card_of_settings.py  all settings, apply, save, restore                     NiceGUI
card_of_wire.py      the wire log                                           NiceGUI
card_of_camera.py    the camera's picture                                   NiceGUI
camera_view.py       what is shown of a camera, as data                     OpenCV
camera_html.py       the elements that its script fills                     pure
camera_route.py      its pictures, one at a time for each page              ASGI
spot_moves.py        clicks on the picture move the spot                    OpenCV
server.py            NiceGUI on uvicorn; the log file                       uvicorn
light_server.py      a page without a mount, such as a camera's             uvicorn
hold_board.py        what a loop has told, for its page                     pure
hold_page.py         the page of a loop that holds a beam                   uvicorn
log_file.py          tracebacks go to a file
static/              panel.js (drives), moved.js (what was not meant), screen.js (the virtual screen), camera.js,
                     hold.js, light.js, panel.css

The mount itself is owned by mirrormount.supervise. `mirrormount panel` is mirrormount_panel/cli.py.
"""
