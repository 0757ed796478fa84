'use strict';
// Draws the figures of the report. Their form is described in report/drawing.py.
(() => {
  const figures = JSON.parse(document.getElementById('figures').textContent);
  const plots = [...document.querySelectorAll('.drawing')];
  const chosen = {}; // by figure: the pressed view of each group
  const config = {
    responsive: true,
    displaylogo: false,
    displayModeBar: 'hover',
    modeBarButtons: [['resetScale2d', 'toImage']], // dragging zooms, shift and dragging pans
  };
  const root = document.documentElement;
  let linking = false;

  // '@name' under a key that ends in 'color' is a colour of the style sheet.
  function painted(node, palette, key = '') {
    if (Array.isArray(node)) {
      return key === '' || key === 'shapes' || /color$/.test(key) ? node.map((entry) => painted(entry, palette, key || 'trace')) : node;
    }
    if (node !== null && typeof node === 'object') {
      return Object.fromEntries(Object.entries(node).map(([name, entry]) => [name, painted(entry, palette, name)]));
    }
    if (typeof node === 'string' && node[0] === '@' && /color$/.test(key)) {
      return palette.getPropertyValue('--' + node.slice(1)).trim();
    }
    return node;
  }

  // Returns a copy of the layout with the overrides of a view; a range of null means: fit everything.
  function overridden(layout, changes) {
    for (const [path, value] of Object.entries(changes)) {
      const names = path.split('.');
      const last = names.pop();
      let place = layout;
      for (const name of names) {
        place = place[name];
      }
      if (last === 'range') {
        place.autorange = value === null;
      }
      if (value === null) {
        delete place[last];
      } else {
        place[last] = value;
      }
    }
    return layout;
  }

  // Draws a figure with its pressed views, over the time range given (else over the whole run).
  function draw(plot, range) {
    const figure = figures[plot.id];
    const palette = getComputedStyle(root);
    const data = painted(figure.data, palette);
    const layout = structuredClone(painted(figure.layout, palette));
    for (const view of chosen[plot.id]) {
      overridden(layout, view.layout);
      for (const index of view.absolute ?? []) {
        data[index].y = data[index].y.map((value) => (value === null ? null : Math.abs(value)));
      }
      for (const [index, floor] of Object.entries(view.floor ?? {})) {
        data[index].y = data[index].y.map((value) => (value === null ? null : Math.max(value, floor)));
      }
    }
    if (range) {
      layout.xaxis.range = [...range];
    }
    if (root.classList.contains('paper')) {
      // A sheet has a width of its own: page.css sets it, and two parameters share a row.
      layout.width = plot.closest('.grid') ? 310 : 655;
      layout.height = 0.75 * layout.height;
      layout.font.size = 10;
    }
    return Plotly.react(plot, data, layout, config);
  }

  // A view of the value axes keeps the time range on the screen; a view of the time is passed on to all figures.
  function show(plot, group, view) {
    const range = view.layout['xaxis.range'];
    chosen[plot.id][group] = view;
    if (range) {
      Plotly.relayout(plot, { 'xaxis.range': [...range] });
    } else {
      draw(plot, plot.layout.xaxis.range);
    }
  }

  // Marks the button of the time range on the screen, or none after a zoom by hand.
  function markTime(plot) {
    const [start, end] = plot.layout.xaxis.range;
    for (const button of document.querySelectorAll(`.views[data-for="${plot.id}"] button[data-start]`)) {
      const pressed = Number(button.dataset.start) === start && Number(button.dataset.end) === end;
      button.setAttribute('aria-pressed', String(pressed));
    }
  }

  function addButtons(plot) {
    const holder = document.querySelector(`.views[data-for="${plot.id}"]`);
    figures[plot.id].views.forEach((group, number) => {
      const bar = document.createElement('div');
      group.forEach((view, position) => {
        const button = document.createElement('button');
        button.type = 'button';
        button.textContent = view.label;
        button.setAttribute('aria-pressed', String(position === 0));
        if ('xaxis.range' in view.layout) {
          [button.dataset.start, button.dataset.end] = view.layout['xaxis.range'];
        }
        button.addEventListener('click', () => {
          for (const other of bar.children) {
            other.setAttribute('aria-pressed', String(other === button));
          }
          show(plot, number, view);
        });
        bar.append(button);
      });
      holder.append(bar);
    });
  }

  // The figures of a motor share their time axis: zooming one zooms them all.
  function link(plot) {
    if (plot.classList.contains('apart')) {
      return;
    }
    const motor = plot.closest('.motor');
    plot.on('plotly_relayout', (change) => {
      if (!Object.keys(change).some((key) => key.startsWith('xaxis.'))) {
        return;
      }
      markTime(plot);
      if (linking) {
        return;
      }
      linking = true;
      const range = plot.layout.xaxis.range;
      const others = [...motor.querySelectorAll('.drawing:not(.apart)')].filter((other) => other !== plot && other.layout);
      Promise.all(others.map((other) => Plotly.relayout(other, { 'xaxis.range': [...range] }))).finally(() => {
        linking = false;
      });
    });
  }

  function repaint() {
    for (const plot of plots.filter((drawn) => drawn.layout)) {
      draw(plot, plot.layout.xaxis.range);
    }
  }

  // One figure a turn, so that the page answers while many motors are drawn.
  function drawFrom(number) {
    if (number === plots.length) {
      root.dataset.figures = 'drawn';
      return;
    }
    const plot = plots[number];
    chosen[plot.id] = figures[plot.id].views.map((group) => group[0]);
    draw(plot).then(() => {
      addButtons(plot);
      link(plot);
      setTimeout(drawFrom, 0, number + 1);
    });
  }

  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', repaint);
  for (const [event, printing] of [['beforeprint', true], ['afterprint', false]]) {
    addEventListener(event, () => {
      root.classList.toggle('paper', printing);
      repaint();
    });
  }
  drawFrom(0);
})();
