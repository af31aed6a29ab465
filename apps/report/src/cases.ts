// Cases of an experiment in 3D, one at a time.
import { colourLegend, niceCeiling } from './colours';
import { decode, decodeFaces, distancesMm, mean, Shapes, type PageData } from './data';
import { h } from './dom';
import { Viewer } from './viewer';

/** A choice of one thing from several, with a list and two buttons. */
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

/** Makes clicks on marks of a figure that are labelled `case I` show that case. */
export function clickCases(figure: HTMLElement, choose: (i: number) => void) {
  figure.classList.add('pick');
  figure.addEventListener('click', (event) => {
    const name = (event.target as Element).closest('[aria-label^="case "]')?.getAttribute('aria-label');
    if (name) choose(Number(name.slice(5)));
  });
}

const check = (id: string, text: string, checked: boolean, swatch: HTMLElement | null = null) => {
  const input = h('input', { type: 'checkbox', id, checked });
  return { input, element: h('label', { class: 'check' }, input, swatch, text) };
};

export interface CaseTexts {
  /** Names of the translucent shape and of the other one. */
  goal: string; shape: string;
  distance: string;
  note: (i: number, goal: number) => string;
}

/** A shape beside its target, for every case of an experiment. Null when no shapes were recorded. */
export function caseViewer(page: PageData, name: string, texts: CaseTexts) {
  const { goals, offsets, goal_of } = page.shapes?.[name] ?? {}, garment = page.garment;
  if (!goals || !offsets?.length || !goal_of || !garment) return null;
  const viewer = new Viewer(decodeFaces(garment.faces), garment.vertices, `${garment.name}, ${texts.shape}`);
  const legend = h('div', { class: 'legend' });
  viewer.element.append(legend);
  const goal = check(`${name}-goal`, texts.goal, true, h('span', { class: 'swatch', style: 'background:var(--goal)' }));
  const colour = check(`${name}-colour`, `colour by ${texts.distance}`, true);
  const edges = check(`${name}-edges`, 'mesh edges', false);
  const note = h('p', { class: 'note', id: `${name}-note` });
  let current = -1;
  const update = () => {
    const wanted = decode(goals[goal_of[current]]), shape = decode(offsets[current]);
    for (let i = 0; i < shape.length; ++i) shape[i] += wanted[i];
    const distances = distancesMm(shape, wanted);
    const range = niceCeiling(Math.max(5, 2 * mean(distances)));
    viewer.setCloth(shape);
    viewer.setOverlay('goal', goal.input.checked ? wanted : null);
    viewer.setColours(colour.input.checked ? distances : null, range);
    viewer.setEdges(edges.input.checked);
    legend.hidden = !colour.input.checked;
    legend.replaceChildren(...colourLegend(`${texts.distance}, mm`, range));
    note.textContent = texts.note(current, goal_of[current]);
  };
  for (const { input } of [goal, colour, edges]) input.addEventListener('change', update);
  return {
    element: h('div', {}, note, viewer.element, h('div', { class: 'transport' }, goal.element, colour.element, edges.element)),
    count: offsets.length,
    show(i: number) {
      if (current < 0) viewer.fit(goals.map((one) => decode(one)));
      current = i;
      update();
    },
  };
}

/** Shapes after 0, 1, 2, ... segments, for every case of an experiment. Null when no shapes were recorded. */
export function sequenceViewer(page: PageData, name: string, onSegment: (segment: number) => void) {
  const sequences = page.shapes?.[name]?.sequences, garment = page.garment;
  if (!sequences?.some(Boolean) || !garment) return null;
  const viewer = new Viewer(decodeFaces(garment.faces), garment.vertices, `${garment.name} being folded`);
  const edges = check(`${name}-edges`, 'mesh edges', false);
  edges.input.addEventListener('change', () => viewer.setEdges(edges.input.checked));
  const range = h('input', { type: 'range', min: 0, step: 1, 'aria-label': 'Segment', id: `${name}-segment` });
  const where = h('output', { class: 'where', id: `${name}-where` });
  const transport = h('div', { class: 'transport' }, h('div', { class: 'scrub' }, range), edges.element, where);
  const missing = h('p', { class: 'note' }, 'The shapes of this case were not recorded.');
  let shapes: Shapes | null = null;
  const seek = (segment: number) => {
    if (!shapes) return;
    const at = Math.min(Math.max(Math.round(segment), 0), shapes.count - 1);
    range.value = String(at);
    viewer.setCloth(shapes.at(at));
    where.textContent = at === 0 ? 'at the start' : `after segment ${at} of ${shapes.count - 1}`;
    range.setAttribute('aria-valuetext', where.textContent);
    onSegment(at);
  };
  range.addEventListener('input', () => seek(Number(range.value)));
  return {
    element: h('div', {}, missing, viewer.element, transport),
    seek,
    show(i: number) {
      const sequence = sequences[i];
      for (const part of [viewer.element, transport]) part.hidden = !sequence;
      missing.hidden = Boolean(sequence);
      shapes = sequence ? new Shapes(sequence) : null;
      if (!shapes) return;
      range.max = String(shapes.count - 1);
      viewer.fit(Array.from({ length: shapes.count }, (_, j) => shapes!.at(j)));
      seek(shapes.count - 1);
    },
  };
}
