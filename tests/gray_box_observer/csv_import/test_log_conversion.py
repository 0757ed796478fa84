"""Logs that become bags."""

from __future__ import annotations

import math
import os
import re

import numpy as np
import pytest

from gray_box_observer.bag.joint_state import decode_joint_state
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.csv_import.log_conversion import CsvMapping, MotorColumns, csv_to_bag
from gray_box_observer.errors import BagError


def signals(folder, topic):
    with BagReader(folder) as bag:
        views = [decode_joint_state(m.data) for m in bag.messages([topic])]
        assert all(
            m.log_time_ns == decode_joint_state(m.data).stamp_ns for m in bag.messages([topic])
        )
    return [
        (round((v.stamp_ns - 10**9) / 1e6), v.names[0], v.effort[0], *v.velocity) for v in views
    ]


def convert(tmp_path, text, *options):
    log = tmp_path / 'log.csv'
    log.write_text(text)
    summary = csv_to_bag(log, tmp_path / 'bag', CsvMapping.from_options(options))
    return (
        summary,
        signals(tmp_path / 'bag', '/motor/voltage'),
        signals(tmp_path / 'bag', '/motor/torque'),
    )


SIGNALS = ('time=t', 'voltage=u', 'torque=m')
LOG = 't_s,u_V,i_A,w\n0.000,1,0.5,3\n0.010,2,0.6,4\n0.020,3,0.7,5\n'


def test_columns_become_voltage_torque_and_speed(tmp_path):
    summary, voltage, torque = convert(
        tmp_path, LOG, 'time=t_s', 'voltage=u_V', 'current=i_A', 'torque_constant=0.1', 'speed=w*2'
    )
    assert voltage == [(0, 'motor', 1.0), (10, 'motor', 2.0), (20, 'motor', 3.0)]
    assert [(t, n, pytest.approx(e), s) for t, n, e, s in torque] == [
        (0, 'motor', 0.05, 6.0),
        (10, 'motor', 0.06, 8.0),
        (20, 'motor', 0.07, 10.0),
    ]
    assert (summary.rows, summary.messages, summary.duration_s) == (3, 6, pytest.approx(0.02))


def test_a_voltage_of_the_preceding_interval_is_stamped_where_that_interval_starts(tmp_path):
    _, voltage, torque = convert(
        tmp_path, LOG, 'time=t_s', 'voltage=u_V', 'torque=i_A', 'voltage_applies=preceding'
    )
    assert voltage == [(0, 'motor', 2.0), (10, 'motor', 3.0)]
    assert [t for t, *_ in torque] == [0, 10, 20]


def test_a_log_of_a_robot_with_percent_comments_and_numbered_columns(tmp_path):
    text = (
        '%% logfile of a robot\n%  1    time 0.000 sec\n0.001 2  5.0 6.0  0.5 0.6\n0.002 2  5.1 '
        '6.1  0.7 0.8\n'
    )
    _, voltage, torque = convert(
        tmp_path,
        text,
        'time=$1',
        *('left.voltage=$3', 'left.current=$5', 'left.torque_constant=0.1'),
        *('right.voltage=$4', 'right.current=$6', 'right.torque_constant=0.2'),
    )
    assert voltage == [(0, 'left', 5.0), (0, 'right', 6.0), (1, 'left', 5.1), (1, 'right', 6.1)]
    assert [e for _, _, e in torque] == pytest.approx([0.05, 0.12, 0.07, 0.16])


def test_raw_counts_scale_by_an_expression_of_several_columns(tmp_path):
    text = (
        'tick,duty,va,vb,raw,ok\n0,16384,900,100,300,1\n1,-16384,900,100,200,0\n2,0,900,100,100,1\n'
    )
    summary, voltage, torque = convert(
        tmp_path,
        text,
        *(
            'time=tick*1e-3',
            'voltage=duty/32767*(va-vb)*2.466e-3',
            'torque=raw*0.9e-3-0.1',
            'where=ok==1',
        ),
    )
    assert voltage == [
        (0, 'motor', pytest.approx(16384 / 32767 * 800 * 2.466e-3)),
        (2, 'motor', 0.0),
    ]
    assert [e for _, _, e in torque] == pytest.approx([0.17, -0.01])
    assert summary.filtered_rows == 1


