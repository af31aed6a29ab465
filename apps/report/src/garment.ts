// The page of a garment: a click names a vertex; of an import also the mesh as it was, and what was found and done.
import { decode, decodeFaces, type FindingKind, type GarmentMesh, type PageData } from './data';
import { h, label, section } from './dom';
import { tile, title } from './frame';
import { Viewer } from './viewer';

const kinds: Record<FindingKind, string> = { fact: 'found', mended: 'mended', warning: 'look at it', limit: 'not supported yet' };
/** Names as YAML and `--name` take them. */
const isName = (text: string) => /^[A-Za-z_][A-Za-z0-9_]*$/.test(text);

export function garmentPage(page: PageData): HTMLElement {
  const mesh = page.mesh!, garment = page.garment!;
  const positions = decode(mesh.positions), faces = decodeFaces(garment.faces);
  const viewer = new Viewer(faces, garment.vertices, `garment ${garment.name}`);
  viewer.setCloth(positions);
  viewer.setEdges(true);
  viewer.fit([positions]);
  const at = (v: number) => Array.from(positions.subarray(3 * v, 3 * v + 3));
  const metres = (v: number) => at(v).map((value) => value.toFixed(3).replace('-', '−')).join(', ');
  const named = new Map(Object.entries(mesh.named));
  const findings = mesh.findings ?? [];

  // What the view marks besides the names: the chosen vertex, and the places of the chosen finding.
  let chosen = -1, shown = -1;
  const what = h('p', { class: 'note', id: 'chosen' }, 'Click a vertex in the view to name it.');
  const name = h('input', { type: 'text', id: 'vertex-name', 'aria-label': 'Name of the vertex', autocomplete: 'off', spellcheck: 'false', placeholder: 'left_sleeve' });
  const add = h('button', { class: 'primary', id: 'add-name' }, 'Name it');
  const list = h('tbody', {});
  const yaml = h('pre', { id: 'yaml', tabindex: 0 });
  const refresh = () => {
    const marks = [...named].map(([text, v]) => ({ at: at(v), text }));
    if (chosen >= 0 && ![...named.values()].includes(chosen)) marks.push({ at: at(chosen), text: '' });
    if (shown >= 0) marks.push(...(findings[shown].places ?? []).map((place) => ({ at: place.at, text: '' })));
    viewer.setMarks(marks);
    add.disabled = chosen < 0 || !isName(name.value);
    if (chosen >= 0) what.textContent = `Vertex ${chosen} (OBJ ${chosen + 1}) at ${metres(chosen)} m.${name.value && !isName(name.value) ? ' A name has letters, digits and _, and begins with no digit.' : ''}`;
    list.replaceChildren(...[...named].map(([text, v]) => h('tr', { title: `${metres(v)} m` }, h('td', {}, text), h('td', {}, String(v)),
      h('td', {}, h('button', { 'aria-label': `Remove the name ${text}`, onclick: () => { named.delete(text); refresh(); } }, 'Remove')))));
    yaml.textContent = `${mesh.head}${named.size ? 'vertices:\n' : ''}${[...named].sort().map(([text, v]) => `  ${text}: ${v}\n`).join('')}`;
  };
  const give = () => {
    if (add.disabled) return;
    named.set(name.value, chosen);
    name.value = '';
    refresh();
  };
  viewer.onPick = (v) => {
    chosen = v;
    refresh();
    name.focus({ preventScroll: true });
  };
  name.addEventListener('input', refresh);
  name.addEventListener('keydown', (event) => event.key === 'Enter' && give());
  add.addEventListener('click', give);

  const choose = (i: number) => {
    shown = shown === i ? -1 : i;
    rows.forEach((row, j) => row.setAttribute('aria-selected', String(j === shown)));
    refresh();
  };
  const rows = findings.map((finding, i) => h('tr', { class: finding.kind, 'data-pass': finding.pass },
    h('td', {}, kinds[finding.kind]), h('td', {}, label(finding.pass)), h('td', {}, finding.text),
    h('td', {}, finding.places ? h('button', { onclick: () => choose(i), 'aria-label': `Show where: ${finding.pass}` }, 'Show') : null)));
  const limits = findings.filter((finding) => finding.kind === 'limit');
  const count = (kind: FindingKind) => String(findings.filter((finding) => finding.kind === kind).length);
  const edges = h('input', { type: 'checkbox', id: 'edges', checked: true });
  edges.addEventListener('change', () => viewer.setEdges(edges.checked));
  refresh();

  return h('div', {},
    title(page, `Garment ${garment.name}`, [mesh.file, `${garment.vertices} vertices`, `${faces.length / 3} faces`]),
    ...limits.map((finding) => h('p', { class: 'warning', role: 'note' }, `weft cannot fold this garment yet: ${finding.text}.`)),
    findings.length ? h('dl', { class: 'tiles' }, tile('Mended', 'mended', count('mended'), ''), tile('To look at', 'warnings', count('warning'), ''), tile('Not supported yet', 'limits', count('limit'), '')) : null,
    h('div', { class: 'stage' },
      section('after', mesh.before ? 'The garment' : 'Garment', null, viewer.element,
        h('div', { class: 'transport' }, h('label', { class: 'check' }, edges, 'mesh edges'))),
      section('names', 'Names of vertices', null, what, h('div', { class: 'cases' }, name, add),
        h('div', { class: 'scroll' }, h('table', { class: 'names' }, h('thead', {}, h('tr', {}, h('th', {}, 'Name'), h('th', {}, 'Vertex'), h('th', {}))), list)),
        h('p', { class: 'note' }, `The garment's YAML with these names, for the file beside ${mesh.file}:`), yaml,
        h('button', { id: 'copy', onclick: () => copy(yaml) }, 'Copy'))),
    findings.length ? section('findings', 'What was found and done', 'Show marks the places in the garment above.',
      h('div', { class: 'scroll' }, h('table', { class: 'findings' }, h('thead', {}, h('tr', {}, ...['', 'Step', 'Finding', ''].map((text) => h('th', {}, text)))), h('tbody', {}, ...rows)))) : null,
    mesh.before ? beforePart(mesh.before) : null);
}

function beforePart(before: NonNullable<GarmentMesh['before']>): HTMLElement {
  const positions = decode(before.positions), faces = decodeFaces(before.faces);
  const viewer = new Viewer(faces, before.vertices, 'mesh of the file');
  viewer.setCloth(positions);
  viewer.setEdges(true);
  viewer.fit([positions]);
  return section('before', 'The mesh of the file', `${before.vertices} vertices, ${faces.length / 3} triangles; in metres, z up.`, viewer.element);
}

/** A page from the disk may not use the clipboard; then the text is selected. */
function copy(element: HTMLElement) {
  getSelection()?.selectAllChildren(element);
  navigator.clipboard?.writeText(element.textContent!).catch(() => undefined);
}
