"""Writes ``docs/API.md`` from the code (``make docs``): topics, services, options, exit codes.

Parameters and topics come from their declarations; endpoints, services and what the nodes of bags
declare come from nodes made here, on no network. A test fails when the committed page is not what
this writes.
"""

from __future__ import annotations

import argparse
import difflib
import sys
from collections.abc import Sequence
from dataclasses import replace
from types import ModuleType

from api_sources import ROOT, Seen, look_at_nodes, parser_of
from api_tables import (
    OF_A_MANAGED_NODE,
    OF_EVERY_NODE,
    PARAMETER_HEAD,
    PARAMETERS_OF_EVERY_NODE,
    SERVICES,
    PageError,
    launch_lines,
    option_lines,
    override_lines,
    sentence,
    service_lines,
    simulator_rows,
    spec_rows,
    table,
    topic_lines,
    undeclared,
    value_text,
)

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.ros import parameters as simulated_parameters
from dc_motor_sim.ros import topics as simulated_topics
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.identify import command, requirement
from gray_box_observer.identify.archive import archive_options
from gray_box_observer.ros import running
from gray_box_observer.ros import topics as observed_topics
from gray_box_observer.ros.bags import player_arguments, recorder_arguments
from gray_box_observer.ros.observer import observer_node
from gray_box_observer.ros.watching import dashboard_command, watch_command
from gray_box_observer.settings.parameters import (
    MOTOR_PARAMETERS,
    OBSERVER_PARAMETERS,
    ParameterSpec,
)
from gray_box_observer.settings.signal_parameters import INPUT_PARAMETERS

PAGE = ROOT / 'docs' / 'API.md'

TOPICS_OF_A_BAG = {
    'recorder': 'Subscribes to what it records, of any type, with the quality of service that the '
    'publishers offer.',
    'player': 'Publishes what the bag holds, with the quality of service recorded with it; with '
    '`clock` also `/clock`.',
}
"""Of the two nodes whose topics depend on a bag."""

WATCHED = {
    'watch': 'Subscribes to `/diagnostics`, and to `~/estimates` of every observer that it finds, '
    'or of those that `--observer` names. It has no parameters and no services.',
    'dashboard': 'Subscribes to the same, and by best effort to `~/predicted_torque` and `~/speed` '
    'of these observers and to voltage and torque as `--params` has them. It has no parameters '
    'and no services.',
}
"""Of the two nodes that listen to observers."""

OF_A_FIT = {
    FitVerdict.UNTESTED: 'It is not known: samples are too few, or the voltage hardly varies.',
    FitVerdict.OK: 'It does.',
    FitVerdict.WARNING: 'Nearly: something small is left.',
    FitVerdict.MISFIT: 'It does not; nothing of the motor may be believed.',
}
"""Whether the white box explains the data, by the verdict of the fit test."""

HEAD = f"""<!-- Written by `make docs` from the code; edit the declarations, not this page. -->
# API

Every executable with its options, topics, services and parameters. \
Names of topics are relative and can be remapped;
`~` is the node's own name, `<motor>` the name of a motor. All units are SI.

An executable of `gray_box_observer` ends with

| code | when |
| --- | --- |
| {running.EXIT_DONE} | it has finished, or was asked to end by SIGINT, SIGTERM or SIGHUP; \
`identify` also where the verdict is `misfit` |
| {running.EXIT_USER_ERROR} | the user must change something: one line on standard error says what |
| 1 | `identify`: a defect has stopped a motor; a warning says which, \
what is known of the others stands |
| {archive_options.EXIT_SOME_FAILED} | `identify` read every bag by itself, \
and some gave nothing ([archives](ARCHIVES.md)) |
| {requirement.EXIT_UNMET} | `identify --require fit` or `identified`: it ran to the end, \
and a motor falls short; a line says which |
| {archive_options.EXIT_INTERRUPTED} | `identify` was interrupted; \
a node was interrupted a second time while it was closing |

Anything else is a defect, and shows its traceback. `motor_sim` ends with 0 and 2 alike, \
and with 1 when the plant
could not be simulated on.
"""


