// `weft evaluate planning`: the paper's Fig. 3, and its cases in 3D.
import { caseViewer, chooser, clickCases } from './cases';
import { chart, key } from './charts';
import type { PageData, PlanningData } from './data';
import { fixed, h, section } from './dom';
import { kPaperMedianMm, planningBoxes, planningOptions } from './figures';
import { tile } from './frame';

export function planningPart(page: PageData, planning: PlanningData): HTMLElement {
  const parts = planningBoxes(planning);
  const { widths, solved, boxes } = parts;
  const failed = planning.cases.length - solved.length;
  const scaleBox = h('input', { type: 'checkbox', id: 'all-outliers' });
  scaleBox.addEventListener('change', () => figure.redraw());

  const figure = chart('Error after settling against the width of the material knowledge', () => planningOptions(parts, scaleBox.checked), { height: 360 });

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
