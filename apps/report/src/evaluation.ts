// Pages of `weft evaluate`: the paper's Fig. 3, Table 1 and Fig. 4 and their like, for whichever results are there.
import { chart, key, materialChart, Plot, wholeTicks } from './charts';
import { gradient, niceCeiling } from './colours';
import { decode, decodeFaces, distancesMm, mean, type EstimationCase, type EstimationData, type PageData, type PlanningCase, type PlanningData, type PredictionData, type Spread } from './data';
import { fixed, h, label, section } from './dom';
import { provenanceDetails, tile, title } from './frame';
import { Viewer } from './viewer';

/** What the paper reports. */
const kPaper = {
  planningMedianMm: 6.9,
  estimation: {
    bend: { abs_error: { mean: 0.061, sd: 0.053, median: 0.044 }, width: { mean: 0.28, sd: 0.17, median: 0.27 }, failure_rate: 0.08 },
    friction: { abs_error: { mean: 0.043, sd: 0.034, median: 0.034 }, width: { mean: 0.29, sd: 0.17, median: 0.28 }, failure_rate: 0.02 },
    stretch: { abs_error: { mean: 0.049, sd: 0.033, median: 0.044 }, width: { mean: 0.28, sd: 0.17, median: 0.25 }, failure_rate: 0.02 },
    thickness: { abs_error: { mean: 0.044, sd: 0.032, median: 0.037 }, width: { mean: 0.25, sd: 0.16, median: 0.24 }, failure_rate: 0 },
  } as Record<string, { abs_error: Spread; width: Spread; failure_rate: number }>,
};

export function evaluationPage(page: PageData): HTMLElement {
  const { planning, estimation, prediction } = page;
  const kinds = [planning && 'planning', estimation && 'estimation', prediction && 'prediction'].filter(Boolean) as string[];
  return h('div', {},
    title(page, `Evaluation of ${kinds.join(', ').replace(/, ([^,]*)$/, ' and $1')}`, [page.garment?.name]),
    planning ? planningPart(page, planning) : null,
    estimation ? estimationPart(page, estimation) : null,
    prediction ? predictionPart(prediction) : null,
    h('div', { class: 'details' }, ...provenanceDetails(page)));
}

/** Choosing one of several things with a list and two buttons. */
export function chooser(id: string, name: string, entries: string[], choose: (i: number) => void) {
  const select = h('select', { id }, ...entries.map((text, i) => h('option', { value: i }, text)));
  const go = (i: number) => {
    select.value = String((i + entries.length) % entries.length);
    choose(Number(select.value));
  };
  select.addEventListener('change', () => choose(Number(select.value)));
  const element = h('div', { class: 'cases' }, h('label', { class: 'field' }, name, select),
    h('button', { onclick: () => go(Number(select.value) - 1), 'aria-label': `Previous ${name.toLowerCase()}`, id: `${id}-previous` }, '‹'),
    h('button', { onclick: () => go(Number(select.value) + 1), 'aria-label': `Next ${name.toLowerCase()}`, id: `${id}-next` }, '›'));
  return { element, go };
}