def page() -> str:
    """The whole page.

    Raises:
        PageError: something in the code has no description.
    """
    nodes = look_at_nodes()
    every = {name.rpartition('/')[2] for name in nodes['motor_sim'].services}
    observer = nodes['gray_box_observer']
    managed = every | {
        name.rpartition('/')[2] for name, kind in observer.services.items() if 'lifecycle' in kind
    }
    gone = set(SERVICES) - {name.lstrip('/') for seen in nodes.values() for name in seen.services}
    if gone:
        raise PageError(
            f'SERVICES of docs/api_tables.py describes {", ".join(sorted(gone))}, which no node has'
        )
    lines = [*HEAD.splitlines(), '']
    lines += [
        '## observer',
        '',
        'Package `gray_box_observer`, node `gray_box_observer`, a managed node.',
        '',
    ]
    lines += option_lines(parser_of(observer_node))
    lines += topic_lines('gray_box_observer', observer, [observed_topics])
    lines += service_lines('gray_box_observer', observer, managed)
    lines += ['### Parameters', '', 'The same file serves `identify --params`.', '']
    lines += table(PARAMETER_HEAD, spec_rows(OBSERVER_PARAMETERS))
    lines += ['Of each motor, in a group under its name, or under `defaults` for all:', '']
    lines += table(PARAMETER_HEAD, spec_rows(MOTOR_PARAMETERS, '<motor>.'))
    lines += ['Of each input that an expression names, in a group under its name:', '']
    lines += table(PARAMETER_HEAD, spec_rows(INPUT_PARAMETERS, '<input>.'))
    of_motor = [replace(spec, name=f'motor.{spec.name}') for spec in MOTOR_PARAMETERS]
    complain_of_others('observer', observer, [*OBSERVER_PARAMETERS, *of_motor])
    lines += override_lines(observer)
    lines += ['## identify', '', 'Package `gray_box_observer`; needs no ROS.', '']
    lines += option_lines(command._parser())
    lines += fit_lines()
    of_recorder = recorder_arguments.RECORDER_PARAMETERS
    of_player = player_arguments.PLAYER_PARAMETERS
    lines += bag_lines('recorder', recorder_arguments, of_recorder, nodes['bag_recorder'], every)
    lines += bag_lines('player', player_arguments, of_player, nodes['bag_player'], every)
    lines += watcher_lines('watch', watch_command, 'gray_box_watch', '; over a bag it needs no ROS')
    lines += watcher_lines('dashboard', dashboard_command, 'gray_box_dashboard', '')
    lines += simulator_lines(nodes['motor_sim'], every)
    lines += launch_lines(ROOT / 'src')
    lines += [
        '## Of every node',
        '',
        'Topics: ' + ', '.join(f'`{name}`' for name in OF_EVERY_NODE) + '.',
    ]
    lines += ['Services: ' + ', '.join(f'`~/{name}`' for name in sorted(every)) + '.']
    lines += [
        'Parameters: ' + ', '.join(f'`{name}`' for name in PARAMETERS_OF_EVERY_NODE) + '.',
        '',
    ]
    lines += [
        'The observer, as a managed node, also has '
        + ', '.join(f'`~/{n}`' for n in sorted(managed - every))
    ]
    lines += ['and publishes ' + ', '.join(f'`~/{name}`' for name in OF_A_MANAGED_NODE) + '.']
    return '\n'.join(lines) + '\n'


def fit_lines() -> list[str]:
    """The words of a fit in the result of `identify`."""
    lines = [
        '### Fit',
        '',
        'With `--json`, `fit` of a motor says in its `verdict` whether the white box explains the '
        'data:',
        '',
        *table(('verdict', ''), [[f'`{one.value}`', OF_A_FIT[one]] for one in FitVerdict]),
    ]
    return [
        *lines,
        'The `ratio` and `whiteness` of an `untested` motor are `null`. So are `fit_percent` and '
        '`nmae` of a torque that does not vary, for both are relative to its spread.',
        '',
        '`withheld` names the parameters that are not identified beside what is left, though the '
        'white box explains the data.',
        '',
    ]