def test_a_row_that_loses_only_its_torque_keeps_its_voltage(tmp_path):
    text = 't,u,m,ok\n0,1,1,1\n1,2,2,0\n2,3,3,1\n'
    _, voltage, torque = convert(
        tmp_path, text, 'time=t', 'voltage=u', 'torque=m', 'where=ok==1', 'where_drops=torque'
    )
    assert [e for *_, e in voltage] == [1.0, 2.0, 3.0]
    assert [e for *_, e in torque] == [1.0, 3.0]


def test_rows_without_a_time_column_follow_each_other_by_the_period(tmp_path):
    _, voltage, _ = convert(tmp_path, LOG, 'sample_period_s=0.005', 'voltage=u_V', 'torque=i_A')
    assert [t for t, *_ in voltage] == [0, 5, 10]


def test_times_that_do_not_increase_are_left_out_and_counted(tmp_path):
    text = 't,u,m\n0,1,1\n0.002,2,2\n0.002,3,3\n0.001,4,4\nnan,5,5\n0.003,6,6\n'
    summary, voltage, _ = convert(tmp_path, text, 'time=t', 'voltage=u', 'torque=m')
    assert [e for *_, e in voltage] == [1.0, 2.0, 6.0]
    assert summary.unordered_rows == 3
    assert '3 not later than the row before' in str(summary)


def test_values_that_are_not_finite_are_kept_for_the_observer_to_reject_and_counted(tmp_path):
    summary, _, torque = convert(
        tmp_path, 't,u,m\n0,1,1\n1,2,nan\n2,3,0\n', 'time=t', 'voltage=u', 'torque=1/m'
    )
    assert math.isnan(torque[1][2]) and torque[2][2] == math.inf
    assert summary.non_finite_rows == 2


@pytest.mark.parametrize('separator', [',', ';', '\t', '  '])
@pytest.mark.parametrize('ending', ['\n', '\r\n'])
def test_separators_and_line_ends_are_found_out(tmp_path, separator, ending):
    text = '\ufeff' + ending.join(
        separator.join(cells) for cells in (['t', 'u', 'm'], ['0', '1', '2'], ['1', '3', '4'])
    )
    _, voltage, torque = convert(tmp_path, text, 'time=t', 'voltage=u', 'torque=m')
    assert [e for *_, e in voltage] == [1.0, 3.0]
    assert [e for *_, e in torque] == [2.0, 4.0]


def test_a_name_with_odd_signs_is_a_column_when_it_stands_alone(tmp_path):
    text = 'Time [s],Voltage (V),M-1\n0,1,2\n1,3,4\n'
    _, voltage, torque = convert(
        tmp_path, text, 'time=Time [s]', 'voltage=Voltage (V)', 'torque=$3*2'
    )
    assert [e for *_, e in voltage] == [1.0, 3.0]
    assert [e for *_, e in torque] == [4.0, 8.0]


