"""A parser of command lines whose errors show what they quote: a terminal obeys nothing of it."""

from __future__ import annotations

import argparse
from typing import NoReturn

from gray_box_observer.safe_io.printable import printable


class CommandParser(argparse.ArgumentParser):
    """An argparse parser; unprintable characters of arguments are escaped where it quotes them."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one printable line behind the usage, and end with code 2."""
        super().error(printable(message))
