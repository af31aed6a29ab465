// `weft evaluate prediction`: error and calibration against segments ahead, and predicted shapes in 3D.
import { caseViewer, chooser, clickCases } from './cases';
import { chart, key, Plot } from './charts';
import type { PageData, PredictionData, StepResult } from './data';
import { fixed, h, label, section } from './dom';
import { predictionSeries, stepOptions } from './figures';

export function predictionPart(page: PageData, prediction: PredictionData): HTMLElement {
  const series = predictionSeries(prediction);
  const baselines = Object.entries(prediction.baselines ?? {}).map(([name, value]) => ({ name, value }));
  const figure = (title: string, value: 'mean_mm' | 'coverage_1sigma') => chart(title, (width) => stepOptions(series, width, value), { height: 260 });
  const errors = figure('Prediction error against segments ahead', 'mean_mm');
  const coverage = figure('Share of coordinates within one sigma', 'coverage_1sigma');
  const head = ['', 'n', 'Mean, mm', 'Median, mm', 'Mean σ, mm', 'Within 1 σ', 'Mean (error/σ)²', 'NLL per coordinate'];
  const figures = (row: Omit<StepResult, 'steps'>) =>
    [String(row.n ?? '–'), fixed(row.mean_mm, 2), fixed(row.median_mm, 2), fixed(row.sigma_mm, 2), fixed(row.coverage_1sigma, 3), fixed(row.nse, 2), fixed(row.nll, 2)];
  const named: Record<string, string> = { from_start: 'from the start', from_random: 'from a random segment', no_knowledge: 'without knowledge of the material' };
  return h('div', { class: 'figures', id: 'prediction' },
    section('prediction-steps', 'Prediction: error against segments ahead', 'Mean distance over all vertices, over held-out examples.',
      key(...series.map(({ name, colour }) => ({ text: `mean, ${name}`, colour, style: 'line' as const })), { text: 'median, from the start', colour: 'var(--c0)', style: 'dashed' }), errors.element),
    section('prediction-coverage', 'Is the predicted sigma right?', 'Share of coordinates within one σ of the recorded shape; 0.683 for a normal distribution (dashed).',
      key(...series.map(({ name, colour }) => ({ text: name, colour, style: 'line' as const }))), coverage.element),
    h('div', { class: 'wide' }, h('details', { id: 'prediction-numbers' }, h('summary', {}, 'Numbers by segments ahead'), h('div', { class: 'scroll', tabindex: 0 }, h('table', {},
      h('thead', {}, h('tr', {}, ...['', 'Ahead', ...head.slice(1)].map((text) => h('th', { scope: 'col' }, text)))),
      h('tbody', {}, ...series.flatMap(({ name, rows }) => rows.map((row) => h('tr', {}, h('td', {}, name), ...[String(row.steps), ...figures(row)].map((text) => h('td', {}, text)))))))))),
    h('div', { class: 'wide' }, section('prediction-table', 'Settled shapes', null, h('div', { class: 'scroll', tabindex: 0 }, h('table', {},
      h('thead', {}, h('tr', {}, ...head.map((text) => h('th', { scope: 'col' }, text)))),
      h('tbody', {}, ...Object.entries(prediction.settled ?? {}).map(([name, row]) => h('tr', {}, h('td', {}, named[name] ?? label(name)),
        ...figures(row).map((text) => h('td', {}, text)))),
        ...baselines.map(({ name, value }) => h('tr', {}, h('td', {}, `baseline: ${label(name).toLowerCase()}`), ...[String(value.n), fixed(value.mean_mm, 2), fixed(value.median_mm, 2), '', '', '', ''].map((text) => h('td', {}, text))))))))),
    casesPart(page, prediction));
}

/** Error against predicted sigma of every case; the first ones can be seen in 3D. */
function casesPart(page: PageData, { cases }: PredictionData): HTMLElement | null {
  if (!cases?.length) return null;
  const viewer = caseViewer(page, 'prediction', {
    goal: 'recorded shape', shape: 'predicted shape', distance: 'distance from the recorded shape',
    note: (i) => `Example ${cases[i].example}, ${cases[i].segments} segments ahead: predicted ${fixed(cases[i].error_mm)} mm off, σ ${fixed(cases[i].sigma_mm)} mm.`,
  });
  const shown = cases.slice(0, viewer?.count ?? 0);
  const rows = cases.map((one, index) => ({ ...one, index }));
  const top = 1.05 * Math.max(1, ...rows.flatMap((row) => [row.error_mm, row.sigma_mm]));
  const figure = chart('Error of the settled shape against predicted sigma', () => ({
    x: { domain: [0, top], label: 'predicted σ, mm', grid: true }, y: { domain: [0, top], label: 'error, mm', grid: true },
    marks: [
      Plot.line([[0, 0], [top, top]], { stroke: 'var(--muted)', strokeDasharray: '5,4' }),
      Plot.dot(rows, {
        x: 'sigma_mm', y: 'error_mm', r: 4, stroke: 'var(--c0)', fill: (row) => (row.index < shown.length ? 'var(--c0)' : 'none'), fillOpacity: 0.5,
        ariaLabel: (row) => (row.index < shown.length ? `case ${row.index}` : ''), title: (row) => `example ${row.example}: error ${fixed(row.error_mm)} mm, σ ${fixed(row.sigma_mm)} mm`,
      }),
    ],
  }), { height: 300 });
  const choice = chooser('prediction-case', 'Case', shown.map((one) => `example ${one.example}: ${fixed(one.error_mm)} mm`), (i) => viewer?.show(i));
  clickCases(figure.element, choice.go);
  if (viewer) queueMicrotask(() => choice.go(0));
  return h('div', { class: 'wide' }, section('prediction-cases', 'Cases', `Mean vertex distance of the settled shape against the mean predicted distance, from the start. ${viewer ? 'Click a filled point to see the case.' : 'Their shapes were not recorded.'}`,
    h('div', { class: 'beside' }, figure.element, viewer && h('div', {}, choice.element, viewer.element))));
}
