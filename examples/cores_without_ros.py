"""Identifies a motor in plain Python, cell by cell: the cores of the project need no ROS.

    ros_ws/run.sh python examples/cores_without_ros.py --plot trial/estimates.html

Editors that know ``# %%`` run one cell at a time. Three methods of ``Observer`` are all that it
takes: ``voltage`` and ``torque`` take one sample each, ``estimates`` returns what is known by now.
At the end of a record ``finish`` does what later samples would have brought: fits under way.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.observer import Observer
from gray_box_observer.settings import Configuration

NAME = 'cores_without_ros'
parser = argparse.ArgumentParser(prog=NAME, description='Identify a simulated motor without ROS.')
parser.add_argument('--duration', type=float, default=20.0, help='in s (default: %(default)s)')
parser.add_argument('--plot', type=Path, metavar='FILE.html', help='draw the estimates over time')
options = parser.parse_args()
if not 1.0 <= options.duration <= 3600.0:
    wrong = f'--duration must be 1 to 3600, got {options.duration:g}'
    parser.exit(2, f'{NAME}: error: {wrong}\n')

# %% A motor to identify
# The simulator knows the truth and tells the observer nothing but voltage and torque.
truth = {'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0}
simulation = Simulation(
    {'motor': PlantParameters(**truth)},
    'R[5,15]D[0.1,1]',
    sample_rate_hz=100.0,
    seed=1,
    torque_noise_relative=0.01,
)
recording = simulation.record(options.duration)

# %% An observer for it
# Names and defaults are those of the node's parameters. Each start is three times off.
configuration = Configuration.from_flat(
    {
        'motors': ['motor'],
        'predictor': False,
        'motor.torque_constant': 0.01,
        'motor.back_emf_constant': 0.01,
        'motor.initial.inductance': 1.5,
        'motor.initial.resistance': 3.0,
        'motor.initial.hysteresis': 30.0,
    }
)
observer = Observer(configuration)

# %% Feed it sample by sample
# Both methods return a list of results. One that has changed the estimate holds it.
history = []
for k, stamp in enumerate(recording.stamp_ns):
    stamp_ns = int(stamp)
    results = observer.voltage('motor', stamp_ns, float(recording.voltage_v[0, k]))
    results += observer.torque('motor', stamp_ns, float(recording.torque_nm[0, k]))
    changed = [result.estimate for result in results if result.estimate is not None]
    history += [(stamp_ns * 1e-9, estimate.value[0], estimate.std[0]) for estimate in changed]

# %% What is known now
# The leading axis counts motors. Believe a value where its verdict is `identified` or `negligible`.
estimate = observer.estimates()['motor']
print(f'{"parameter":<12} {"value":>10} {"std":>10} {"truth":>8}  unit          verdict')
for column, parameter in enumerate(estimate.parameters):
    value, std = estimate.value[0, column], estimate.std[0, column]
    verdict = estimate.verdicts[0][column].value
    known = f'{value:>10.5g} {std:>10.2g} {truth[parameter.name]:>8g}'
    print(f'{parameter.name:<12} {known}  {parameter.unit:<12}  {verdict}')
print(observer.fit('motor').sentence)

# %% Draw it
# Each parameter over time, with a band of two standard deviations and the truth.
if options.plot is not None:
    time_s = np.array([entry[0] for entry in history])
    values = np.array([entry[1] for entry in history])
    stds = np.array([entry[2] for entry in history])
    names = [f'{parameter.name} [{parameter.unit}]' for parameter in estimate.parameters]
    figure = make_subplots(rows=len(names), cols=1, shared_xaxes=True, subplot_titles=names)
    for column, parameter in enumerate(estimate.parameters):
        bar = {'type': 'data', 'array': 2.0 * stds[:, column]}
        trace = go.Scatter(x=time_s, y=values[:, column], error_y=bar, showlegend=False)
        figure.add_trace(trace, row=column + 1, col=1)
        figure.add_hline(truth[parameter.name], line_dash='dash', row=column + 1, col=1)
    figure.update_xaxes(title_text='time [s]', row=len(names), col=1)
    try:
        figure.write_html(options.plot)
    except OSError as error:
        parser.exit(2, f'{NAME}: error: {error}\n')
    print(f'drawn in {options.plot}')

# %% Done
observer.close()
