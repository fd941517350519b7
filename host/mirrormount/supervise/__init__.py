"""One owner of a mount, many requesters: worker, lease, requests, wire log. Panel and programs stand on it."""
