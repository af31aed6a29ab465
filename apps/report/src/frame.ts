// The parts that every page has: its head, and where its results came from.
import type { PageData } from './data';
import { h, themeSwitch } from './dom';

export function title(page: PageData, text: string, facts: (string | undefined | false)[]): HTMLElement {
  const { provenance } = page;
  document.title = `${text} – weft`;
  const all = [...facts, provenance?.seed !== undefined && `seed ${provenance.seed}`, provenance?.weft && `weft ${provenance.weft} (${provenance.commit})`];
  return h('header', { class: 'top' }, h('div', {}, h('h1', {}, text), h('p', { class: 'sub' }, all.filter(Boolean).join(' · ')), ...mixedNotes(page)), themeSwitch());
}

/** What was accepted with --accept-changed. */
function mixedNotes(page: PageData): HTMLElement[] {
  const of = [
    ...(page.ablation?.arms ?? []).flatMap((arm) => (arm.mixed ?? []).map((one) => ({ ...one, where: `arm ${arm.name}, ` }))),
    ...[...(page.planning?.mixed ?? []), ...(page.estimation?.mixed ?? [])].map((one) => ({ ...one, where: '' })),
  ];
  return of.map((one) => h('p', { class: 'sub', 'data-key': 'mixed' }, `Mixed results: ${one.where}seeds ${one.seeds.join(', ')} belong to something else: ${one.changes.join('; ')}`));
}

export function tile(name: string, id: string, value: string, unit: string): HTMLElement {
  return h('div', { class: 'tile' }, h('dt', {}, name), h('dd', {}, h('span', { 'data-key': id }, value), unit ? h('small', {}, ` ${unit}`) : null));
}

export function provenanceDetails(page: PageData): HTMLElement[] {
  const result: HTMLElement[] = [];
  if (page.config) result.push(h('details', {}, h('summary', {}, 'Resolved config'), h('pre', { tabindex: 0 }, page.config)));
  if (page.provenance) result.push(h('details', {}, h('summary', {}, 'Version, plugins, machine'), h('pre', { tabindex: 0 }, JSON.stringify(page.provenance, null, 2))));
  return result;
}