@pytest.mark.parametrize(
    ('text', 'options', 'message'),
    [
        (LOG, ['voltage=volts', 'torque=i_A'], "no column 'volts'.*there are: t_s, u_V, i_A, w"),
        (LOG, ['voltage=$9', 'torque=i_A'], 'no column 9 .*there are 4'),
        ('0 1 2\n1 2 3\n', ['voltage=u', 'torque=$3'], r"no column 'u'.*\$1 to \$3, without names"),
        (
            't,u,m\n0,1,2\n1,x,2\n',
            ['voltage=u', 'torque=m'],
            r"line 3, column 2 \(u\): 'x' is no number",
        ),
        (
            't,u,m\n0,1,2\n1,,2\n',
            ['voltage=u', 'torque=m'],
            r"line 3, column 2 \(u\): '' is no number",
        ),
        ('t,u,m\n0,1,2\n1\n', ['voltage=u', 'torque=m'], 'line 3: 1 cells, but the header has 3'),
        ('', ['voltage=u', 'torque=m'], 'holds no rows'),
        ('t,u,m\n', ['voltage=u', 'torque=m'], 'a header but no rows'),
        (
            't,u,m\n0,1,2\n1,2,3,4\n',
            ['voltage=u', 'torque=m'],
            "line 3: 4 cells, but the header has 3: '1,2,3,4'",
        ),
        (
            't,u,m\n0,1,2\n1,2\n',
            ['voltage=t', 'torque=u'],
            "line 3: 2 cells, but the header has 3: '1,2'",
        ),
        ('0 1 2\n1 2\n', ['voltage=$1', 'torque=$2'], 'line 2: 2 cells, but the first row has 3'),
        (
            't,u,m\n0,01,1,5,2,5\n',
            ['voltage=u', 'torque=m'],
            '6 cells, .*numbers need a decimal point',
        ),
        (
            't;u;m\n0;1,5;2\n1;1.5;2\n',
            ['voltage=u', 'torque=m'],
            r'with a comma \(line 2\) and with a point \(line 3\)',
        ),
        ('t,u,m\n0,"1,5",2\n', ['voltage=u', 'torque=m'], "'1,5' is no number; write a dec"),
        ('t,u,m\n0,1,2\n', ['voltage=2', 'torque=m'], r'voltage=2 names no column: write .*=\$2'),
        ('t,u,m\n0,1,2\n', ['voltage=u', 'torque=3*2'], r'torque=3\*2 names no column'),
        ('t,u,m\n0,1,2\n', ['voltage=u[mA]', 'torque=m'], r'voltage=u\[mA\] has the unit of a cur'),
        ('t;u;m\n0;1.234,5;2\n', ['voltage=u', 'torque=m'], r"'1\.234,5' is no number"),
        ('t,u,m\n0,"1,234.5",2\n', ['voltage=u', 'torque=m'], r"'1,234\.5' is no number"),
        ("t,u,m\n0,1'234,2\n", ['voltage=u', 'torque=m'], 'is no number'),
        ('t;u;m\n0;1 234;2\n', ['voltage=u', 'torque=m'], "'1 234' is no number"),
        (
            't,u,m\n0;1;2\n',
            ['voltage=u', 'torque=m'],
            "1 cells, .*';' seems to be between them, but ','",
        ),
        (
            't,u,u\n0,1,2\n',
            ['voltage=u', 'torque=t'],
            r"the header has 2 columns 'u' .*: write \$2 or \$3",
        ),
        (
            't,u,m\n0,1_2,2\n',
            ['voltage=u', 'torque=m'],
            r"line 2, column 2 \(u\): '1_2' is no number",
        ),
        ('t,u,m\n0,\uff11,2\n', ['voltage=u', 'torque=m'], 'is no number'),
        ('t,u,m\n0,0x10,2\n', ['voltage=u', 'torque=m'], "'0x10' is no number"),
        ('t,u,m\n0,0b1,2\n', ['voltage=u', 'torque=m'], "'0b1' is no number"),
        ('t,u,m\n0,1e5f,2\n', ['voltage=u', 'torque=m'], "'1e5f' is no number"),
        (
            't,u,m\ns,V,N m\n0,1,2\n',
            ['voltage=u', 'torque=m'],
            r"line 2: \['V', 'N m'\] are no numbers; put '#'",
        ),
        (
            't,u,m\n0,"1\n",2\n',
            ['voltage=u', 'torque=m'],
            'line 2: a quoted cell that does not end on its line',
        ),
        (
            't,u,m\n0,1,2\n,,\n',
            ['voltage=u', 'torque=m'],
            r"line 3, column 2 \(u\): '' is no number",
        ),
        ('x.0,1,2\n1,2,3\n', ['voltage=u', 'torque=$3'], "no column 'u'"),
        (LOG, ['voltage=u_V*1_2', 'torque=i_A'], "'1_2' is no number"),
        (LOG, ['voltage=u_V*0x10', 'torque=i_A'], "'0x10' is no number"),
        (
            LOG,
            ['voltage=' + '-' * 990 + 'u_V', 'torque=i_A'],
            'more than 100 operations within each other',
        ),
        (
            LOG,
            ['voltage=' + '(' * 450 + 'w' + ')' * 450, 'torque=i_A'],
            'is no arithmetic expression',
        ),
        (LOG, ['voltage=u_V*1e400', 'torque=i_A'], 'a number that is too large'),
        ('t,u,m\n' + '0' * (1 << 21), ['voltage=u', 'torque=m'], 'line 2: longer than'),
        (
            LOG,
            ['voltage=u_V', 'torque=i_A', 'where=w>99'],
            r'none of 3 rows can be used \(3 filtered\)',
        ),
    ],
)
def test_a_log_that_cannot_be_used_is_one_clear_line_and_writes_nothing(
    tmp_path, text, options, message
):
    log = tmp_path / 'log.csv'
    log.write_text(text, encoding='utf-8')
    with pytest.raises(BagError, match=message) as caught:
        csv_to_bag(log, tmp_path / 'bag', CsvMapping.from_options(['sample_period_s=1', *options]))
    assert '\n' not in str(caught.value)
    assert not (tmp_path / 'bag').exists()


