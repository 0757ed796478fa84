"""What a report says of a run, collected from the observer itself."""

from __future__ import annotations

import pytest

from gray_box_observer.observer.observer import Observer
from gray_box_observer.report.run.collector import notes
from gray_box_observer.settings.configuration import Configuration


@pytest.mark.parametrize(
    ('motor', 'words'),
    [
        ({'speed_source': 'torque_constant'}, 'it scales the speed w = Kt i alone'),
        ({'speed_source': 'measured'}, 'no estimate depends on it'),
        ({'speed_source': 'rotor'}, 'inertia, frictions and load scale with it, L and R do not'),
    ],
)
def test_the_report_says_what_depends_on_kt_where_a_current_is_read(
    motor: dict[str, object], words: str
) -> None:
    own = {f'motor.{name}': value for name, value in {'torque_constant': 0.02, **motor}.items()}
    configuration = Configuration.from_flat(
        {'predictor': False, 'torque.quantity': 'current', **own}
    )
    observer = Observer(configuration)
    for k in range(3):
        observer.voltage('motor', 1_000_000 * k, 1.0)
        observer.torque('motor', 1_000_000 * k, 0.1 * k, 2.0 * k)
    observer.flush()
    assert notes('motor', observer)[0].endswith(f'The current is read, so that {words}.')
