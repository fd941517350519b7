"""watchdog on the virtual CircuitPython board; microcontroller.py has the thing itself."""


class WatchDogMode:
    RAISE = "RAISE"
    RESET = "RESET"