def bag_lines(
    name: str, arguments: ModuleType, specs: Sequence[ParameterSpec], seen: Seen, every: set[str]
) -> list[str]:
    """The section of a node that records or replays."""
    parser = arguments.make_parser()
    node = f'bag_{name}'
    said = ' '.join((parser.description or '').split())
    lines = [
        f'## {name}',
        '',
        f'Package `gray_box_observer`, node `{node}`. {said}',
        '',
        *option_lines(parser),
    ]
    lines += ['### Topics', '', TOPICS_OF_A_BAG[name], '', *service_lines(node, seen, every)]
    complain_of_others(name, seen, specs)
    lines += [
        '### Parameters',
        '',
        'Read once, at the start.',
        '',
        *table(PARAMETER_HEAD, spec_rows(specs)),
    ]
    return lines + override_lines(seen)


def watcher_lines(name: str, command: ModuleType, node: str, note: str) -> list[str]:
    """The section of an executable that watches observers."""
    parser = command.make_parser()
    said = ' '.join((parser.description or '').split())
    return [
        f'## {name}',
        '',
        f'Package `gray_box_observer`, node `{node}`{note}. {said}',
        '',
        *option_lines(parser),
        '### Topics',
        '',
        WATCHED[name],
        '',
    ]


def complain_of_others(name: str, seen: Seen, specs: Sequence[ParameterSpec]) -> None:
    """Raise a `PageError` where a node declares a parameter that is not specified."""
    strange = undeclared(seen, specs)
    if strange:
        raise PageError(f'{name} declares {", ".join(sorted(strange))} without a specification')


def simulator_lines(seen: Seen, every: set[str]) -> list[str]:
    """The section of `motor_sim`."""
    lines = ['## motor_sim', '', 'Package `dc_motor_sim`, node `motor_sim`.', '']
    lines += table(('option', ''), [['`-h`, `--help`', 'Say every parameter and end.']])
    lines += topic_lines('motor_sim', seen, [simulated_topics])
    lines += service_lines('motor_sim', seen, every)
    rows = simulator_rows(simulated_parameters.NodeParameters)
    lines += [
        '### Parameters',
        '',
        *table(PARAMETER_HEAD, rows),
        'Of each motor, in a group under its name:',
        '',
    ]
    excitation = simulated_parameters._EXCITATION_OF_MOTOR.text
    first = ['`<motor>.excitation`', 'string', '', value_text(''), '', 'no', sentence(excitation)]
    motor = simulator_rows(PlantParameters, '<motor>.', live=True)
    return lines + table(PARAMETER_HEAD, [first, *motor])


def difference(committed: str, wanted: str) -> str:
    """What is to be changed on the committed page; empty if nothing is."""
    lines = difflib.unified_diff(
        committed.splitlines(), wanted.splitlines(), 'docs/API.md', 'the code', lineterm='', n=0
    )
    return '\n'.join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page, or say how it differs."""
    parser = argparse.ArgumentParser(prog='make_api', description=(__doc__ or '').split('\n', 1)[0])
    parser.add_argument(
        '--check',
        action='store_true',
        help='write nothing; fail if the page is not what it should be',
    )
    options = parser.parse_args(arguments)
    try:
        wanted = page()
    except PageError as error:
        print(f'make_api: error: {error}', file=sys.stderr)
        return 2
    if options.check:
        found = difference(PAGE.read_text(encoding='utf-8') if PAGE.exists() else '', wanted)
        if found:
            print(
                f'{found}\nmake_api: error: docs/API.md is not what the code says; run make docs',
                file=sys.stderr,
            )
        return 1 if found else 0
    PAGE.write_text(wanted, encoding='utf-8')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
