// `weft evaluate planning`: the paper's Fig. 3, and its cases in 3D.
import { caseViewer, chooser, clickCases } from './cases';
import { chart, key, Plot } from './charts';
import type { PageData, PlanningCase, PlanningData } from './data';
import { fixed, h, section } from './dom';
import { tile } from './frame';

const kPaperMedianMm = 6.9;  // Fig. 3 at w = 0.1

export function planningPart(page: PageData, planning: PlanningData): HTMLElement {
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
  const whiskers = Math.max(...boxes.map((box) => box.high), kPaperMedianMm);
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
  }, { height: 360 });

  const caseBox = h('div', {});
  const chosen = planning.cases.map((one, i) => `${i + 1}: w = ${one.width}, ${one.error_mm === null ? 'failed' : `${fixed(one.error_mm)} mm`}`);
  const browser = caseViewer(page, 'planning', {
    goal: 'goal', shape: 'after the fold', distance: 'distance to the goal',
    note: (i, goal) => `Case ${i + 1}, goal ${goal + 1}: ${planning.cases[i].error_mm === null ? `failed: ${planning.cases[i].failed ?? ''}` : `${fixed(planning.cases[i].error_mm)} mm from the goal`}.`,
  });
  const choice = chooser('planning-case', 'Case', chosen, (i) => browser?.show(i));
  if (browser) {
    caseBox.append(choice.element, browser.element);
    clickCases(figure.element, (i) => {
      choice.go(i);
      caseBox.scrollIntoView({ behavior: 'smooth', block: 'nearest' });
    });
    queueMicrotask(() => choice.go(0));
  } else {
    caseBox.append(h('p', { class: 'note' }, 'The shapes of the cases were not recorded, so there is nothing to see in 3D.'));
  }
  const others = Object.entries(planning.columns ?? {});
  const head = ['w', 'n', 'Median, mm', 'Mean, mm', 'SD, mm', 'Quartiles, mm', 'Outliers', 'IoU', 'Within 10, 20, 30 mm'];
  const share = (value: number | null | undefined) => (value == null ? '–' : `${fixed(100 * value, 0)} %`);
  const narrow = widths[0];
  return h('div', { id: 'planning' },
    narrow ? h('dl', { class: 'tiles' },
      tile(`Median error at w = ${narrow.width}`, 'median_mm', fixed(narrow.median_mm), 'mm'), tile('Mean error there', 'mean_mm', fixed(narrow.mean_mm), 'mm'),
      tile('The paper’s median at w = 0.1', 'paper_mm', fixed(kPaperMedianMm), 'mm'), tile('Cases', 'cases', String(planning.cases.length), failed ? `${failed} failed` : '')) : null,
    h('div', { class: 'figures' },
      h('div', { class: 'wide' }, section('planning-figure', 'Planning: error against knowledge of the material (the paper’s Fig. 3)',
        'Mean distance to the goal over all vertices, after settling. Boxes: quartiles and median; whiskers: farthest case within 1.5 times the box; diamonds: mean. Numbers at the top count the outliers, drawn in orange. Click a point to see the case.',
        key({ text: `the paper’s median at w = 0.1: ${kPaperMedianMm} mm`, colour: 'var(--c2)', style: 'dashed' }),
        h('label', { class: 'check' }, scaleBox, 'fit the scale to all outliers'), figure.element,
        h('details', { id: 'planning-numbers' }, h('summary', {}, 'Numbers'), h('div', { class: 'scroll', tabindex: 0 }, h('table', {}, h('thead', {}, h('tr', {}, ...head.map((text) => h('th', { scope: 'col' }, text)))),
          h('tbody', {}, ...boxes.map((box) => h('tr', {}, ...[String(box.width), String(box.n), fixed(box.median_mm, 2), fixed(box.mean_mm, 2), fixed(box.sd_mm, 2), `${fixed(box.q1_mm, 2)} – ${fixed(box.q3_mm, 2)}`, String(box.count), fixed(box.silhouette_iou, 3),
            [box.success_10mm, box.success_20mm, box.success_30mm].map(share).join(', ')].map((text) => h('td', {}, text)))))),
          others.length ? h('table', { id: 'planning-columns' }, h('caption', {}, 'Median error in mm (and cases) by where the goals come from.'),
            h('thead', {}, h('tr', {}, h('th', { scope: 'col' }, 'w'), ...[planning.goals ?? 'here', ...others.map(([source]) => source)].map((source) => h('th', { scope: 'col' }, source)))),
            h('tbody', {}, ...planning.by_width.map((box, i) => h('tr', {}, h('td', {}, String(box.width)), ...[box, ...others.map(([, column]) => column.by_width[i])].map((one) =>
              h('td', {}, one ? `${fixed(one.median_mm, 2)} (${one.n})` : '–')))))) : null)))),
      h('div', { class: 'wide' }, section('planning-cases', 'One case', null, caseBox))));
}