def warnings(tmp_path, text, *options):
    return [
        line.replace(f'{tmp_path}/', '') for line in convert(tmp_path, text, *options)[0].warnings
    ]


def test_a_good_log_gives_no_warning(tmp_path):
    assert (
        warnings(
            tmp_path,
            LOG,
            'time=t_s',
            'voltage=u_V',
            'current=i_A',
            'torque_constant=0.1',
            'speed=w',
        )
        == []
    )


def test_time_that_falls_or_stands_still_is_named(tmp_path):
    text = '# by a robot\nt,u,m\n0,1,1\n0.01,2,2\n0.005,2,2\n0.01,3,3\n0.02,4,4\n'
    assert warnings(tmp_path, text, 'time=t', 'voltage=u', 'torque=m') == [
        'log.csv: line 5, time (t) falls: 0.005 s after 0.01 s; '
        '2 rows that are not later than those before are left out'
    ]


@pytest.mark.parametrize(
    ('step', 'remedy'),
    [
        ('10', r'in ms, write time=t\[ms\]'),
        ('10000', r'in us, write time=t\[us\]'),
        ('10000000', r'time=t\[ns\]'),
        ('0.00001', r'time=\(t\)\*1000'),
    ],
)
def test_samples_that_no_motor_would_give_are_named_with_their_interval(tmp_path, step, remedy):
    text = 't,u,m\n' + ''.join(f'{k * float(step):.9g},1,2\n' for k in range(5))
    (warning,) = warnings(tmp_path, text, 'time=t', 'voltage=u', 'torque=m')
    assert f'log.csv: samples are {float(step):.3g} s apart' in warning
    assert re.search(remedy, warning)


def test_a_column_named_in_another_unit_is_named_with_the_factor(tmp_path):
    text = 't_ms,u [mV],i_mA\n0,1,1\n0.01,2,2\n0.02,2,2\n'
    found = warnings(
        tmp_path, text, 'time=t_ms', 'voltage=u [mV]', 'current=i_mA', 'torque_constant=1'
    )
    assert [line.partition(' if')[0] for line in found] == [
        "log.csv: time is in s, but column 't_ms' says ms; write such as time=t_ms[ms]",
        "log.csv: voltage is in V, but column 'u [mV]' says mV; write such as voltage='u [mV]'[mV]",
        "log.csv: current is in A, but column 'i_mA' says mA; write such as current=i_mA[mA]",
    ]
    scaled = tmp_path / 'scaled'
    scaled.mkdir()
    options = ('time=t_ms*1', "voltage='u [mV]'[mV]", 'current=i_mA[mA]', 'torque_constant=1')
    assert warnings(scaled, text, *options) == []


