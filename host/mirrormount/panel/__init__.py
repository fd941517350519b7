"""The web panel: drive the mount from any browser. Needs the extra [gui]; nothing else imports this.

desk.py      who is here, who controls, and whose page is alive         pure
presses.py   buttons that are down, and presses that wait               pure
orders.py    what a page may ask for, as data                           pure
notices.py   what has happened, in words                                pure
rates.py     how often something may happen                             pure
pilot.py     the one thread that speaks to the mount                    no web
brake.py     the thread that stops it                                   no web
wire_log.py  what went over the wire                                    no web
entrance.py  how a browser signs in where a token is needed             no web
guard.py     who may come in, and what every answer forbids             ASGI
driving.py   the socket that orders, heartbeats and stops come by       ASGI
page.py …    what is seen                                               NiceGUI
command.py   `mirrormount panel`
"""