function planningPart(page: PageData, planning: PlanningData): HTMLElement {
  const widths = planning.by_width.filter((box) => box.n > 0);
  const solved = planning.cases.map((one, index) => ({ ...one, index })).filter((one): one is PlanningCase & { index: number; error_mm: number } => one.error_mm !== null);
  const failed = planning.cases.length - solved.length;
  const boxes = widths.map((box) => {
    const errors = solved.filter((one) => one.width === box.width).map((one) => one.error_mm);
    const reach = 1.5 * (box.q3_mm - box.q1_mm);
    const inside = errors.filter((error) => error >= box.q1_mm - reach && error <= box.q3_mm + reach);
    return { ...box, low: Math.min(...inside), high: Math.max(...inside), reach, count: box.outliers };
  });
  const ofWidth = new Map(boxes.map((box) => [box.width, box]));
  const isOutlier = (one: { width: number; error_mm: number }) => {
    const box = ofWidth.get(one.width);
    return box !== undefined && (one.error_mm < box.q1_mm - box.reach || one.error_mm > box.q3_mm + box.reach);
  };
  const whiskers = Math.max(...boxes.map((box) => box.high), kPaper.planningMedianMm);
  const all = Math.max(...solved.map((one) => one.error_mm), whiskers);
  const scaleBox = h('input', { type: 'checkbox', id: 'all-outliers' });
  scaleBox.addEventListener('change', () => figure.redraw());

  const figure = chart('Error after settling against the width of the material knowledge', () => {
    const top = scaleBox.checked ? 1.06 * all : 1.22 * whiskers;
    // Points are spread sideways by their index, so that they do not hide one another.
    const shift = (one: { index: number }) => (((one.index * 0.618034) % 1) - 0.5) * 16;
    return {
      marginTop: 22,
      x: { type: 'band', domain: widths.map((box) => box.width), label: 'w, width of the knowledge of every property', padding: 0.35 },
      y: { domain: [0, top], label: 'mm', grid: true },
      marks: [
        Plot.ruleY([kPaper.planningMedianMm], { stroke: 'var(--c2)', strokeDasharray: '6,4', strokeWidth: 1.5 }),
        Plot.ruleX(boxes, { x: 'width', y1: 'low', y2: 'high', stroke: 'var(--ink)' }),
        Plot.barY(boxes, { x: 'width', y1: 'q1_mm', y2: 'q3_mm', fill: 'var(--c0)', fillOpacity: 0.3, stroke: 'var(--c0)' }),
        Plot.tickY(boxes, { x: 'width', y: 'median_mm', stroke: 'var(--ink)', strokeWidth: 2.5 }),
        Plot.dot(boxes, { x: 'width', y: 'mean_mm', symbol: 'diamond', fill: 'var(--ink)', r: 3 }),
        ...widths.map((box) => {
          const rows = solved.filter((one) => one.width === box.width && one.error_mm <= top);
          return rows.map((one) => Plot.dot([one], { x: 'width', y: 'error_mm', dx: shift(one), r: isOutlier(one) ? 3.4 : 2.2, fill: isOutlier(one) ? 'var(--c1)' : 'var(--muted)', fillOpacity: isOutlier(one) ? 1 : 0.55, ariaLabel: () => `case ${one.index}`, title: (d: typeof one) => `case ${d.index + 1}, w = ${d.width}: ${fixed(d.error_mm)} mm` }));
        }).flat(),
        Plot.text(boxes.filter((box) => box.count > 0), { x: 'width', frameAnchor: 'top', dy: -14, text: (box) => `${box.count}`, fill: 'var(--c1)', fontWeight: 'bold' }),
      ],
    };
  }, { height: 360 });

  const caseBox = h('div', {});
  const chosen = planning.cases.map((one, i) => `${i + 1}: w = ${one.width}, ${one.error_mm === null ? 'failed' : `${fixed(one.error_mm)} mm`}`);
  const browser = caseViewer(page, 'planning', (i) => planning.cases[i].error_mm);
  const choice = chooser('case', 'Case', chosen, (i) => browser?.show(i));
  if (browser) {
    caseBox.append(choice.element, browser.element);
    figure.element.addEventListener('click', (event) => {
      const name = (event.target as Element).closest('[aria-label^="case "]')?.getAttribute('aria-label');
      if (name) {
        choice.go(Number(name.slice(5)));
        caseBox.scrollIntoView({ behavior: 'smooth', block: 'nearest' });
      }
    });
    queueMicrotask(() => choice.go(0));
  } else {
    caseBox.append(h('p', { class: 'note' }, 'The shapes of the cases were not recorded, so there is nothing to see in 3D.'));
  }
  const others = Object.entries(planning.columns ?? {});
  const head = ['w', 'n', 'Median, mm', 'Mean, mm', 'SD, mm', 'Quartiles, mm', 'Outliers'];
  const narrow = widths[0];
  return h('div', { id: 'planning' },
    narrow ? h('dl', { class: 'tiles' },
      tile(`Median error at w = ${narrow.width}`, 'median_mm', fixed(narrow.median_mm), 'mm'), tile('Mean error there', 'mean_mm', fixed(narrow.mean_mm), 'mm'),
      tile('The paper’s median at w = 0.1', 'paper_mm', fixed(kPaper.planningMedianMm), 'mm'), tile('Cases', 'cases', String(planning.cases.length), failed ? `${failed} failed` : '')) : null,
    h('div', { class: 'figures' },
      h('div', { class: 'wide' }, section('planning-figure', 'Planning: error against what is known of the material (the paper’s Fig. 3)',
        'Mean distance to the goal over all vertices, after settling. Boxes: quartiles and median; whiskers: farthest case within 1.5 times the box; diamonds: mean. Numbers at the top count the outliers, drawn in orange. Click a point to see the case.',
        key({ text: `the paper’s median at w = 0.1: ${kPaper.planningMedianMm} mm`, colour: 'var(--c2)', style: 'dashed' }),
        h('label', { class: 'check' }, scaleBox, 'fit the scale to all outliers'), figure.element,
        h('details', { id: 'planning-numbers' }, h('summary', {}, 'Numbers'), h('div', { class: 'scroll' }, h('table', {}, h('thead', {}, h('tr', {}, ...head.map((text) => h('th', { scope: 'col' }, text)))),
          h('tbody', {}, ...boxes.map((box) => h('tr', {}, ...[String(box.width), String(box.n), fixed(box.median_mm, 2), fixed(box.mean_mm, 2), fixed(box.sd_mm, 2), `${fixed(box.q1_mm, 2)} – ${fixed(box.q3_mm, 2)}`, String(box.count)].map((text) => h('td', {}, text)))))),
          others.length ? h('table', { id: 'planning-columns' }, h('caption', {}, 'Median error in mm (and cases) by where the goals come from.'),
            h('thead', {}, h('tr', {}, h('th', { scope: 'col' }, 'w'), ...[planning.goals ?? 'here', ...others.map(([source]) => source)].map((source) => h('th', { scope: 'col' }, source)))),
            h('tbody', {}, ...planning.by_width.map((box, i) => h('tr', {}, h('td', {}, String(box.width)), ...[box, ...others.map(([, column]) => column.by_width[i])].map((one) =>
              h('td', {}, one ? `${fixed(one.median_mm, 2)} (${one.n})` : '–')))))) : null)))),
      h('div', { class: 'wide' }, section('planning-case', 'One case', null, caseBox))));
}

