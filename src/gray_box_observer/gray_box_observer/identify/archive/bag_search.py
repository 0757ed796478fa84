"""Which bags an archive holds."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from gray_box_observer.bag.metadata import ENDINGS, METADATA_NAME
from gray_box_observer.errors import BagError


def find_bags(places: Iterable[Path]) -> list[Path]:
    """Return every bag at the places, as absolute paths, each once.

    A file is taken for a bag whatever it is called. A folder is one if it has ``metadata.yaml``,
    or, after a recorder was killed, the first file of a recording (``NAME/NAME_0.mcap``). Any other
    folder is looked through, in order of names; an ``.mcap`` file in it, packed or not, is a bag
    too. Hidden folders are left out, and so is what links to another folder.

    Args:
        places: bags, and folders of bags.

    Raises:
        BagError: a place is not there or cannot be read, or no bag is at it.
    """
    unique_bags: dict[Path, None] = {}
    for place in places:
        if not place.exists():
            raise BagError(f'{place}: no such bag or folder of bags')
        path = os.path.abspath(place)  # noqa: PTH100 - without following links
        bags = list(_bags_at(Path(path)))
        if not bags:
            raise BagError(
                f'{place}: no bag in this folder: neither a {METADATA_NAME} nor an .mcap file'
            )
        unique_bags.update(dict.fromkeys(bags))
    return list(unique_bags)


def _bags_at(place: Path) -> Iterator[Path]:
    if not place.is_dir():
        yield place
        return
    for folder, below, files in os.walk(place, onerror=_refuse):
        if any(
            name in files
            for name in (METADATA_NAME, *(f'{Path(folder).name}_0{ending}' for ending in ENDINGS))
        ):
            below.clear()
            yield Path(folder)
            continue
        below[:] = sorted(name for name in below if not name.startswith('.'))
        for name in sorted(files):
            if name.endswith(ENDINGS) and not name.startswith('.'):
                yield Path(folder, name)


def _refuse(error: OSError) -> None:
    raise BagError(f'{error.filename}: cannot be looked through: {error.strerror}') from error
