"""Archives: many bags, each identified by itself, one after another or spread over a cluster."""

from gray_box_observer.archive.bag_work import BagResult, BagWork
from gray_box_observer.archive.dask_engine import DaskEngine, require_dask
from gray_box_observer.archive.discovery import find_bags
from gray_box_observer.archive.serial_engine import SerialEngine
from gray_box_observer.archive.table import require_pyarrow, write_table
from gray_box_observer.archive.trends import gather

__all__ = [
    'BagResult',
    'BagWork',
    'DaskEngine',
    'SerialEngine',
    'find_bags',
    'gather',
    'require_dask',
    'require_pyarrow',
    'write_table',
]