/** Final shape against goal, in 3D. Null when no shapes were recorded. */
function caseViewer(page: PageData, name: string, errorOf: (i: number) => number | null) {
  const shapes = page.shapes?.[name], garment = page.garment;
  if (!shapes || !garment || shapes.offsets.length === 0) return null;
  const viewer = new Viewer(decodeFaces(garment.faces), garment.vertices, `${garment.name} after the fold`);
  Object.assign(window, { weft: { viewer } });
  const legend = h('div', { class: 'legend' });
  viewer.element.append(legend);
  const goalBox = h('input', { type: 'checkbox', checked: true, id: 'case-goal' });
  const colourBox = h('input', { type: 'checkbox', checked: true, id: 'case-colour' });
  const edgesBox = h('input', { type: 'checkbox', id: 'case-edges' });
  const note = h('p', { class: 'note', id: 'case-note' });
  let current = 0;
  let fitted = false;
  const update = () => {
    const goal = decode(shapes.goals[shapes.goal_of[current]]);
    const final = decode(shapes.offsets[current]);
    for (let i = 0; i < final.length; ++i) final[i] += goal[i];
    if (!fitted) viewer.fit([goal, final]);
    fitted = true;
    const distances = distancesMm(final, goal);
    const range = niceCeiling(Math.max(5, 2 * mean(distances)));
    viewer.setCloth(final);
    viewer.setOverlay('goal', goalBox.checked ? goal : null);
    viewer.setColours(colourBox.checked ? distances : null, range);
    viewer.setEdges(edgesBox.checked);
    legend.hidden = !colourBox.checked;
    legend.replaceChildren('distance to the goal, mm', h('div', { class: 'bar', style: `background:${gradient()}` }), h('div', { class: 'ends' }, h('span', {}, '0'), h('span', {}, `≥ ${range}`)));
    const error = errorOf(current);
    note.textContent = `Case ${current + 1}, goal ${shapes.goal_of[current] + 1}: ${error === null ? 'failed' : `${fixed(error)} mm from the goal`}.`;
  };
  for (const box of [goalBox, colourBox, edgesBox]) box.addEventListener('change', update);
  const element = h('div', {}, note, viewer.element, h('div', { class: 'transport' },
    h('label', { class: 'check' }, goalBox, h('span', { class: 'swatch', style: 'background:var(--goal)' }), 'goal'),
    h('label', { class: 'check' }, colourBox, 'colour by distance to the goal'), h('label', { class: 'check' }, edgesBox, 'mesh edges')));
  return {
    element,
    show(i: number) {
      current = i;
      update();
    },
  };
}

