// The page of `weft evaluate physics`: comparisons with references and bounds, the worst of every test, random folds by seed.
import { chart, Plot, wholeTicks } from './charts';
import type { PhysicsData, PhysicsRow } from './data';
import { fixed, h, section, significant } from './dom';
import { tile } from './frame';
import { sortableTable, type Column } from './table';

const kMostShown = 1.25;  // of a bound; comparisons further out lie at the edge of the figure

/** How much of its bound a comparison uses. */
const share = ({ error, bound }: PhysicsRow) => (error === null ? Infinity : bound > 0 ? error / bound : error > 0 ? Infinity : 0);
const shareText = (row: PhysicsRow) => (Number.isFinite(share(row)) ? `${fixed(100 * share(row), 1)} %` : '∞');
const verdict = (row: PhysicsRow) => h('span', { class: row.passed ? '' : 'outside' }, row.passed ? 'holds' : 'outside');

export function physicsPart({ comparisons, failed, rows }: PhysicsData): HTMLElement {
  const tests = [...new Set(rows.map((row) => row.test))];
  const worst = tests.map((test) => {
    const all = rows.filter((row) => row.test === test);
    return { test, n: all.length, row: all.reduce((a, b) => (share(b) > share(a) ? b : a)) };
  });

  const numbers = <Row>(of: (row: Row) => PhysicsRow): Column<Row>[] => [
    { id: 'reference', head: 'Reference', numeric: true, value: (row) => of(row).reference, cell: (row) => significant(of(row).reference) },
    { id: 'measured', head: 'Measured', numeric: true, value: (row) => of(row).measured ?? NaN, cell: (row) => significant(of(row).measured) },
    { id: 'error', head: 'Error', numeric: true, value: (row) => of(row).error ?? Infinity, cell: (row) => significant(of(row).error) },
    { id: 'bound', head: 'Bound', numeric: true, value: (row) => of(row).bound, cell: (row) => significant(of(row).bound) },
  ];
  const texts = <Row>(of: (row: Row) => PhysicsRow): Column<Row>[] => [
    { id: 'share', head: 'Error / bound', numeric: true, value: (row) => share(of(row)), cell: (row) => shareText(of(row)) },
    { id: 'passed', head: 'Verdict', value: (row) => Number(of(row).passed), cell: (row) => verdict(of(row)) },
    { id: 'case', head: 'Case', value: (row) => of(row).case }, { id: 'variant', head: 'Settings', value: (row) => of(row).variant },
    { id: 'quantity', head: 'Quantity', value: (row) => of(row).quantity },
  ];

  const testSelect = h('select', { id: 'physics-test' }, h('option', { value: '' }, 'all tests'), ...tests.map((test) => h('option', { value: test }, test)));
  const outsideBox = h('input', { type: 'checkbox', id: 'physics-outside' });
  const chosen = () => rows.filter((row) => (!testSelect.value || row.test === testSelect.value) && (!outsideBox.checked || !row.passed));
  const count = h('span', { class: 'sub', id: 'physics-count' });
  const all = sortableTable<PhysicsRow>({
    id: 'physics-rows', rows: chosen, sortBy: 'share', descending: true,
    columns: () => [{ id: 'test', head: 'Test', value: (row) => row.test }, ...texts<PhysicsRow>((row) => row), ...numbers<PhysicsRow>((row) => row), { id: 'note', head: 'Note', value: (row) => row.note }],
  });
  all.element.classList.add('tall');
  const refresh = () => {
    all.refresh();
    count.textContent = `${chosen().length} of ${rows.length}`;
  };
  for (const control of [testSelect, outsideBox]) control.addEventListener('change', refresh);
  const choose = (test: string) => {
    testSelect.value = test;
    refresh();
    testSelect.scrollIntoView({ behavior: 'smooth', block: 'center' });
    testSelect.focus({ preventScroll: true });
  };
  const summary = sortableTable<(typeof worst)[number]>({
    id: 'physics-worst', rows: () => worst, sortBy: 'share', descending: true, name: (one) => one.test,
    columns: () => [
      { id: 'test', head: 'Test', value: (one) => one.test, cell: (one) => h('button', { class: 'link', onclick: () => choose(one.test) }, one.test) },
      { id: 'n', head: 'n', numeric: true, value: (one) => one.n }, ...texts<(typeof worst)[number]>((one) => one.row), ...numbers<(typeof worst)[number]>((one) => one.row)],
  });
  refresh();

  const figure = chart('Part of its bound that every comparison uses', (width) => {
    const points = rows.map((row, i) => ({ ...row, index: i, x: Math.min(Math.max(share(row), 0), kMostShown) }));
    const ordered = [...worst].sort((a, b) => share(b.row) - share(a.row)).map((one) => one.test);
    const dots = (passed: boolean) => Plot.dot(points.filter((point) => point.passed === passed), {
      x: 'x', y: 'test', r: passed ? 3 : 4.5, symbol: passed ? 'circle' : 'times', stroke: passed ? 'none' : 'var(--c1)', strokeWidth: 2.2, fill: passed ? 'var(--c0)' : 'none', fillOpacity: 0.5,
      title: (row) => `${row.test}, ${row.case}, ${row.quantity}: error ${significant(row.error)}, bound ${significant(row.bound)}`, tip: true,
    });
    return {
      marginLeft: 110, height: 70 + 22 * tests.length,
      x: { domain: [0, kMostShown], ticks: width < 560 ? [0, 0.5, 1] : [0, 0.25, 0.5, 0.75, 1, kMostShown], tickFormat: (t: number) => (t === kMostShown ? '≥ 125 %' : `${100 * t} %`), label: 'error / bound', grid: true },
      y: { type: 'band', domain: ordered, label: null },
      marks: [Plot.ruleX([1], { stroke: 'var(--c1)', strokeDasharray: '6,4', strokeWidth: 1.5 }), dots(true), dots(false)],
    };
  });

  return h('div', { id: 'physics' },
    failed > 0 ? h('p', { class: 'warning', role: 'note' }, `Warning: ${failed} of ${comparisons} comparisons lie outside their bound.`) : null,
    h('dl', { class: 'tiles' }, tile('Comparisons', 'comparisons', String(comparisons), ''), tile('Outside their bound', 'outside', String(failed), ''), tile('Tests', 'tests', String(tests.length), '')),
    h('div', { class: 'figures' },
      h('div', { class: 'wide' }, section('physics-figure', 'Physics: how close to its bound', 'A dot is a comparison of the simulator with its reference (a closed form, unless the test says otherwise). Right of the dashed line, drawn as crosses: outside the bound.', figure.element)),
      h('div', { class: 'wide' }, section('physics-worst-section', 'The worst of every test', 'The comparison that uses the largest part of its bound. Click a test for all of its comparisons, a heading to sort.', summary.element)),
      foldsPart(rows),
      h('div', { class: 'wide' }, section('physics-all', 'All comparisons', null,
        h('div', { class: 'cases' }, h('label', { class: 'field' }, 'Test', testSelect), h('label', { class: 'check' }, outsideBox, 'only outside their bound'), count), all.element))));
}

