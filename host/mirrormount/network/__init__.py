"""A board served on TCP: listener, client sessions, reader of the port, relay between them."""
