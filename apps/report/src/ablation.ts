// The page of `weft ablate`: arms as rows, sortable; factors as colours; means with intervals; paired differences.
import { chart } from './charts';
import type { Arm, Medians, PageData, Statistics } from './data';
import { fixed, h, section } from './dom';
import { intervalOptions, ratioOptions, nameOf, unitOf, type Interval } from './figures';
import { provenanceDetails, title } from './frame';
import { sortableTable, type Column } from './table';

// Levels beyond the sixth take the colours again, with another shape.
const kColours = 6;
const kShapes = [{ symbol: 'circle', style: 'border-radius:50%' }, { symbol: 'square', style: '' }, { symbol: 'diamond', style: 'transform:rotate(45deg) scale(0.8)' }] as const;
const kShownFirst = ['error_mm', 'silhouette_iou', 'success_10mm', 'first_plan_loss', 'evaluations', 'plan_seconds'];

const heading = (metric: string) => `${nameOf(metric)}${unitOf(metric) ? `, ${unitOf(metric)}` : ''}`;

export function ablationPage(page: PageData): HTMLElement {
  // Only an ablation with a target says what share of a gap its arms close.
  const { arms, factors, seeds, cases, complete, description, has_target: hasTarget = false } = page.ablation!;
  const cellName = (seed: number) => cases?.[seed] ?? `seed ${seed}`;
  const metrics = [...new Set(arms.flatMap((arm) => Object.keys(arm.metrics)))];
  const levels = new Map(factors.map((factor) => [factor, [...new Set(arms.map((arm) => arm.levels[factor]))]]));
  const isBaseline = (arm: Arm) => arms.some((other) => other.baseline === arm.name);
  const look = (factor: string, level: string) => {
    const i = levels.get(factor)!.indexOf(level);
    return { colour: `var(--c${i % kColours})`, ...kShapes[Math.floor(i / kColours) % kShapes.length] };
  };
  const chip = (factor: string, level: string) => {
    const { colour, style } = look(factor, level);
    return h('span', { class: 'chip' }, h('span', { class: 'swatch', style: `background:${colour};${style}` }), level);
  };
  let colourBy = factors.find((factor) => levels.get(factor)!.length > 1) ?? factors[0];
  let metric = metrics.includes('error_mm') ? 'error_mm' : metrics[0];  // none: no cell finished

  const digits = new Map(metrics.map((name) => {
    const largest = Math.max(...arms.map((arm) => Math.abs(arm.metrics[name]?.mean ?? 0)));
    return [name, largest >= 1000 ? 0 : largest >= 100 ? 1 : largest >= 0.1 || largest === 0 ? 2 : 1 - Math.floor(Math.log10(largest))];
  }));
  const text = (value: Statistics | undefined, name: string, sign = false) => {
    if (!value || value.mean === null) return '–';
    const places = digits.get(name)!;
    const interval = value.mean_95.every((end) => end !== null) ? ` [${fixed(value.mean_95[0], places)}, ${fixed(value.mean_95[1], places)}]` : '';
    return `${sign && value.mean > 0 ? '+' : ''}${fixed(value.mean, places)}${interval}`;
  };

  const ratioText = (medians: Medians | undefined) => {
    if (!medians || medians.baseline_over_own === null) return '';
    const [low, high] = medians.baseline_over_own_95;
    return `${fixed(medians.baseline_over_own, 2)}${low !== null && high !== null ? ` [${fixed(low, 2)}, ${fixed(high, 2)}]` : ''}`;
  };
  const share = (part: number | null | undefined) => (part === null || part === undefined ? '' : `${fixed(100 * part, 0)} %`);

  type MetricColumn = Column<Arm> & { metric?: string; extra?: boolean };
  const columns: MetricColumn[] = [
    { id: 'name', head: 'Arm', value: (arm) => arm.name, cell: (arm) => (isBaseline(arm) ? `${arm.name} (baseline)` : arm.name) },
    ...factors.map((factor): MetricColumn => ({
      id: `factor ${factor}`, head: factor, value: (arm) => arm.levels[factor], cell: (arm) => chip(factor, arm.levels[factor]),
    })),
    { id: 'done', head: 'n', value: (arm) => arm.done, numeric: true },
    { id: 'failed', head: 'Failed', value: (arm) => arm.failed.length, cell: (arm) => h('span', { title: arm.failed.map((one) => `${cellName(one.seed)}: ${one.failure}`).join('\n') }, String(arm.failed.length)), numeric: true },
    ...metrics.flatMap((name) => ([
      { id: name, metric: name, head: heading(name), numeric: true, value: (arm) => arm.metrics[name]?.mean ?? NaN, cell: (arm) => text(arm.metrics[name], name) },
      { id: `median ${name}`, metric: name, extra: true, head: 'median', numeric: true, value: (arm) => arm.metrics[name]?.median ?? NaN, cell: (arm) => fixed(arm.metrics[name]?.median, digits.get(name)) },
      { id: `difference ${name}`, metric: name, head: 'against baseline', numeric: true, value: (arm) => arm.metrics[name]?.difference?.mean ?? NaN, cell: (arm) => (isBaseline(arm) ? '' : text(arm.metrics[name]?.difference, name, true)) },
      { id: `ratio ${name}`, metric: name, extra: !hasTarget, head: 'baseline / own, medians', numeric: true, value: (arm) => arm.metrics[name]?.medians?.baseline_over_own ?? NaN, cell: (arm) => ratioText(arm.metrics[name]?.medians) },
      { id: `gap ${name}`, metric: name, head: 'gap closed', numeric: true, value: (arm) => arm.metrics[name]?.medians?.gap_closed ?? NaN, cell: (arm) => share(arm.metrics[name]?.medians?.gap_closed) },
    ] as MetricColumn[]).filter((column) => (!column.id.startsWith('difference') && !column.id.startsWith('ratio') || arms.some((arm) => arm.metrics[name]?.difference)) &&
      (!column.id.startsWith('gap') || arms.some((arm) => typeof arm.metrics[name]?.medians?.gap_closed === 'number')))),
  ];
  const allBox = h('input', { type: 'checkbox', id: 'all-metrics' });
  allBox.addEventListener('change', () => table.refresh());
  const shownFirst = metrics.filter((name) => kShownFirst.includes(name));
  const isShown = ({ metric: name, extra }: MetricColumn) => !name || allBox.checked || (!extra && (shownFirst.length === 0 || shownFirst.includes(name)));
  const table = sortableTable<Arm>({
    id: 'arms', rows: () => arms, columns: () => columns.filter(isShown), sortBy: metric ?? 'name', name: (arm) => arm.name,
    rowClass: (arm) => (isBaseline(arm) ? 'baseline' : ''), onSort: () => refresh(),
  });

  const intervals = (name: string, of: (arm: Arm) => Statistics | undefined, zero: boolean) => chart(name, () => {
    const rows = table.sorted().flatMap((arm): Interval[] => {
      const value = of(arm);
      if (!value || value.mean === null) return [];
      return [{ name: arm.name, mean: value.mean, low: value.mean_95[0] ?? value.mean, high: value.mean_95[1] ?? value.mean, ...(colourBy ? look(colourBy, arm.levels[colourBy]) : { colour: 'var(--c0)', symbol: 'circle' }), title: `${arm.name}: ${text(value, metric)}` }];
    });
    return intervalOptions(rows, metric, zero, arms.map((arm) => arm.name));
  });
  const means = intervals('Mean and 95 % interval', (arm) => arm.metrics[metric], false);
  const differences = intervals('Paired difference to the baseline', (arm) => arm.metrics[metric]?.difference, true);
  const ratios = chart('Median of the baseline over the own median', () => ratioOptions(table.sorted().flatMap((arm): Interval[] => {
    const medians = arm.metrics[metric]?.medians;
    if (!medians || !medians.baseline_over_own) return [];
    const [low, high] = medians.baseline_over_own_95;
    return [{ name: arm.name, mean: medians.baseline_over_own, low: low || medians.baseline_over_own, high: high || medians.baseline_over_own, ...(colourBy ? look(colourBy, arm.levels[colourBy]) : { colour: 'var(--c0)', symbol: 'circle' }), title: `${arm.name}: ${ratioText(medians)}` }];
  })));
  const meansTitle = h('span', {}), differencesTitle = h('span', {}), ratiosTitle = h('span', {});

  const ratiosPart = h('section', {}, h('h2', {}, ratiosTitle), ratios.element);
  const differencesPart = h('section', {}, h('h2', {}, differencesTitle), differences.element);

  function refresh() {
    if (!metric) return;
    meansTitle.textContent = heading(metric);
    differencesTitle.textContent = `${heading(metric)}: paired difference to the baseline`;
    differencesPart.hidden = !arms.some((arm) => typeof arm.metrics[metric]?.difference?.mean === 'number');
    ratiosTitle.textContent = `${nameOf(metric)}: how many times smaller the median is than the baseline’s`;
    ratiosPart.hidden = !hasTarget || !arms.some((arm) => arm.metrics[metric]?.medians?.baseline_over_own);
    means.redraw();
    differences.redraw();
    if (!ratiosPart.hidden) ratios.redraw();
    legend.replaceChildren(...(colourBy ? levels.get(colourBy)! : []).map((level) => h('li', {}, chip(colourBy, level))));
  }
  const choice = (id: string, name: string, entries: string[], chosen: string, show: (entry: string) => string, choose: (entry: string) => void) => {
    const select = h('select', { id }, ...entries.map((entry) => h('option', { value: entry, selected: entry === chosen }, show(entry))));
    select.addEventListener('change', () => {
      choose(select.value);
      refresh();
    });
    return h('label', { class: 'field' }, name, select);
  };
  const legend = h('ul', { class: 'key' });
  refresh();
  const failures = arms.flatMap((arm) => arm.failed.map((one) => `${arm.name}, ${cellName(one.seed)}: ${one.failure}`));
  const cells = arms.length * seeds.length;
  return h('div', {},
    title(page, description || 'Ablation', [`${arms.length} arms`, `${seeds.length} ${cases ? 'cases' : 'seeds'}`]),
    complete ? null : h('p', { class: 'warning', role: 'note' }, 'Warning: not all cells have run; run the same command again to finish the rest.'),
    failures.length ? h('p', { class: 'warning', role: 'note' }, `Warning: ${failures.length} of ${cells} cells failed. Means and differences leave them out; the reasons are at the end of the page.`) : null,
    h('div', { class: 'figures' }, h('div', { class: 'wide' }, section('arms-section', 'Arms', `Mean and its 95 % interval over the ${cases ? 'cases' : 'seeds'}; differences are paired, one by one, with the arm that differs only in having the baseline’s level. Click a heading to sort.`,
      h('label', { class: 'check' }, allBox, 'all metrics'), table.element))),
    metric ? h('div', { class: 'cases', style: 'margin-top:1.5rem' },
      choice('metric', 'Figures of', metrics, metric, heading, (entry) => (metric = entry)),
      factors.length ? choice('factor', 'Colours stand for', factors, colourBy, (entry) => entry, (entry) => (colourBy = entry)) : null, legend) : null,
    metric ? h('div', { class: 'figures', style: 'margin-top:0.5rem' }, h('section', {}, h('h2', {}, meansTitle), means.element), differencesPart, ratiosPart) : null,
    h('div', { class: 'details' }, failures.length ? h('details', { id: 'failures', open: !metric }, h('summary', {}, `Failures (${failures.length})`), h('pre', { tabindex: 0 }, failures.join('\n'))) : null, ...provenanceDetails(page)));
}
