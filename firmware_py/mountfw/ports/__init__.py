"""One port for each platform: its pins, clock, console, files and watchdog."""
