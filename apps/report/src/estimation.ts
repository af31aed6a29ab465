// `weft evaluate estimation`: the paper's Table 1 and Fig. 4, calibration, and the replayed manipulations in 3D.
import { chooser, clickCases, sequenceViewer } from './cases';
import { chart, key, materialChart, type Chart } from './charts';
import type { EstimationCase, EstimationData, PageData, PropertyResult, Spread } from './data';
import { fixed, h, label, section } from './dom';
import { calibrationOptions, coveragePoints, estimateOptions, estimateRows } from './figures';

/** The paper's Table 1. */
const kPaper: Record<string, { abs_error: Spread; width: Spread; failure_rate: number | null }> = {
  bend: { abs_error: { mean: 0.061, sd: 0.053, median: 0.044 }, width: { mean: 0.28, sd: 0.17, median: 0.27 }, failure_rate: 0.08 },
  friction: { abs_error: { mean: 0.043, sd: 0.034, median: 0.034 }, width: { mean: 0.29, sd: 0.17, median: 0.28 }, failure_rate: 0.02 },
  stretch: { abs_error: { mean: 0.049, sd: 0.033, median: 0.044 }, width: { mean: 0.28, sd: 0.17, median: 0.25 }, failure_rate: 0.02 },
  thickness: { abs_error: { mean: 0.044, sd: 0.032, median: 0.037 }, width: { mean: 0.25, sd: 0.16, median: 0.24 }, failure_rate: 0 },
};

