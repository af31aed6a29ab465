// The page's figures as files for papers: SVG, and what they show as CSV. Bundled for node; ../figures.mjs writes the files.
import { Plot } from './charts';
import type { AblationData, Arm, EstimationCase, EstimationData, PlanningData, PredictionData, Statistics } from './data';
import { label } from './dom';
import {
  calibrationOptions, coveragePoints, estimateOptions, estimateRows, intervalOptions, ratioOptions, planningBoxes, planningOptions, predictionSeries, stepOptions, type Interval,
} from './figures';
import { plainDocument, sourceOf } from './plain_document';

export interface PaperFigure { name: string; svg: string; csv: string }
export interface Results { ablation?: AblationData; planning?: PlanningData; estimation?: EstimationData; prediction?: PredictionData }

const kWidth = 420;  // px, of a column of text
const kProperties = ['friction', 'bend', 'stretch', 'thickness'];  // in the order of q
const kSymbols = ['circle', 'square', 'diamond'] as const;

type Cell = string | number | null | undefined;
const csvCell = (value: Cell) => {
  const text = value == null ? '' : String(value);
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
};
const csvOf = (head: string[], rows: Cell[][]) => [head, ...rows].map((row) => `${row.map(csvCell).join(',')}\n`).join('');

/** @param colours of the page's style, by name: "c0", "ink". */
export function paperFigures(results: Results, colours: Record<string, string>): PaperFigure[] {
  const figures: PaperFigure[] = [];
  const add = (name: string, options: Plot.PlotOptions, head: string[], rows: Cell[][], height = 240, legend: [string, string][] = []) => {
    const names = legend.map(([text, fill], i) => Plot.text([text], { frameAnchor: 'top-left', dy: 4 + 14 * i, dx: 8, fill, text: (d: string) => d }));
    const drawn = Plot.plot({
      document: plainDocument(), width: kWidth, height, marginLeft: 46, marginRight: 14, marginBottom: 36, marginTop: 26, ...options,
      style: { fontSize: '12px', fontFamily: 'sans-serif' }, marks: [...(options.marks ?? []), ...names],
    } as Plot.PlotOptions);
    const svg = sourceOf(drawn).replace(/<style>.*?<\/style>|<g aria-label="tip"[^>]*><\/g>/gs, '').replace(/^<svg /, '<svg xmlns="http://www.w3.org/2000/svg" ')
      .replace(/var\(--([\w-]+)\)/g, (whole, colour) => colours[colour] ?? whole).replaceAll('currentColor', colours.ink);
    figures.push({ name, svg: `${svg}\n`, csv: csvOf(head, rows) });
  };
  if (results.ablation) addAblation(results.ablation, add);
  if (results.planning?.by_width.some((box) => box.n > 0)) {
    const parts = planningBoxes(results.planning);
    add('planning', planningOptions(parts, false), ['w', 'goal', 'error_mm', 'outlier'],
      parts.solved.map((one) => [one.width, one.goal, one.error_mm, parts.isOutlier(one) ? 1 : 0]), 300);
  }
  if (results.estimation) addEstimation(results.estimation, add);
  if (results.prediction) {
    const series = predictionSeries(results.prediction);
    const rows = series.flatMap(({ name, rows: steps }) => steps.map((row): Cell[] => [name, row.steps, row.n, row.mean_mm, row.median_mm, row.coverage_1sigma]));
    const head = ['series', 'segments_ahead', 'n', 'mean_mm', 'median_mm', 'coverage_1sigma'];
    const names = series.map(({ name, colour }): [string, string] => [name, colour]);
    add('prediction-error', stepOptions(series, kWidth, 'mean_mm'), head, rows, 240, names);
    add('prediction-coverage', stepOptions(series, kWidth, 'coverage_1sigma'), head, rows, 240, names);
  }
  return figures;
}

type Add = (name: string, options: Plot.PlotOptions, head: string[], rows: Cell[][], height?: number, legend?: [string, string][]) => void;

/** Means with intervals, and paired differences, of every metric. Colours are levels of the first factor that varies. */
function addAblation({ arms, factors }: AblationData, add: Add) {
  const varied = factors.find((factor) => new Set(arms.map((arm) => arm.levels[factor])).size > 1) ?? factors[0];
  const levels = [...new Set(arms.map((arm) => arm.levels[varied]))];
  const rowsOf = (of: (arm: Arm) => Statistics | undefined) => arms.flatMap((arm): (Interval & { n: number })[] => {
    const value = of(arm), level = levels.indexOf(arm.levels[varied]);
    if (!value || value.mean === null) return [];
    return [{ name: arm.name, n: value.n, mean: value.mean, low: value.mean_95[0] ?? value.mean, high: value.mean_95[1] ?? value.mean, colour: `var(--c${level % 6})`, symbol: kSymbols[Math.floor(level / 6) % 3] }];
  });
  const head = ['arm', 'n', 'mean', 'low_95', 'high_95'];
  for (const metric of new Set(arms.flatMap((arm) => Object.keys(arm.metrics)))) {
    const means = rowsOf((arm) => arm.metrics[metric]), differences = rowsOf((arm) => arm.metrics[metric]?.difference);
    const file = metric.replace(/[^\w.]+/g, '-');
    const cells = (rows: (Interval & { n: number })[]) => rows.map((row): Cell[] => [row.name, row.n, row.mean, row.low, row.high]);
    if (means.length) add(`ablation-${file}`, intervalOptions(means, metric, false), head, cells(means));
    const ratios = arms.flatMap((arm): (Interval & { n: number })[] => {
      const medians = arm.metrics[metric]?.medians, level = levels.indexOf(arm.levels[varied]);
      if (!medians || !medians.baseline_over_own || medians.gap_closed === undefined) return [];
      const [low, high] = medians.baseline_over_own_95;
      return [{ name: arm.name, n: medians.n, mean: medians.baseline_over_own, low: low || medians.baseline_over_own, high: high || medians.baseline_over_own, colour: `var(--c${level % 6})`, symbol: kSymbols[Math.floor(level / 6) % 3] }];
    });
    if (ratios.length) add(`ablation-${file}-ratio`, ratioOptions(ratios), ['arm', 'n', 'baseline_over_own', 'low_95', 'high_95'], cells(ratios));
    if (differences.length) add(`ablation-${file}-difference`, intervalOptions(differences, metric, true), head, cells(differences));
  }
}

/** The estimate of every case after the last segment, and its calibration. */
function addEstimation(estimation: EstimationData, add: Add) {
  const cases = estimation.cases.filter((one): one is EstimationCase => !('failed' in one));
  const names = kProperties.filter((name) => name in estimation.properties);
  if (cases.length === 0) return;
  for (const name of names) {
    const rows = estimateRows(cases, kProperties.indexOf(name));
    add(`estimation-${name}`, { ...estimateOptions(rows, `var(--${name})`), width: 240 }, ['case', 'true', 'centre', 'low', 'high'],
      rows.map((row) => [row.index + 1, row.truth, row.centre, row.low, row.high]));
  }
  const points = coveragePoints(estimation, names);
  add('estimation-calibration', { ...calibrationOptions(points, names), width: 300 }, ['property', 'nominal', 'observed'],
    points.map((point) => [point.name, point.nominal, point.observed]), 300, names.map((name) => [label(name), `var(--${name})`]));
}
