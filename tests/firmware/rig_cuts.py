"""A port that is told of each point at which the power can go in the operations on its files."""


def cuttable(port):
    """A subclass of a port, whose point() is called before and after each operation, and after each byte of a file."""

    class Cuttable(port):
        def point(self):
            raise NotImplementedError

        def store(self, name, data):
            self.point()
            kept = self.files.get(name)
            for length in range(len(data) + 1):
                self.files[name] = bytes(data[:length])
                self.point()
            if kept is None:
                del self.files[name]
            else:
                self.files[name] = kept
            super().store(name, data)
            self.point()

        def rename(self, old, new):
            self.point()
            super().rename(old, new)
            self.point()

        def remove(self, name):
            self.point()
            super().remove(name)
            self.point()

    return Cuttable
