"""Shell commands of cameras, measurements, scans and the loop."""
