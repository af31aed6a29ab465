// The page of `weft ablate`: arms as rows, sortable; factors as colours; means with intervals; paired differences.
import { chart, Plot } from './charts';
import type { Arm, PageData, Statistics } from './data';
import { fixed, h, label, section } from './dom';
import { provenanceDetails, title } from './frame';

const kColours = 6;
const kShownFirst = ['error_mm', 'first_plan_loss', 'evaluations', 'plan_seconds'];

const kUnits: [RegExp, string][] = [[/_mm$/, 'mm'], [/_seconds$/, 's']];
const unitOf = (metric: string) => kUnits.find(([ending]) => ending.test(metric))?.[1] ?? '';
const nameOf = (metric: string) => label(kUnits.reduce((text, [ending]) => text.replace(ending, ''), metric));
const heading = (metric: string) => `${nameOf(metric)}${unitOf(metric) ? `, ${unitOf(metric)}` : ''}`;

export function ablationPage(page: PageData): HTMLElement {
  const { arms, factors, seeds, complete, description } = page.ablation!;
  const metrics = [...new Set(arms.flatMap((arm) => Object.keys(arm.metrics)))];
  const levels = new Map(factors.map((factor) => [factor, [...new Set(arms.map((arm) => arm.levels[factor]))]]));
  const colourOf = (factor: string, level: string) => `var(--c${levels.get(factor)!.indexOf(level) % kColours})`;
  let colourBy = factors.find((factor) => levels.get(factor)!.length > 1) ?? factors[0];
  let metric = metrics.includes('error_mm') ? 'error_mm' : metrics[0];

  const digits = new Map(metrics.map((name) => {
    const largest = Math.max(...arms.map((arm) => Math.abs(arm.metrics[name]?.mean ?? 0)));
    return [name, largest >= 1000 ? 0 : largest >= 100 ? 1 : 2];
  }));
  const text = (value: Statistics | undefined, name: string, sign = false) => {
    if (!value || value.mean === null) return '–';
    const places = digits.get(name)!;
    const interval = value.mean_95.every((end) => end !== null) ? ` [${fixed(value.mean_95[0], places)}, ${fixed(value.mean_95[1], places)}]` : '';
    return `${sign && value.mean > 0 ? '+' : ''}${fixed(value.mean, places)}${interval}`;
  };

  interface Column { id: string; head: string; value: (arm: Arm) => number | string; cell: (arm: Arm) => Node | string; numeric: boolean; metric?: string; extra?: boolean }
  const columns: Column[] = [
    { id: 'name', head: 'Arm', value: (arm) => arm.name, cell: (arm) => (arm.baseline === null ? `${arm.name} (baseline)` : arm.name), numeric: false },
    ...factors.map((factor): Column => ({
      id: `factor ${factor}`, head: factor, numeric: false, value: (arm) => arm.levels[factor],
      cell: (arm) => h('span', { class: 'chip' }, h('span', { class: 'swatch', style: `background:${colourOf(factor, arm.levels[factor])}` }), arm.levels[factor]),
    })),
    { id: 'done', head: 'n', value: (arm) => arm.done, cell: (arm) => String(arm.done), numeric: true },
    { id: 'failed', head: 'Failed', value: (arm) => arm.failed.length, cell: (arm) => h('span', { title: arm.failed.map((one) => `seed ${one.seed}: ${one.failure}`).join('\n') }, String(arm.failed.length)), numeric: true },
    ...metrics.flatMap((name) => ([
      { id: name, metric: name, head: heading(name), numeric: true, value: (arm) => arm.metrics[name]?.mean ?? Infinity, cell: (arm) => text(arm.metrics[name], name) },
      { id: `median ${name}`, metric: name, extra: true, head: 'median', numeric: true, value: (arm) => arm.metrics[name]?.median ?? Infinity, cell: (arm) => fixed(arm.metrics[name]?.median, digits.get(name)) },
      { id: `difference ${name}`, metric: name, head: 'against baseline', numeric: true, value: (arm) => arm.metrics[name]?.difference?.mean ?? 0, cell: (arm) => (arm.baseline === null ? '' : text(arm.metrics[name]?.difference, name, true)) },
    ] as Column[]).filter((column) => !column.id.startsWith('difference') || arms.some((arm) => arm.metrics[name]?.difference))),
  ];
  let sortBy = metric ?? 'name';
  let ascending = true;
  const sorted = () => {
    const column = columns.find((one) => one.id === sortBy)!;
    return [...arms].sort((a, b) => {
      const x = column.value(a), y = column.value(b);
      const order = typeof x === 'number' && typeof y === 'number' ? x - y : String(x).localeCompare(String(y), 'en', { numeric: true });
      return ascending ? order : -order;
    });
  };

  const allBox = h('input', { type: 'checkbox', id: 'all-metrics' });
  allBox.addEventListener('change', () => refresh());
  const head = h('tr', {});
  const body = h('tbody', {});
  const table = h('table', { id: 'arms' }, h('caption', {}, 'Mean and its 95 % interval over the seeds; differences are paired, seed by seed, against the arm that is like it but for the baseline’s level. Click a heading to sort.'), h('thead', {}, head), body);

  const intervals = (name: string, of: (arm: Arm) => Statistics | undefined, zero: boolean) => chart(name, () => {
    const rows = sorted().flatMap((arm) => {
      const value = of(arm);
      if (!value || value.mean === null) return [];
      return [{ name: arm.name, mean: value.mean, low: value.mean_95[0] ?? value.mean, high: value.mean_95[1] ?? value.mean, colour: colourBy ? colourOf(colourBy, arm.levels[colourBy]) : 'var(--c0)', title: `${arm.name}: ${text(value, metric)}` }];
    });
    return {
      marginLeft: Math.min(190, 20 + 6.5 * Math.max(0, ...arms.map((arm) => arm.name.length))), height: 60 + 26 * Math.max(1, rows.length),
      x: { label: unitOf(metric) || nameOf(metric), grid: true, nice: true, zero: true, ticks: 5, tickFormat: '~s' },
      y: { type: 'band', domain: rows.map((row) => row.name), label: null },
      marks: [
        ...(zero ? [Plot.ruleX([0], { stroke: 'var(--ink)' })] : []),
        Plot.ruleY(rows, { y: 'name', x1: 'low', x2: 'high', stroke: (row) => row.colour, strokeWidth: 3 }),
        Plot.dot(rows, { y: 'name', x: 'mean', r: 5, fill: (row) => row.colour, title: 'title', tip: true }),
      ],
    };
  });
  const means = intervals('Mean and 95 % interval', (arm) => arm.metrics[metric], false);
  const differences = intervals('Paired difference to the baseline', (arm) => arm.metrics[metric]?.difference, true);
  const meansTitle = h('span', {}), differencesTitle = h('span', {});

  function refresh() {
    const visible = columns.filter((column) => !column.metric || allBox.checked || (!column.extra && (!metrics.some((name) => kShownFirst.includes(name)) || kShownFirst.includes(column.metric))));
    head.replaceChildren(...visible.map((column) => h('th', {
      scope: 'col', class: column.numeric ? '' : 'text', 'aria-sort': column.id === sortBy ? (ascending ? 'ascending' : 'descending') : null,
    }, h('button', {
      'data-sort': column.id,
      onclick: () => {
        ascending = sortBy === column.id ? !ascending : true;
        sortBy = column.id;
        refresh();
        head.querySelector<HTMLElement>(`[data-sort="${CSS.escape(column.id)}"]`)?.focus();
      },
    }, column.head))));
    body.replaceChildren(...sorted().map((arm) => h('tr', { class: arm.baseline === null ? 'baseline' : '' },
      ...visible.map((column) => h('td', { class: column.numeric ? '' : 'text', 'data-key': `${arm.name} ${column.id}` }, column.cell(arm))))));
    meansTitle.textContent = heading(metric);
    differencesTitle.textContent = `${heading(metric)}: paired difference to the baseline`;
    means.redraw();
    differences.redraw();
    legend.replaceChildren(...(colourBy ? levels.get(colourBy)! : []).map((level) => h('li', {}, h('span', { class: 'swatch', style: `background:${colourOf(colourBy, level)}` }), level)));
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
  const failures = arms.flatMap((arm) => arm.failed.map((one) => `${arm.name}, seed ${one.seed}: ${one.failure}`));
  return h('div', {},
    title(page, description || 'Ablation', [`${arms.length} arms`, `${seeds.length} seeds`]),
    complete ? null : h('p', { class: 'warning', role: 'note' }, 'Warning: not all cells have run; the same command finishes the rest.'),
    h('div', { class: 'figures' }, h('div', { class: 'wide' }, section('arms-section', 'Arms', null, h('label', { class: 'check' }, allBox, 'all that was measured'), h('div', { class: 'scroll', tabindex: 0 }, table)))),
    h('div', { class: 'cases', style: 'margin-top:1.5rem' },
      choice('metric', 'Figures of', metrics, metric, heading, (entry) => (metric = entry)),
      factors.length ? choice('factor', 'Colours stand for', factors, colourBy, (entry) => entry, (entry) => (colourBy = entry)) : null, legend),
    h('div', { class: 'figures', style: 'margin-top:0.5rem' },
      h('section', {}, h('h2', {}, meansTitle), means.element), h('section', {}, h('h2', {}, differencesTitle), differences.element)),
    h('div', { class: 'details' }, failures.length ? h('details', {}, h('summary', {}, `Failures (${failures.length})`), h('pre', { tabindex: 0 }, failures.join('\n'))) : null, ...provenanceDetails(page)));
}
