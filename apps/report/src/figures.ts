// What the figures of evaluations and ablations show, apart from where they are shown: on the page, and in papers (paper.ts).
import { Plot, wholeTicks } from './charts';
import type { EstimationCase, EstimationData, PlanningCase, PlanningData, PredictionData, StepResult } from './data';
import { fixed, label } from './dom';

export const kPaperMedianMm = 6.9;  // Fig. 3 at w = 0.1

const kUnits: [RegExp, string][] = [[/_mm$/, 'mm'], [/_seconds$/, 's']];
export const unitOf = (metric: string) => kUnits.find(([ending]) => ending.test(metric))?.[1] ?? '';
export const nameOf = (metric: string) => label(kUnits.reduce((text, [ending]) => text.replace(ending, ''), metric).replace(/_(\d+)mm$/, ' within $1 mm'));

/** An arm of an ablation: a mean with its interval. */
export interface Interval { name: string; mean: number; low: number; high: number; colour: string; symbol: Plot.SymbolType; title?: string }
export const intervalOptions = (rows: Interval[], metric: string, zero: boolean, names: string[] = rows.map((row) => row.name)): Plot.PlotOptions => ({
  marginLeft: Math.min(190, 20 + 6.5 * Math.max(0, ...names.map((name) => name.length))), height: 60 + 26 * Math.max(1, rows.length),
  x: { label: unitOf(metric) || nameOf(metric), grid: true, nice: true, zero: true, ticks: 5, tickFormat: '~s' },
  y: { type: 'band', domain: rows.map((row) => row.name), label: null },
  marks: [
    ...(zero ? [Plot.ruleX([0], { stroke: 'var(--ink)' })] : []),
    Plot.ruleY(rows, { y: 'name', x1: 'low', x2: 'high', stroke: (row) => row.colour, strokeWidth: 3 }),
    ...rows.map((row) => Plot.dot([row], { y: 'name', x: 'mean', r: 5, fill: row.colour, symbol: row.symbol, title: 'title', tip: true })),
  ],
});

/** How many times smaller the medians of arms are than their baselines'. */
export const ratioOptions = (rows: Interval[], names: string[] = rows.map((row) => row.name)): Plot.PlotOptions => ({
  ...intervalOptions(rows, '', false, names),
  x: { label: 'median of the baseline / own median', type: 'log', grid: true, nice: true, ticks: 5, tickFormat: '~s' },
  marks: [Plot.ruleX([1], { stroke: 'var(--ink)' }), ...intervalOptions(rows, '', false, names).marks!],
});