def test_values_that_are_not_finite_are_named(tmp_path):
    text = 't,u,m\n0,1,1\n0.01,nan,2\n0.02,2,-inf\n0.03,1e400,1\n'
    assert warnings(tmp_path, text, 'time=t', 'voltage=u', 'torque=m') == [
        'log.csv: line 3: voltage of motor is nan there and not finite in 2 rows; the observer '
        'refuses these samples',
        'log.csv: line 4: torque of motor is -inf there and not finite in 1 rows; the observer '
        'refuses these samples',
    ]


def test_a_header_with_a_number_and_a_separator_behind_the_last_cell_are_named(tmp_path):
    text = '0.0,u,m\n0,1,1,\n0.01,2,2,\n'
    assert warnings(tmp_path, text, 'time=$1', 'voltage=u', 'torque=m') == [
        "log.csv, line 1 is taken for the names of the columns, although '0.0' is a number in it",
        'log.csv, line 2: a separator behind the last cell is passed over, in 2 rows',
    ]


def test_quoted_cells_and_comments_behind_a_row_are_read(tmp_path):
    text = '"t","u, V","m"\n"0","1","2"\n0.01,3,4 # a note, with a comma\n'
    _, voltage, torque = convert(tmp_path, text, 'time=t', 'voltage=u, V', 'torque=m')
    assert [e for *_, e in voltage] == [1.0, 3.0]
    assert [e for *_, e in torque] == [2.0, 4.0]


@pytest.mark.parametrize('kind', ['missing', 'pipe', 'folder', 'device', 'utf-16'])
def test_a_log_that_is_no_text_file_is_one_clear_line(tmp_path, kind):
    log = tmp_path / 'log.csv'
    if kind == 'pipe':
        os.mkfifo(log)
    elif kind == 'folder':
        log.mkdir()
    elif kind == 'device':
        log.symlink_to('/dev/zero')
    elif kind == 'utf-16':
        log.write_text(LOG, encoding='utf-16')
    with pytest.raises(BagError, match=r'log.csv.*(cannot be read|is no text)') as caught:
        csv_to_bag(
            log, tmp_path / 'bag', CsvMapping.from_options(['time=t', 'voltage=u', 'torque=m'])
        )
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['voltage'], 'is no mapping'),
        (['voltage=u', 'voltage=v'], 'mapped twice'),
        (['volts=u'], "'volts' is no key.*voltage"),
        (['voltage=u', 'torque=m'], 'time=COLUMN'),
        (['time=t', 'sample_period_s=1', 'voltage=u', 'torque=m'], 'either'),
        (['time=t'], 'no motor'),
        (['time=t', 'torque=m'], 'motor motor: no column for the voltage'),
        (['time=t', 'voltage=u'], 'either a torque'),
        (['time=t', 'voltage=u', 'torque=m', 'current=i'], 'either a torque'),
        (['time=t', 'voltage=u', 'current=i'], 'torque_constant is None'),
        (['time=t', 'voltage=u', 'current=i', 'torque_constant=-1'], 'torque_constant is -1.0'),
        (
            ['time=t', 'voltage=u', 'current=i', 'torque_constant=k'],
            "torque_constant is 'k', expected a number",
        ),
        (['time=t', 'voltage=u', 'torque=m', 'voltage_applies=now'], 'voltage_applies'),
        (
            ['time=t', 'voltage=u', 'current=i', 'torque_constant=1_0'],
            "torque_constant is '1_0', expected a number",
        ),
        (
            ['time=t', 'voltage=u', 'torque=m', 'first_stamp_ns=1' + '0' * 29],
            'first_stamp_ns is 10+, expected 0 to',
        ),
        (['time=t', 'voltage=u', 'torque=m', 'first_stamp_ns=-1'], 'first_stamp_ns is -1'),
        (
            ['time=t', 'voltage=u', 'torque=m', 'first_stamp_ns=inf'],
            "first_stamp_ns is 'inf', expected a number",
        ),
        (['sample_period_s=nan', 'voltage=u', 'torque=m'], 'sample_period_s is nan'),
    ],
)
def test_a_mapping_that_cannot_be_meant_is_refused(options, message):
    with pytest.raises(BagError, match=message):
        CsvMapping.from_options(options)


