"""Text that came from a file, as it may be shown."""

from __future__ import annotations

__all__ = ["printable"]


def printable(text: str, *, lines: bool = False) -> str:
    r"""A text in which control, bidirectional and other invisible characters are written out as escapes.

    A terminal obeys the first and shows what the second hide in another order; a lone surrogate cannot be written.

    Args:
        text: The text.
        lines: Keep line breaks and tabs.

    Example:
        >>> print(printable("a\x1b]0;b\u202e"))
        a\x1b]0;b\u202e
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or (lines and c in "\n\t") else repr(c)[1:-1] for c in text)
