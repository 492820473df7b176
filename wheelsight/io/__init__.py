"""Input and output: recordings of all formats, bags, live cameras and serial lines."""

__all__: list[str] = []