def test_a_yaml_file_maps_like_the_command_line(tmp_path):
    path = tmp_path / 'mapping.yaml'
    path.write_text(
        'time: $1\nmotors:\n  left: {voltage: $2, current: i_A, torque_constant: 0.1}\n'
    )
    mapping = CsvMapping.from_yaml(path)
    assert mapping == CsvMapping(
        {'left': MotorColumns('$2', current='i_A', torque_constant=0.1)}, time='$1'
    )
    assert mapping == CsvMapping.from_options(
        ['time=$1', 'left.voltage=$2', 'left.current=i_A', 'left.torque_constant=0.1']
    )


@pytest.mark.parametrize('text', ['', 'a: [', '- 1', 'motors: 3', 'motors: {m: 3}', 'tiem: 1'])
def test_a_yaml_file_that_is_no_mapping_is_one_clear_line(tmp_path, text):
    path = tmp_path / 'mapping.yaml'
    path.write_text(text)
    with pytest.raises(BagError) as caught:
        CsvMapping.from_yaml(path)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    'text',
    [
        'motors: {left: {voltage: $2}}\nleft.voltage: $3',
        'left.voltage: $3\nmotors: {left: {voltage: $2}}',
        'motors: {a.b: {voltage: $2}, a: {b.voltage: $3}}',
        'motor: left\nvoltage: $2\nmotors: {left: {voltage: $3}}',
    ],
)
def test_a_column_that_a_yaml_file_maps_twice_is_refused_by_file_and_key(tmp_path, text):
    path = tmp_path / 'mapping.yaml'
    path.write_text(f'time: $1\n{text}\n')
    with pytest.raises(BagError, match=r'voltage( of motor left)? is mapped twice') as caught:
        CsvMapping.from_yaml(path)
    assert str(caught.value).startswith(f'{path}: ')


def test_decimal_commas_are_read_and_told(tmp_path):
    text = 'Zeit [s];u:1;m\n0,000;-1,5;2\n0,010;2;,25\n0,020;1e1;3,5e-1\n'
    summary, voltage, torque = convert(
        tmp_path, text, "time='Zeit [s]'", "voltage='u:1'", 'torque=m'
    )
    assert voltage == [(0, 'motor', -1.5), (10, 'motor', 2.0), (20, 'motor', 10.0)]
    assert [e for _, _, e in torque] == [2.0, 0.25, 0.35]
    assert summary.warnings[-1].endswith(
        'line 2, column 1 (Zeit [s]): a comma within a number is its decimal comma'
    )


@pytest.mark.parametrize(
    ('header', 'where'), [('t;u;m;x\n', 'line 4, column 3 (m)'), ('', 'line 3, column 3')]
)
def test_a_decimal_comma_is_told_by_line_and_column(tmp_path, header, where):
    text = f'{header}0;1;2;0,5\n1;2;3;1\n2;3;4,5;1\n'
    summary, _, _ = convert(tmp_path, text, 'time=$1', 'voltage=$2', 'torque=$3')
    warnings = [line for line in summary.warnings if 'decimal comma' in line]
    assert len(warnings) == 1
    assert f'log.csv, {where}: a comma within a number' in warnings[0]


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(
    ('first', 'second'),
    [('-1e308', '1e308'), ('0', '1e308'), ('0', '1e300'), ('1.7e18', '1.7000001e18')],
)
def test_times_that_no_message_can_tell_are_refused_by_line(tmp_path, first, second):
    with pytest.raises(BagError) as caught:
        convert(tmp_path, f't,u,m\n{first},1,2\n{second},2,3\n', *SIGNALS, 'speed=diff(u)')
    assert re.search(
        r'log.csv, line 3, time \(t\) is .* s in the first row; a stamp of so much later '
        'does not fit into a message$',
        str(caught.value),
    )


def test_times_in_ns_that_no_message_can_tell_are_refused_with_their_unit(tmp_path):
    rows = ''.join(f'{k}e6,{k},2\n' for k in range(2200))
    with pytest.raises(BagError, match=r'if the time is in ns, write time=t\[ns\]$'):
        convert(tmp_path, f't,u,m\n{rows}', *SIGNALS)


