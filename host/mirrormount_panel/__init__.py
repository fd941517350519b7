"""The web panel: drive the mount from any browser. Needs the extra [panel].

cli.py             `mirrormount panel`, and where its pages come in
server.py          the web servers, of the panel and of other pages; the log file
connections.py     their connections: how many at once, and how long one may take
auth.py            which requests are let in: tokens, sign-in, rates
mounts.py          the mounts of a panel, and its pages as clients of them
socket.py          the socket for requests, heartbeats and stops
page.py            the page, made of its cards
cards.py           the cards: press and hold, positions, settings, wire log, camera
board_settings.py  the board's settings for all pages
positions.py       a board's named positions for all pages, the way back to one, and Zeros that can be undone
position_cards.py  their card, and Undo Zero
log_card.py        the card of what has moved
camera.py          a camera on a page: what is told of it, and its pictures
page_moves.py      ways of several motions that a page has asked for by one button
spot_moves.py      those of the spot: clicks on the picture move it
hold_page.py       the page of a loop that holds the beam
static/            panel.js (drives), gamepad.js, moved.js (a press on what has just moved does nothing), mode.js
                   (colours), positions.js (the map), screen.js (the virtual screen), camera.js, hold.js, light.js,
                   panel.css

The mount itself is owned by mirrormount.supervise.
"""
