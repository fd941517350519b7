"""What a check of the self-test can say instead of "ok". They never leave `mirrormount check`."""


class NotTested(Exception):
    """A check could not be made; the message says why."""


class Wrong(Exception):
    """A check failed; the message says what is wrong and what to do."""