function estimationPart(page: PageData, estimation: EstimationData): HTMLElement {
  const cases = estimation.cases.filter((one): one is EstimationCase => !('failed' in one));
  const failed = estimation.cases.length - cases.length;
  const names = page.properties.filter((name) => name in estimation.properties);
  // Columns in the order of the paper's table.
  const columns = ['bend', 'friction', 'stretch', 'thickness'].filter((name) => names.includes(name));
  const spread = (s: Spread, digits: number) => `${fixed(s.mean, digits)} (${fixed(s.sd, digits)}), median ${fixed(s.median, digits)}`;
  const rows: [string, (p: { abs_error: Spread; width: Spread; failure_rate: number }) => string][] = [
    ['|c − q|', (p) => spread(p.abs_error, 3)], ['w', (p) => spread(p.width, 2)], ['Failures', (p) => `${fixed(100 * p.failure_rate, 0)} %`]];
  const table = h('table', { id: 'table-1' },
    h('caption', {}, `Mean (standard deviation), median after the last segment; n = ${cases.length}${failed ? ` (${failed} failed)` : ''}, the paper n = 50. A failure is |c − q| > 0.1 with q outside [c − w/2, c + w/2].`),
    h('thead', {}, h('tr', {}, h('th', {}), h('th', {}), ...columns.map((name) => h('th', { scope: 'col' }, h('span', { class: 'chip' }, h('span', { class: 'swatch', style: `background:var(--${name})` }), label(name)))))),
    h('tbody', {}, ...rows.flatMap(([name, text]) => [
      h('tr', {}, h('th', { scope: 'row', rowspan: 2, class: 'text' }, name), h('td', { class: 'text' }, 'here'), ...columns.map((p) => h('td', { 'data-key': `${p} ${name}` }, text(estimation.properties[p])))),
      h('tr', {}, h('td', { class: 'text paper' }, 'paper'), ...columns.map((p) => h('td', { class: 'paper' }, text(kPaper.estimation[p]))))]),
      h('tr', {}, h('th', { scope: 'row', class: 'text' }, 'Interval score'), h('td', { class: 'text' }, 'here'), ...columns.map((p) => h('td', {}, fixed(estimation.properties[p].interval_score, 3))))));

  const points = names.flatMap((name) => Object.entries(estimation.properties[name].coverage).map(([nominal, observed]) => ({ name, nominal: Number(nominal), observed })))
    .sort((a, b) => a.nominal - b.nominal);
  const calibration = chart('Calibration: nominal against observed coverage', () => ({
    x: { domain: [0, 1], label: 'nominal: share a of the width', ticks: 5 },
    y: { domain: [0, 1], label: 'observed', ticks: 5, grid: true },
    marks: [
      Plot.line([[0, 0], [1, 1]], { stroke: 'var(--muted)', strokeDasharray: '5,4' }),
      ...names.flatMap((name) => {
        const line = points.filter((point) => point.name === name);
        const shown = { x: 'nominal', y: 'observed' };
        return [Plot.line([{ nominal: 0, observed: 0 }, ...line], { ...shown, stroke: `var(--${name})`, strokeWidth: 2 }),
          Plot.dot(line, { ...shown, fill: `var(--${name})`, r: 4, symbol: (['circle', 'square', 'triangle', 'diamond'] as const)[names.indexOf(name)], title: (d) => `${name}: ${fixed(d.observed, 2)} of the true values in [c ± ${d.nominal} w/2]`, tip: true })];
      }),
    ],
  }), { height: 300 });

  const charts = h('div', { class: 'small-multiples', id: 'fig-4' });
  const show = (i: number) => {
    const one = cases[i];
    charts.replaceChildren(...page.properties.map((name, p) => h('div', {},
      h('h3', {}, h('span', { class: 'swatch', style: `background:var(--${name})` }), label(name),
        h('span', { class: 'sub' }, `${fixed(one.knowledge[one.knowledge.length - 1]?.centre[p], 2)} ± ${fixed((one.knowledge[one.knowledge.length - 1]?.width[p] ?? NaN) / 2, 2)}, true ${fixed(one.true_material[p], 2)}`)),
      materialChart(name, one.knowledge, p, one.true_material[p]).element)));
  };
  const choice = chooser('estimation-case', 'Case', cases.map((_, i) => `case ${i + 1}`), show);
  if (cases.length) show(0);
  const variants = Object.entries(estimation.columns ?? {}).flatMap(([source, methods]) => Object.entries(methods).map(([method, figures]) => ({ source, method, figures })));
  const comparison = variants.length < 2 ? null : h('div', { class: 'wide' }, section('estimation-columns', 'Methods and sources of cases', 'Median |c − q|, and in brackets the share of true values in the middle 80 % of the interval.',
    h('div', { class: 'scroll' }, h('table', {},
      h('thead', {}, h('tr', {}, ...['Cases', 'Method', 'n', ...columns.map(label)].map((text, i) => h('th', { scope: 'col', class: i < 2 ? 'text' : '' }, text)))),
      h('tbody', {}, ...variants.map(({ source, method, figures }) => h('tr', {}, ...[source, method, String(figures.n),
        ...columns.map((p) => `${fixed(figures.properties[p]?.abs_error.median, 3)} (${fixed(figures.properties[p]?.coverage['0.8'], 2)})`)].map((text, i) => h('td', { class: i < 2 ? 'text' : '' }, text)))))))));
  return h('div', { class: 'figures', id: 'estimation' },
    h('div', { class: 'wide' }, section('estimation-table', 'Estimation: results beside the paper’s (Table 1)', null, h('div', { class: 'scroll' }, table))),
    h('div', { class: 'wide' }, section('estimation-cases', 'Estimates over segments (Fig. 4)', 'Band c ± w/2, centre c, and the true value as a dotted line.', cases.length ? choice.element : null, charts)),
    comparison,
    section('calibration', 'Calibration', 'Share of true values inside the middle share a of the estimated interval. On the dashed line the interval claims what it holds; below it, it claims too much.',
      key(...names.map((name) => ({ text: name, colour: `var(--${name})` }))), calibration.element));
}

