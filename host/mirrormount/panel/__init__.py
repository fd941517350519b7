"""The web panel: drive the mount from any browser. Needs the extra [gui]; nothing else imports this.

desk.py      who is here, who controls, and whose page is alive         pure
pilot.py     the one thread that speaks to the mount, and the brake     no web
orders.py    what a page may ask for, as data                           pure
wire_log.py  what went over the wire                                    no web
guard.py     who may come in                                            ASGI
driving.py   the socket that orders, heartbeats and stops come by       ASGI
page.py …    what is seen                                               NiceGUI
command.py   `mirrormount panel`
"""
