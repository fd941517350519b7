"""The board's stdin and stdout on the seam."""

import _seam


class _In:
    def readinto(self, buffer):
        for i in range(len(buffer)):
            buffer[i] = _seam.seam.take()
        _seam.seam.tick(10)
        return len(buffer)


class _Out:
    def write(self, data):
        for c in data:
            _seam.seam.tick(10)
            _seam.seam.sent(c)
        return len(data)


class _Text:
    """A text stream: what print() and the prompt write to. Line ends become CR LF, as on a board."""

    def __init__(self, raw):
        self.buffer = raw

    def write(self, text):
        self.buffer.write(text.replace("\n", "\r\n").encode())
        return len(text)

    def flush(self):
        pass


stdin = _Text(_In())
stdout = _Text(_Out())