/** All measurements of random folds, by seed. */
function foldsPart(rows: PhysicsRow[]): HTMLElement | null {
  const quantities = new Map<string, { test: string; quantity: string; bound: number; points: { seed: number; value: number }[] }>();
  for (const { test, quantity, bound, by_seed } of rows) {
    if (!by_seed) continue;
    const id = `${test} ${quantity}`;
    if (!quantities.has(id)) quantities.set(id, { test, quantity, bound, points: [] });
    quantities.get(id)!.points.push(...by_seed.map(([seed, value]) => ({ seed, value })));
  }
  if (quantities.size === 0) return null;
  const list = [...quantities.values()].map((one) => ({ ...one, points: one.points.sort((a, b) => a.seed - b.seed) }));
  const nothing = list.filter(({ points }) => points.every(({ value }) => value === 0));
  const charts = list.filter((one) => !nothing.includes(one)).map(({ test, quantity, bound, points }) => {
    const outside = points.filter(({ value }) => value > bound);
    const of = list.filter((one) => one.test === test).flatMap((one) => one.points.map(({ seed }) => seed));
    const first = Math.min(...of), last = Math.max(...of);
    const element = chart(`${test}: ${quantity} by seed`, (width) => ({
      marginLeft: 52, marginTop: 10,
      x: { domain: [first - 1, last + 1], ticks: wholeTicks(first, last, width), tickFormat: 'd', label: 'seed' },
      y: { label: null, grid: true, ticks: 4, zero: true, nice: true },
      marks: [
        Plot.ruleY([bound], { stroke: 'var(--c1)', strokeDasharray: '6,4', strokeWidth: 1.5 }),
        Plot.dot(points.filter(({ value }) => value <= bound), { x: 'seed', y: 'value', r: 2.6, fill: 'var(--c0)', fillOpacity: 0.65, tip: true, title: (d) => `seed ${d.seed}: ${significant(d.value)}` }),
        Plot.dot(outside, { x: 'seed', y: 'value', r: 4.5, symbol: 'times', stroke: 'var(--c1)', strokeWidth: 2.2, tip: true, title: (d) => `seed ${d.seed}: ${significant(d.value)}, outside ${significant(bound)}` }),
      ],
    }), { height: 190 }).element;
    return h('div', {}, h('h3', {}, test, h('span', { class: 'sub' }, `${quantity}, bound ${significant(bound)}${outside.length ? `, outside: seed ${outside.map(({ seed }) => seed).join(', ')}` : ''}`)), element);
  });
  const seeds = new Set(list.flatMap(({ points }) => points.map(({ seed }) => seed)));
  return h('div', { class: 'wide' }, section('physics-folds', `Random folds by seed (${seeds.size})`,
    `A seed draws material and controls of one fold; dashed: the bound. To repeat one fold alone: --set physics.folds.first_seed=SEED --set physics.folds.count=1.${nothing.map(({ quantity, points }) => ` ${quantity}: 0 in all ${points.length}.`).join('')}`,
    h('div', { class: 'small-multiples broad' }, ...charts)));
}
