"""The tools of every room: errors, checks, declared fields, paths, results; and the version of the package."""

__version__ = "0.1.0"
