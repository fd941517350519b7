"""The web panel: drive the mount from any browser. Needs the extra [panel].

cli.py             `mirrormount panel`, and where its pages come in
server.py          the web servers, of the panel and of other pages; the log file
auth.py            which requests are let in: tokens, sign-in, rates
mounts.py          the mounts of a panel, and its pages as clients of them
socket.py          the socket for requests, heartbeats and stops
page.py            the page, made of its cards
cards.py           the cards: press and hold, positions, settings, wire log, camera
board_settings.py  the board's settings for all pages
camera.py          a camera on a page: what is told of it, and its pictures
spot_moves.py      clicks on the picture move the spot
hold_page.py       the page of a loop that holds the beam
static/            panel.js (drives), gamepad.js, moved.js (a press on what has just moved does nothing), mode.js
                   (colours), screen.js (the virtual screen), camera.js, hold.js, light.js, panel.css

The mount itself is owned by mirrormount.supervise.
"""
