"""Keeping account of what of a bag could not be read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gray_box_observer.bag.contents import Loss
from gray_box_observer.bag.mcap.mcap_layout import Damage, Layout

_END = 'the file ends'
UNFINISHED = (
    'it was never finished: its recorder was killed or refused by the disk, or still records; '
    'its last messages may be missing'
)


class Losses:
    """Collects damages of files as they are found; each place of a file counts once."""

    def __init__(self) -> None:
        self.of_bag: list[str] = []
        self._damages: dict[tuple[Path, int], Damage] = {}
        self._undecodable: dict[str, tuple[int, str]] = {}

    def damage(self, path: Path, offset: int, byte_count: int, complaint: str) -> None:
        """Note what is wrong at one place of a file, unless that place is noted already."""
        self._damages.setdefault((path, offset), Damage(offset, byte_count, complaint))

    def undecodable(self, topic: str, reason: str) -> None:
        """Note a message whose bytes do not fit its type."""
        count = self._undecodable.get(topic, (0, ''))[0]
        self._undecodable[topic] = (count + 1, reason)

    def of_layout(self, path: Path, layout: Layout) -> None:
        """Note what a walk over a file found wrong, and how far the file goes.

        Args:
            path: The file.
            layout: What the walk found, with the true times of its pieces.
        """
        for damage in layout.damages:
            self._damages.setdefault((path, damage.offset), damage)
        if layout.end is None and not any(
            d.offset for (p, _), d in self._damages.items() if p == path
        ):
            complaint = f'{_END} without an end mark, so its last messages may be missing'
            self._damages[path, layout.size] = Damage(layout.size, 0, complaint)
        start_ns = min((piece.start_ns for piece in layout.pieces), default=0)
        for key, damage in list(self._damages.items()):
            if key[0] == path and damage.what.startswith(_END):
                end_times = [
                    piece.end_ns for piece in layout.pieces if piece.offset <= damage.offset
                ]
                after_s = (max(end_times) - start_ns) * 1e-9 if end_times else 0.0
                complaint = damage.what.replace(_END, f'{_END} after {after_s:.1f} s', 1)
                self._damages[key] = replace(damage, what=complaint)

    def has_damage(self, path: Path) -> bool:
        """Whether anything is known to be wrong with a file."""
        return any(key[0] == path for key in self._damages)

    def total(self, *, with_names: bool) -> Loss | None:
        """Everything noted so far, or None.

        Args:
            with_names: Whether to say which file it is.
        """
        reasons = list(self.of_bag)
        byte_count = 0
        for (path, _), damage in sorted(self._damages.items()):
            reasons.append(f'{path.name}: {damage.what}' if with_names else damage.what)
            byte_count += damage.byte_count
        for topic, (count, reason) in self._undecodable.items():
            reasons.append(f'{count} messages of {topic} could not be decoded ({reason})')
        return Loss(tuple(reasons), byte_count) if reasons else None
