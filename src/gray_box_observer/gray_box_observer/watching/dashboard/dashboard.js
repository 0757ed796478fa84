'use strict';
// Draws what the server tells (watching/dashboard/page_feed.py). Text goes in as text, never as markup:
// plots get labels, in which the server has escaped what plotly.js would read as tags.
(() => {
  const SHOWN_S = 10; // of signals
  const KEPT = 1200; // points of a signal, estimates of a parameter
  const BAND = 3; // standard deviations
  const CONFIG = { displayModeBar: false, responsive: true };
  const byId = (name) => document.getElementById(name);
  const courses = new Map(); // by parameter: {plot, columns}
  let signals = {};
  let chosen = { observer: '', motor: '' };
  let events = null;
  let listed = '';

  function colour(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  }

  function layout(title, unit) {
    const axis = { gridcolor: colour('line'), linecolor: colour('line'), zeroline: false };
    return {
      title: { text: unit ? `${title} [${unit}]` : title, font: { size: 13 }, x: 0.02, y: 0.97 },
      margin: { l: 58, r: 12, t: 26, b: 30 },
      paper_bgcolor: 'rgba(0,0,0,0)',
      plot_bgcolor: 'rgba(0,0,0,0)',
      font: { color: colour('ink'), size: 11 },
      showlegend: title === 'torque',
      legend: { orientation: 'h', x: 1, xanchor: 'right', y: 1.12 },
      xaxis: { ...axis, ticksuffix: ' s' },
      yaxis: axis,
    };
  }

  function line(name, columns, key, width = 1.5) {
    return { name, x: columns[0], y: columns[1], mode: 'lines', type: 'scatter', line: { color: colour(key), width, shape: 'linear' } };
  }

  function append(columns, added) {
    const restarts = added[0].length && columns[0].length && added[0][0] <= columns[0][columns[0].length - 1];
    return columns.map((column, k) => (restarts ? [...added[k]] : column.concat(added[k])).slice(-KEPT));
  }

  function drawCourse(parameter, added) {
    let entry = courses.get(parameter.name);
    if (!entry) {
      const plot = document.createElement('div');
      plot.className = 'plot';
      byId('courses').append(plot);
      entry = { plot, columns: [[], [], []] };
      courses.set(parameter.name, entry);
    } else if (!added[0].length) {
      return;
    }
    entry.columns = append(entry.columns, added);
    const [times, values, stds] = entry.columns;
    const last = times[times.length - 1] || 0;
    const ago = times.map((time) => time - last);
    const side = (sign) => values.map((value, k) => (value === null || stds[k] === null ? null : value + sign * BAND * stds[k]));
    const band = { mode: 'lines', type: 'scatter', x: ago, line: { width: 0, color: colour('estimate') }, hoverinfo: 'skip' };
    // The band of the first guess is wide: the axis follows the newest half of the estimates.
    const recent = values.slice(-Math.max(5, Math.ceil(values.length / 2)));
    const spread = stds.slice(-recent.length);
    const low = Math.min(...recent.map((value, k) => value - BAND * spread[k]));
    const high = Math.max(...recent.map((value, k) => value + BAND * spread[k]));
    const form = layout(parameter.label, parameter.unit);
    if (Number.isFinite(low) && Number.isFinite(high)) {
      const margin = Math.max(0.1 * (high - low), 1e-3 * Math.abs(high), 1e-12);
      form.yaxis = { ...form.yaxis, range: [low - margin, high + margin] };
    }
    Plotly.react(entry.plot, [
      { ...band, y: side(-1) },
      { ...band, y: side(1), fill: 'tonexty', fillcolor: colour('estimate') + '33' },
      line(parameter.label, [ago, values], 'estimate', 2),
    ], form, CONFIG);
  }

  function drawSignals(told) {
    if (Object.values(told).every((added) => !added[0].length)) return; // a slow page would fall behind
    for (const [kind, added] of Object.entries(told)) {
      signals[kind] = append(signals[kind] || [[], []], added);
    }
    const { voltage = [[], []], torque = [[], []], predicted = [[], []], speed = [[], []] } = signals;
    const ends = Object.values(signals).map(([times]) => (times.length ? times[times.length - 1] : -Infinity));
    const end = Math.max(...ends);
    if (!Number.isFinite(end)) return;
    const ago = ([times, values]) => [times.map((time) => time - end), values];
    const measured = new Map(torque[0].map((time, k) => [time, torque[1][k]]));
    const pairs = predicted[0].map((time, k) => [time, measured.get(time), predicted[1][k]]).filter((row) => row[1] !== undefined && row[1] !== null && row[2] !== null);
    const residual = [pairs.map((row) => row[0]), pairs.map((row) => row[1] - row[2])];
    const react = (name, unit, traces) => {
      const form = layout(name, unit);
      form.xaxis = { ...form.xaxis, range: [-SHOWN_S, 0] };
      form.yaxis = { ...form.yaxis, tickformat: '.3~g' };
      Plotly.react(byId(name), traces, form, CONFIG);
    };
    const stepped = line('voltage', ago(voltage), 'measured');
    stepped.line.shape = 'hv'; // it holds until the next
    react('voltage', 'V', [stepped]);
    react('torque', 'N m', [line('measured', ago(torque), 'measured'), line('predicted', ago(predicted), 'predicted')]);
    react('residual', 'N m', [line('residual', ago(residual), 'estimate')]);
    byId('speed').hidden = speed[0].length === 0;
    if (speed[0].length) react('speed', 'rad/s', [line('speed', ago(speed), 'estimate')]);
  }

  function cell(text, verdict) {
    const entry = document.createElement('td');
    entry.textContent = text;
    if (verdict) entry.dataset.verdict = verdict.split(' ')[0];
    return entry;
  }

  function digits(number, count) {
    return number === null ? 'not known' : number.toPrecision(count);
  }

  function drawMotor(motor) {
    byId('advice').textContent = motor.advice || 'no diagnostics yet';
    byId('advice').dataset.level = motor.level;
    byId('parameters').replaceChildren(...motor.parameters.map((parameter) => {
      const row = document.createElement('tr');
      row.append(cell(parameter.name), cell(digits(parameter.value, 5)), cell(digits(parameter.std, 2)), cell(parameter.unit), cell(parameter.verdict, parameter.verdict));
      return row;
    }));
    byId('facts').replaceChildren(...motor.facts.flatMap(([key, value]) => {
      const term = document.createElement('dt');
      const text = document.createElement('dd');
      term.textContent = key;
      text.textContent = value;
      return [term, text];
    }));
    for (const [name, entry] of courses) {
      if (!motor.parameters.some((parameter) => parameter.name === name)) {
        Plotly.purge(entry.plot);
        entry.plot.remove();
        courses.delete(name);
      }
    }
  }

  function listMotors(observers, motor) {
    const rows = observers.flatMap((observer) => observer.motors.map((one) => ({ observer: observer.name, ...one })));
    const shown = motor ? JSON.stringify([motor.observer, motor.name]) : '';
    const text = JSON.stringify([rows, shown]);
    if (text === listed) return;
    listed = text;
    byId('motors').replaceChildren(...rows.map((one) => {
      const option = document.createElement('option');
      option.value = JSON.stringify([one.observer, one.name]);
      const mark = one.identified ? '✓ ' : one.level === 'ok' || one.level === '' ? '' : '! ';
      option.textContent = `${mark}${one.name} (${one.observer})`;
      option.selected = option.value === shown;
      return option;
    }));
  }

  function forget() {
    signals = {};
    for (const entry of courses.values()) {
      Plotly.purge(entry.plot);
      entry.plot.remove();
    }
    courses.clear();
  }

  function take(told) {
    if (told.begins) forget();
    const silent = told.observers.find((observer) => told.motor && observer.name === told.motor.observer && observer.silent_s !== null);
    byId('connection').textContent = silent ? `the observer is silent for ${silent.silent_s.toFixed(0)} s` : 'live';
    listMotors(told.observers, told.motor);
    if (!told.motor) return;
    drawMotor(told.motor);
    const count = courses.size;
    for (const parameter of told.motor.parameters) drawCourse(parameter, told.courses[parameter.name]);
    if (courses.size !== count) {
      for (const entry of courses.values()) Plotly.Plots.resize(entry.plot); // they share the width
    }
    drawSignals(told.signals);
    document.body.dataset.updates = Number(document.body.dataset.updates || 0) + 1;
  }

  function connect() {
    if (events) events.close();
    forget();
    events = new EventSource(`/events?${new URLSearchParams(chosen)}`);
    events.onmessage = (message) => take(JSON.parse(message.data));
    events.onerror = () => {
      byId('connection').textContent = 'not connected';
      if (events.readyState === EventSource.CLOSED) setTimeout(connect, 5000); // refused: too many pages
    };
  }

  byId('motors').addEventListener('change', () => {
    const [observer, motor] = JSON.parse(byId('motors').value);
    chosen = { observer, motor };
    connect();
  });
  connect();
})();
