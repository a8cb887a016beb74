"""Label how robot demonstrations were done, and learn from those labels."""

__version__ = "0.1.0"
