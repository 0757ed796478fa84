"""A rotor whose speed nobody measures, or badly: what the observer finds, against the bound.

It has voltage and torque alone, and with ``--speed`` a speed with noise, of an encoder, or late.
The Cramer-Rao bound is that of the whole motor, with one output or two.

Gear motors are drawn at random and simulated by a plant of the benchmarks' own, with dry friction
that holds. Robots' motors come last, where their logs are (``../shared/data`` beside the
repository, or ``--data FOLDER``).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from common.figures import Figure, figure_table, last_line
from common.rotor.axis_figures import axis_figures
from common.rotor.hidden_figures import (
    FLEET_DRAWN,
    QUICK_SEEDS,
    choice_figures,
    fast_figures,
    fleet_figures,
    hysteresis_figures,
    peer_figures,
    slow_figures,
    smooth_figures,
    sticky_figures,
    thesis_figures,
    together_figures,
)
from common.rotor.measured_figures import (
    ENCODER_SEEDS,
    encoder_figures,
    mechanical_figures,
    speed_figures,
)
from common.rotor.robot_figures import prediction_figures, robot_figures
from real_motors import DEFAULT_DATA

from gray_box_observer.errors import GrayBoxError

SEEDS = 20
LONG_S = 20.0
QUICK_S = 4.0


def main() -> int:
    """Print tables and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='fewer and shorter records')
    parser.add_argument('--seeds', type=int, help='motors drawn, 20 unless quick')
    parser.add_argument(
        '--speed', action='store_true', help='only motors whose speed is measured, badly'
    )
    parser.add_argument(
        '--encoders', action='store_true', help='only encoders of few and many counts'
    )
    parser.add_argument(
        '--mechanics', action='store_true', help='only inertia and frictions from a measured speed'
    )
    parser.add_argument(
        '--peers',
        action='store_true',
        help='only Kalman filters and a batch fit beside it',
    )
    parser.add_argument(
        '--fleet', action='store_true', help='only many motors in the same messages'
    )
    parser.add_argument(
        '--smooth', action='store_true', help='only voltages that hardly step, without a speed'
    )
    parser.add_argument(
        '--hysteresis', action='store_true', help='only rotors whose hysteresis nobody has named'
    )
    parser.add_argument(
        '--together', action='store_true', help='only effects that come together, none named'
    )
    parser.add_argument(
        '--thesis', action='store_true', help="only the thesis's sets, whose speed is Kt i"
    )
    parser.add_argument(
        '--predict', action='store_true', help='only the prediction of robots never seen'
    )
    parser.add_argument(
        '--axis', action='store_true', help='only the EMPS axis, its mass and frictions'
    )
    parser.add_argument('--data', type=Path, help='folder with regbot_rev2b and emps')
    options = parser.parse_args()
    seeds = options.seeds or (QUICK_SEEDS if options.quick else SEEDS)
    length_s = QUICK_S if options.quick else LONG_S
    counts = not options.quick
    data = options.data or DEFAULT_DATA
    drawn = {
        'encoders': options.seeds or ENCODER_SEEDS,
        'fleet': FLEET_DRAWN,
        'predict': 1,
        'axis': 1,
    }
    parts: dict[str, Callable[[], list[Figure]]] = {
        'speed': lambda: speed_figures(seeds, length_s, counts=counts),
        'encoders': lambda: encoder_figures(drawn['encoders'], counts=counts),
        'mechanics': lambda: mechanical_figures(seeds, length_s, counts=counts),
        'peers': lambda: peer_figures(seeds, length_s, counts=counts),
        'fleet': lambda: fleet_figures(counts=counts),
        'smooth': lambda: smooth_figures(seeds, counts=counts),
        'hysteresis': lambda: hysteresis_figures(seeds, 0.5 * length_s, counts=counts),
        'together': lambda: together_figures(seeds, length_s, counts=counts),
        'thesis': lambda: thesis_figures(seeds, counts=counts),
        'predict': lambda: prediction_figures(data, quick=options.quick),
        'axis': lambda: axis_figures(data),
    }
    for part, run_part in parts.items():
        if getattr(options, part):
            figures = run_part()
            print(f'\n{figure_table(figures)}')
            print(last_line('rotor', drawn.get(part, seeds), figures))
            return 0
    figures = [
        *fast_figures(seeds, length_s, counts=counts),
        *slow_figures(seeds, 250.0, length_s, 1e-3, counts=counts),
        *slow_figures(seeds, 100.0, 2.0 * length_s, 5e-3, counts=counts),
        *fleet_figures(counts=counts),
        *sticky_figures(seeds, length_s, counts=counts),
        *choice_figures(seeds, length_s, counts=counts),
        *thesis_figures(seeds, counts=counts),
        *peer_figures(seeds, length_s, counts=counts),
    ]
    try:
        figures += robot_figures(data)
        figures += prediction_figures(data, quick=options.quick)
        figures += axis_figures(data)
    except GrayBoxError as error:
        print(f'rotor: error: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    print(f'\n{figure_table(figures)}')
    print(last_line('rotor', seeds, figures))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
