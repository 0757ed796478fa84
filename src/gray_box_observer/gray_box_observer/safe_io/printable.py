"""Foreign text as it may be shown: unprintable characters are escaped, nothing is obeyed.

Names of motors, topics and files, and errors that quote them, come from bags and networks. A
terminal would take control characters in them for orders, a log a line feed for the next entry.
"""

from __future__ import annotations


def printable(text: object, most: int | None = None) -> str:
    """Return a text on one line, every character that is not printable as Python would write it.

    Args:
        text: anything; its words count.
        most: characters that are shown at most; None: all.
    """
    words = str(text)
    if most is not None and len(words) > most:
        words = words[:most] + '...'
    if words.isprintable():
        return words
    return ''.join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in words)