/** Fig. 3: boxes of the error against the width of the knowledge, and every case as a point. */
export function planningBoxes(planning: PlanningData) {
  const widths = planning.by_width.filter((box) => box.n > 0);
  const solved = planning.cases.map((one, index) => ({ ...one, index })).filter((one): one is PlanningCase & { index: number; error_mm: number } => one.error_mm !== null);
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
  const whiskers = Math.max(...boxes.map((box) => box.high), kPaperMedianMm);
  return { widths, solved, boxes, isOutlier, whiskers, all: Math.max(...solved.map((one) => one.error_mm), whiskers) };
}
/** @param fit the scale reaches the farthest outlier. */
export function planningOptions({ widths, solved, boxes, isOutlier, whiskers, all }: ReturnType<typeof planningBoxes>, fit: boolean): Plot.PlotOptions {
  const top = fit ? 1.06 * all : 1.22 * whiskers;
  // Points are spread sideways by their index, so that they do not hide one another.
  const shift = (one: { index: number }) => (((one.index * 0.618034) % 1) - 0.5) * 16;
  return {
    marginTop: 22,
    x: { type: 'band', domain: widths.map((box) => box.width), label: 'w, width of the knowledge of every property', padding: 0.35 },
    y: { domain: [0, top], label: 'mm', grid: true },
    marks: [
      Plot.ruleY([kPaperMedianMm], { stroke: 'var(--c2)', strokeDasharray: '6,4', strokeWidth: 1.5 }),
      Plot.ruleX(boxes, { x: 'width', y1: 'low', y2: 'q1_mm', stroke: 'var(--ink)' }),
      Plot.ruleX(boxes, { x: 'width', y1: 'q3_mm', y2: 'high', stroke: 'var(--ink)' }),
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
}

/** Error and coverage of predictions against segments ahead. */
export const predictionSeries = (prediction: PredictionData) => [
  { name: 'from the start', rows: prediction.by_step, colour: 'var(--c0)' },
  { name: 'from a random segment', rows: prediction.by_step_from_random ?? [], colour: 'var(--c2)' },
  { name: 'without knowledge of the material', rows: prediction.by_step_no_knowledge ?? [], colour: 'var(--c3)' },
].filter((one) => one.rows.length > 0);
export type Series = ReturnType<typeof predictionSeries>;
export function stepOptions(series: Series, width: number, value: 'mean_mm' | 'coverage_1sigma'): Plot.PlotOptions {
  const last = Math.max(1, ...series.flatMap((one) => one.rows.map((row) => row.steps)));
  const error = value === 'mean_mm';
  const start = series.filter((one) => error && one.name === 'from the start').flatMap((one): StepResult[] => one.rows);
  return {
    x: { domain: [0, last], ticks: wholeTicks(0, last, width), tickFormat: 'd', label: 'segments ahead' },
    y: { label: error ? 'mm' : 'share', grid: true, ...(error ? { zero: true, nice: true } : { domain: [0, 1], ticks: 5 }) },
    marks: [
      ...(error ? [Plot.lineY(start, { x: 'steps', y: 'median_mm', stroke: 'var(--c0)', strokeDasharray: '5,3' })] : [Plot.ruleY([0.683], { stroke: 'var(--muted)', strokeDasharray: '5,4' })]),
      ...series.flatMap(({ name, rows, colour }) => [
        Plot.lineY(rows, { x: 'steps', y: value, stroke: colour, strokeWidth: 2.2 }),
        Plot.dot(rows, { x: 'steps', y: value, fill: colour, r: 2.6, tip: true, title: (row: StepResult) => `${name}, ${row.steps} ahead: ${fixed(row[value], error ? 2 : 3)}${row.n ? ` (n = ${row.n})` : ''}` }),
      ]),
    ],
  };
}

const last = (one: EstimationCase) => one.knowledge[one.knowledge.length - 1] ?? { centre: [], width: [] };
/** The estimates of property p after the last segment. */
export const estimateRows = (cases: EstimationCase[], p: number) => cases.map((one, index) => {
  const centre = last(one).centre[p], half = last(one).width[p] / 2;
  return { index, truth: one.true_material[p], centre, low: Math.max(0, centre - half), high: Math.min(1, centre + half) };
});
export const estimateOptions = (rows: ReturnType<typeof estimateRows>, colour: string): Plot.PlotOptions => ({
  marginLeft: 32, marginTop: 10,
  x: { domain: [0, 1], ticks: [0, 0.5, 1], label: 'true' }, y: { domain: [0, 1], ticks: [0, 0.5, 1], label: null },
  marks: [
    Plot.line([[0, 0], [1, 1]], { stroke: 'var(--muted)', strokeDasharray: '5,4' }),
    Plot.ruleX(rows, { x: 'truth', y1: 'low', y2: 'high', stroke: colour, strokeOpacity: 0.6 }),
    Plot.dot(rows, { x: 'truth', y: 'centre', r: 3.2, fill: colour, ariaLabel: (row) => `case ${row.index}`, title: (row) => `case ${row.index + 1}: ${fixed(row.centre, 2)} in [${fixed(row.low, 2)}, ${fixed(row.high, 2)}], true ${fixed(row.truth, 2)}` }),
  ],
});

/** Nominal against observed coverage of these properties. */
export const coveragePoints = (estimation: EstimationData, names: string[]) =>
  names.flatMap((name) => Object.entries(estimation.properties[name].coverage).map(([nominal, observed]) => ({ name, nominal: Number(nominal), observed })))
    .sort((a, b) => a.nominal - b.nominal);
export const calibrationOptions = (points: ReturnType<typeof coveragePoints>, names: string[]): Plot.PlotOptions => ({
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
});