export function estimationPart(page: PageData, estimation: EstimationData): HTMLElement {
  const cases = estimation.cases.filter((one): one is EstimationCase => !('failed' in one));
  const failed = estimation.cases.length - cases.length;
  const names = page.properties.filter((name) => name in estimation.properties);
  // Columns in the order of the paper's table.
  const columns = ['bend', 'friction', 'stretch', 'thickness'].filter((name) => names.includes(name));
  const spread = (s: Spread, digits: number) => `${fixed(s.mean, digits)} (${fixed(s.sd, digits)}), median ${fixed(s.median, digits)}`;
  const rows: [string, (p: { abs_error: Spread; width: Spread; failure_rate: number | null }) => string][] = [
    ['|c − q|', (p) => spread(p.abs_error, 3)], ['w', (p) => spread(p.width, 2)], ['Failures', (p) => (p.failure_rate === null ? '–' : `${fixed(100 * p.failure_rate, 0)} %`)]];
  const more: [string, (p: PropertyResult) => string][] = [
    ['Within a = 0.5, 0.8, 1', (p) => ['0.5', '0.8', '1'].map((a) => fixed(p.coverage[a], 2)).join(', ')], ['Interval score', (p) => fixed(p.interval_score, 3)]];
  const table = h('table', { id: 'table-1' },
    h('thead', {}, h('tr', {}, h('th', {}), h('th', {}), ...columns.map((name) => h('th', { scope: 'col' }, h('span', { class: 'chip' }, h('span', { class: 'swatch', style: `background:var(--${name})` }), label(name)))))),
    h('tbody', {}, ...rows.flatMap(([name, text]) => [
      h('tr', {}, h('th', { scope: 'row', rowspan: 2, class: 'text' }, name), h('td', { class: 'text' }, 'here'), ...columns.map((p) => h('td', { 'data-key': `${p} ${name}` }, text(estimation.properties[p])))),
      h('tr', {}, h('td', { class: 'text paper' }, 'paper'), ...columns.map((p) => h('td', { class: 'paper' }, text(kPaper[p]))))]),
      ...more.map(([name, text]) => h('tr', {}, h('th', { scope: 'row', class: 'text' }, name), h('td', { class: 'text' }, 'here'), ...columns.map((p) => h('td', { 'data-key': `${p} ${name}` }, text(estimation.properties[p])))))));

  const points = coveragePoints(estimation, cases.length ? names : []);
  const calibration = chart('Calibration: nominal against observed coverage', () => calibrationOptions(points, names), { height: 300 });

  const last = (one: EstimationCase) => one.knowledge[one.knowledge.length - 1] ?? { centre: [], width: [] };
  const charts = h('div', { class: 'small-multiples', id: 'fig-4' });
  let overSegments: Chart[] = [];
  const viewer = sequenceViewer(page, 'estimation', (segment) => {
    for (const one of overSegments) one.mark(segment);
  });
  const show = (i: number) => {
    const one = cases[i];
    overSegments = page.properties.map((name, p) => materialChart(name, one.knowledge, p, one.true_material[p], viewer ? { seek: viewer.seek } : {}));
    charts.replaceChildren(...page.properties.map((name, p) => h('div', {},
      h('h3', {}, h('span', { class: 'swatch', style: `background:var(--${name})` }), label(name),
        h('span', { class: 'sub' }, `${fixed(last(one).centre[p], 2)} ± ${fixed(last(one).width[p] / 2, 2)}, true ${fixed(one.true_material[p], 2)}`)),
      overSegments[p].element)));
    viewer?.show(estimation.cases.indexOf(one));
  };
  const choice = chooser('estimation-case', 'Case', cases.map((_, i) => `case ${i + 1}`), show);
  if (cases.length) queueMicrotask(() => choice.go(0));

  const overview = names.map((name) => {
    const p = page.properties.indexOf(name), colour = `var(--${name})`;
    const rows = estimateRows(cases, p);
    const figure = chart(`${name}: estimate after the last segment against the true value`, () => estimateOptions(rows, colour), { height: 190 }).element;
    clickCases(figure, (i) => {
      choice.go(i);
      choice.element.scrollIntoView({ behavior: 'smooth', block: 'start' });
    });
    return h('div', {}, h('h3', {}, h('span', { class: 'swatch', style: `background:${colour}` }), label(name)), figure);
  });
  const variants = Object.entries(estimation.columns ?? {}).flatMap(([source, methods]) => Object.entries(methods).map(([method, figures]) => ({ source, method, figures })));
  const comparison = variants.length < 2 ? null : h('div', { class: 'wide' }, section('estimation-columns', 'Methods and sources of cases', 'Median |c − q|, and in brackets the share of true values in the middle 80 % of the interval.',
    h('div', { class: 'scroll', tabindex: 0 }, h('table', {},
      h('thead', {}, h('tr', {}, ...['Cases', 'Method', 'n', ...columns.map(label)].map((text, i) => h('th', { scope: 'col', class: i < 2 ? 'text' : '' }, text)))),
      h('tbody', {}, ...variants.map(({ source, method, figures }) => h('tr', {}, ...[source, method, String(figures.n),
        ...columns.map((p) => `${fixed(figures.properties[p]?.abs_error.median, 3)} (${fixed(figures.properties[p]?.coverage['0.8'], 2)})`)].map((text, i) => h('td', { class: i < 2 ? 'text' : '' }, text)))))))));
  return h('div', { class: 'figures', id: 'estimation' },
    h('div', { class: 'wide' }, section('estimation-table', 'Estimation: results beside the paper’s (Table 1)', `Mean (standard deviation), median after the last segment; n = ${cases.length}${failed ? ` (${failed} failed)` : ''}, the paper n = 50. A failure is |c − q| > 0.1 with q outside [c − w/2, c + w/2].`, h('div', { class: 'scroll', tabindex: 0 }, table))),
    h('div', { class: 'wide' }, section('estimation-overview', 'All cases', 'Centre c and interval c ± w/2 after the last segment against the true value. Click a point to see the case below.', h('div', { class: 'small-multiples' }, ...overview))),
    h('div', { class: 'wide' }, section('estimation-cases', 'Estimates over segments (Fig. 4)', `Band c ± w/2, centre c, and the true value as a dotted line.${viewer ? ' Click in a figure to see the cloth after that segment.' : ' The shapes of the cases were not recorded, so there is nothing to see in 3D.'}`, cases.length ? choice.element : null, charts, viewer?.element)),
    comparison,
    section('calibration', 'Calibration', 'Share of true values inside the middle share a of the estimated interval. On the dashed line the interval is calibrated; below the line it is too narrow.',
      key(...names.map((name) => ({ text: name, colour: `var(--${name})` }))), calibration.element));
}