@pytest.mark.filterwarnings('error')
def test_giant_times_of_rows_that_are_left_out_pass_in_silence(tmp_path):
    text = 't,u,m\n-1e308,1,2\n1e308,2,3\n-1e308,3,4\n'
    with pytest.raises(BagError, match='line 3, time'):
        convert(tmp_path, text, *SIGNALS, 'speed=diff(u)')
    summary, _, _ = convert(tmp_path, text.replace('-1e308,1,2\n', ''), *SIGNALS, 'speed=diff(u)')
    assert (summary.rows, summary.unordered_rows) == (2, 1)


@pytest.mark.parametrize('text', ['0,00;1,5;2\n0,01;2,5;3\n', '0,00\t1,5\t2\n0,01\t2,5\t3\n'])
def test_decimal_commas_need_no_header(tmp_path, text):
    _, voltage, _ = convert(tmp_path, text, 'time=$1', 'voltage=$2', 'torque=$3')
    assert voltage == [(0, 'motor', 1.5), (10, 'motor', 2.5)]


def test_a_position_gives_the_speed_and_functions_do_what_they_say(tmp_path):
    text = 't,u,m,angle\n0,-2,1,0\n0.01,3,1,0.5\n0.03,-4,1,-0.5\n'
    _, voltage, torque = convert(
        tmp_path, text, 'time=t', 'voltage=abs(u)', 'torque=m*sign(u)', 'speed=diff(angle)'
    )
    assert [volts for _, _, volts in voltage] == [2.0, 3.0, 4.0]
    assert [e for _, _, e, _ in torque] == [1.0, -1.0], 'a rate of change needs two rows'
    assert [w for *_, w in torque] == pytest.approx([50.0, -50.0])


def test_the_steps_of_an_encoder_are_told_as_the_noise_of_its_speed(tmp_path):
    """Counted in 64ths of a turn, up to 40 rad/s at 100 Hz are up to five counts a row."""
    angles = np.cumsum(0.2 * (1.0 + np.sin(np.arange(400) * 0.05)))
    step = 2 * np.pi / 64
    counted = np.floor(angles / step) * step
    rows = [
        f'{k * 0.01:.2f},1,1,{fine:.9f},{coarse:.9f}'
        for k, (fine, coarse) in enumerate(zip(angles, counted, strict=True))
    ]
    text = 't,u,m,fine,coarse\n' + '\n'.join(rows) + '\n'
    options = ('time=t', 'voltage=u', 'torque=m')
    (warning,) = warnings(tmp_path, text, *options, 'speed=diff(coarse)')
    assert 'steps of 0.0982: its noise is about 4 rad/s' in warning
    in_turns = tmp_path / 'turns'
    in_turns.mkdir()
    (warning,) = warnings(in_turns, text, *options, 'speed=diff(coarse)*2*pi/64')
    assert 'steps of 0.0982: its noise is about 0.39 rad/s' in warning
    smooth = tmp_path / 'smooth'
    smooth.mkdir()
    assert warnings(smooth, text, *options, 'speed=diff(fine)') == []


def test_times_of_even_rows_that_are_rounded_are_warned_of(tmp_path):
    rows = ''.join(f'{round(k / 0.3)},{k % 7},0.5\n' for k in range(200))
    summary, _, _ = convert(
        tmp_path, 't_ms,u_V,i_A\n' + rows, 'time=t_ms[ms]', 'voltage=u_V', 'torque=i_A'
    )
    (warning,) = summary.warnings
    assert 'the time is rounded to 1 ms, though rows seem to come every 3.333' in warning
    assert 'write sample_period_s=0.003333' in warning


def test_rows_left_out_of_a_log_without_a_time_are_no_rounding(tmp_path):
    rows = ''.join(f'{k % 7},0.5,{int(not 60 <= k < 100)}\n' for k in range(200))
    options = ('sample_period_s=0.001', 'voltage=u_V', 'torque=i_A', 'where=ok==1')
    summary, _, _ = convert(tmp_path, 'u_V,i_A,ok\n' + rows, *options)
    assert summary.warnings == ()
