// The plotting program and each plot's data are packed; they are unpacked and drawn when the page is opened.
const nonce = document.currentScript.nonce;  // without it the page's policy runs no program
const unpacked = async script => {
  const bytes = Uint8Array.from(atob(script.textContent), letter => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'))).text();
};
const dark = matchMedia('(prefers-color-scheme: dark)'), narrow = matchMedia('(max-width: 600px)');
const folds = document.querySelectorAll('details');
let unfold = () => [];  // unfolds all, and says what was folded
const shade = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// What was drawn for white paper, in the colours of the page and at its width.
const looked = text => {
  const figure = JSON.parse(dark.matches ? text.replaceAll('"#000000"', '"#e6edf3"') : text);
  const {layout} = figure, look = layout.template.layout;
  Object.assign(look, {paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)'});
  look.font = {...look.font, color: shade('--ink')};
  for (const menu of layout.updatemenus ?? []) Object.assign(menu, {
    bgcolor: shade('--box'), bordercolor: shade('--line'), font: {color: shade('--ink'), size: 11}});
  look.modebar = {bgcolor: 'rgba(0,0,0,0)', color: shade('--soft'), activecolor: shade('--ink')};
  for (const axis of ['xaxis', 'yaxis']) Object.assign(look[axis], {
    exponentformat: 'power', gridcolor: shade('--grid'), linecolor: shade('--grid'), zerolinecolor: shade('--line')});
  if (narrow.matches) {
    look.font.size = 10;
    layout.margin = {...look.margin, ...layout.margin, l: 44, r: 8};
    for (const name in layout) if (/^xaxis/.test(name)) {
      const {domain = [0, 1]} = layout[name];
      if (layout[name].type === 'category') layout[name].tickangle = -90;
      if (layout[name].type === 'log' && domain[1] - domain[0] < 0.5) layout[name].ticktext =
        layout[name].ticktext?.map((text, at) => Math.log10(layout[name].tickvals[at]) % 1 ? '' : text);
      layout[name].nticks = Math.max(2, Math.round(5 * (domain[1] - domain[0])));
    }
    for (const bars of figure.data) if (bars.type === 'bar' && bars.orientation !== 'h' && bars.x?.length > 4)
      delete bars.text;  // narrower than figures above them
    for (const {colorbar} of [...figure.data, layout.coloraxis ?? {}]) if (colorbar) colorbar.nticks = 4;
    for (const menu of layout.updatemenus ?? []) Object.assign(menu, {x: 0, xanchor: 'left'});
    if (layout.legend?.orientation === 'h') {
      const room = 20 * new Set(figure.data.filter(one => one.showlegend !== false).map(one => one.name)).size;
      layout.height = (layout.height ?? 450) + room;
      layout.margin.b = (layout.margin.b ?? 45) + room;
      layout.legend = {orientation: 'h', yref: 'container', y: 0, yanchor: 'bottom'};
    }
  }
  return figure;
};

const drawn = (async () => {
  const program = document.createElement('script');
  program.nonce = nonce;
  program.textContent = await unpacked(document.querySelector('script.program'));
  document.head.append(program);
  const plots = await Promise.all([...document.querySelectorAll('script.plot-data')].map(
    async script => [script.previousElementSibling, await unpacked(script)]));
  const draw = ([place, text]) => {
    const {data, layout, config} = looked(text);
    place.style.height = `${layout.height ?? 450}px`;
    return Plotly.react(place, data, layout, {...config, ...(narrow.matches && {displayModeBar: false})});
  };
  // What is folded has no width to be drawn at: it is drawn when it is unfolded.
  const drawOpen = within => Promise.all(
    plots.filter(([place]) => within.contains(place) && !place.closest('details:not([open])')).map(draw));
  for (const asked of [dark, narrow]) asked.addEventListener('change', () => drawOpen(document));
  for (const fold of folds) fold.addEventListener('toggle', () => fold.open && drawOpen(fold));
  unfold = () => {
    const closed = [...folds].filter(fold => !fold.open);
    closed.forEach(fold => { fold.open = true; drawOpen(fold); });
    return closed;
  };
  return drawOpen(document);
})();