function predictionPart(prediction: PredictionData): HTMLElement {
  const series = [
    { name: 'from the start', rows: prediction.by_step, colour: 'var(--c0)' },
    { name: 'from a random segment', rows: prediction.by_step_from_random ?? [], colour: 'var(--c2)' },
    { name: 'without knowledge of the material', rows: prediction.by_step_no_knowledge ?? [], colour: 'var(--c3)' },
  ].filter((one) => one.rows.length > 0);
  const last = Math.max(1, ...series.flatMap((one) => one.rows.map((row) => row.steps)));
  const baselines = Object.entries(prediction.baselines ?? {}).map(([name, value]) => ({ name, value }));
  const figure = (title: string, label: string, value: 'mean_mm' | 'coverage_1sigma', digits: number, more: Plot.Markish[], y: object) => chart(title, (width) => ({
    x: { domain: [0, last], ticks: wholeTicks(0, last, width), tickFormat: 'd', label: 'segments ahead' },
    y: { label, grid: true, ...y },
    marks: [
      ...more,
      ...series.flatMap(({ name, rows, colour }) => [
        Plot.lineY(rows, { x: 'steps', y: value, stroke: colour, strokeWidth: 2.2 }),
        Plot.dot(rows, { x: 'steps', y: value, fill: colour, r: 2.6, tip: true, title: (row) => `${name}, ${row.steps} ahead: ${fixed(row[value], digits)}` }),
      ]),
    ],
  }), { height: 260 });
  const errors = figure('Prediction error against segments ahead', 'mm', 'mean_mm', 2, [
    Plot.lineY(prediction.by_step, { x: 'steps', y: 'median_mm', stroke: 'var(--c0)', strokeDasharray: '5,3' })], { zero: true, nice: true });
  const coverage = figure('Share of coordinates within one sigma', 'share', 'coverage_1sigma', 3, [
    Plot.ruleY([0.683], { stroke: 'var(--muted)', strokeDasharray: '5,4' })], { domain: [0, 1], ticks: 5 });
  const head = ['', 'n', 'Mean, mm', 'Median, mm', 'Mean σ, mm', 'Within 1 σ', 'Mean (error/σ)²', 'NLL per coordinate'];
  const named: Record<string, string> = { from_start: 'from the start', from_random: 'from a random segment', no_knowledge: 'without knowledge of the material' };
  return h('div', { class: 'figures', id: 'prediction' },
    section('prediction-steps', 'Prediction: error against segments ahead', 'Mean distance over all vertices, over held-out examples.',
      key(...series.map(({ name, colour }) => ({ text: `mean, ${name}`, colour, style: 'line' as const })), { text: 'median, from the start', colour: 'var(--c0)', style: 'dashed' }), errors.element),
    section('prediction-coverage', 'Is the predicted sigma right?', 'Share of coordinates within one σ of what happened; 0.683 for a normal distribution (dashed).',
      key(...series.map(({ name, colour }) => ({ text: name, colour, style: 'line' as const }))), coverage.element),
    h('div', { class: 'wide' }, section('prediction-table', 'Settled shapes', null, h('div', { class: 'scroll' }, h('table', {},
      h('thead', {}, h('tr', {}, ...head.map((text) => h('th', { scope: 'col' }, text)))),
      h('tbody', {}, ...Object.entries(prediction.settled ?? {}).map(([name, row]) => h('tr', {}, h('td', {}, named[name] ?? label(name)),
        ...[String(row.n ?? '–'), fixed(row.mean_mm, 2), fixed(row.median_mm, 2), fixed(row.sigma_mm, 2), fixed(row.coverage_1sigma, 3), fixed(row.nse, 2), fixed(row.nll, 2)].map((text) => h('td', {}, text)))),
        ...baselines.map(({ name, value }) => h('tr', {}, h('td', {}, `baseline: ${label(name).toLowerCase()}`), ...[String(value.n), fixed(value.mean_mm, 2), fixed(value.median_mm, 2), '', '', '', ''].map((text) => h('td', {}, text)))))))))); 
}
